"""From what pydantic finds to one line in the words of the user's file."""

import difflib
import json
import math
from datetime import date, datetime, time
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

__all__ = ["expected", "explain", "resolved"]

Node = dict[str, Any]


def explain(error: ValidationError, schema: Node) -> tuple[str, str, str]:
    """Key path, what was found there and what was expected, of the finding that helps most.

    The message of a validator of our own says what was expected.

    Parameters
    ----------
    error : from the check of a file
    schema : JSON Schema of the file
    """
    # A misspelt key is also a missing one; the misspelling is the better news.
    finding = min(error.errors(include_url=False), key=lambda e: e["type"] != "extra_forbidden")
    keys, parent, node = _walk(finding["loc"], schema)
    kind = finding["type"]
    if kind == "extra_forbidden":
        return _path(keys), "unknown key", _nearest(keys[-1], list(parent["properties"]))
    if kind.startswith("union_tag"):
        tag = node["discriminator"]["propertyName"]
        choice = {"enum": list(node["discriminator"]["mapping"])}
        found = f"found {_shown(finding['input'][tag])}" if tag in finding["input"] else "missing"
        return _path([*keys, tag]), found, expected(choice)
    if kind == "missing":
        return _path(keys), "missing", expected(node)
    return _path(keys), f"found {_shown(finding['input'])}", _wanted(finding, node)


def expected(node: Node) -> str:
    """Say in words what a node of the schema admits."""
    if "enum" in node or "const" in node:
        *others, last = [_shown(value) for value in node.get("enum", [node.get("const")])]
        return f"{', '.join(others)} or {last}" if others else last
    if "discriminator" in node:
        tags = expected({"enum": list(node["discriminator"]["mapping"])})
        return f"a table with {node['discriminator']['propertyName']} = {tags}"
    kind = node["type"]
    if kind in ("integer", "number"):
        return f"{'a whole number' if kind == 'integer' else 'a number'} {_bounds(node)}".rstrip()
    if kind == "array":
        if "prefixItems" in node:
            return f"a list of {node['minItems']} numbers"
        ends = {"minItems": "of at least", "maxItems": "of at most"}
        return " ".join(["a list", *(f"{word} {node[key]}" for key, word in ends.items() if key in node)])
    if node.get("format") == "date-time":
        return "a date and time with its offset from UTC, such as 2026-05-20T09:00:00Z"
    return {"object": "a table", "string": "a text in quotes", "boolean": "true or false"}[kind]


def resolved(node: Node, schema: Node) -> Node:
    """Replace a reference by what it points at, and what may be left out by what it is otherwise."""
    node = node["anyOf"][0] if "anyOf" in node else node
    return schema["$defs"][node["$ref"].rpartition("/")[2]] if "$ref" in node else node


def _wanted(finding: ErrorDetails, node: Node) -> str:
    """Say what the finding asks for."""
    if finding["type"] == "value_error":
        return finding["msg"].removeprefix("Value error, ")
    words = expected(node)
    return words.replace("a number", "a finite number") if finding["type"] == "finite_number" else words


def _walk(loc: tuple[int | str, ...], schema: Node) -> tuple[list[int | str], Node, Node]:
    """Follow pydantic's path down the schema: the keys that the file has, the last table, the last node."""
    keys: list[int | str] = []
    parent = node = resolved(schema, schema)
    for part in loc:
        if "discriminator" in node:  # pydantic puts the union's tag into the path; no file has it
            node = resolved({"$ref": node["discriminator"]["mapping"][part]}, schema)
            continue
        keys.append(part)
        parent = node
        if isinstance(part, int):
            ahead = node["prefixItems"][part] if "prefixItems" in node else node["items"]
        else:
            ahead = node["properties"].get(part, {})
        node = resolved(ahead, schema)
    return keys, parent, node


def _path(keys: list[int | str]) -> str:
    """Write keys as `world.species[0].share`."""
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys).lstrip(".") or "scene"


def _nearest(key: int | str, names: list[str]) -> str:
    """Name the known key that was probably meant, or all there are."""
    near = difflib.get_close_matches(str(key), names, n=1)
    return f"{near[0]}, the nearest known one" if near else f"one of {', '.join(names)}"


def _shown(value: object) -> str:
    """Write a value as TOML would, in short."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, list):
        return f"a list of {len(value)}"
    if isinstance(value, datetime | date | time):
        return value.isoformat()
    text = json.dumps(value, ensure_ascii=False) if isinstance(value, str) else str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _bounds(node: Node) -> str:
    """Say between which limits a number lies."""
    low, high = node.get("minimum", -math.inf), node.get("maximum", math.inf)
    if "multipleOf" in node:
        return f"from {low} to {high} in steps of {node['multipleOf']}"
    if low > -math.inf and high < math.inf:
        return f"from {_number(low)} to {_number(high)}"
    words = {
        "minimum": "at least",
        "exclusiveMinimum": "above",
        "maximum": "at most",
        "exclusiveMaximum": "below",
    }
    return " and ".join(f"{word} {_number(node[key])}" for key, word in words.items() if key in node)


def _number(limit: float) -> str:
    """Write a limit without a fraction that says nothing."""
    return str(limit) if isinstance(limit, int) else f"{limit:.10g}"
