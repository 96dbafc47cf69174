"""How verbs print what they did."""

import json
from collections.abc import Mapping

__all__ = ["count", "print_json", "print_rows", "size"]


def print_json(tree: Mapping[str, object]) -> None:
    """Print one JSON object."""
    print(json.dumps(tree, indent=2))


def print_rows(title: str, rows: Mapping[str, str]) -> None:
    """Print a title and under it names and values in two columns."""
    print(title)
    width = max(map(len, rows))
    for name, value in rows.items():
        print(f"  {name:<{width}}  {value}")


def count(number: int) -> str:
    """Write a whole number in groups of three digits (ISO 80000-1, section 7.3.1)."""
    return f"{number:,}".replace(",", " ")


def size(number_of_bytes: int) -> str:
    """Write a file's size in MB of a million bytes."""
    return f"{number_of_bytes / 1e6:.1f} MB"
