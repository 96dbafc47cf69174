"""Reading the species table: TOML files into frozen dataclasses, with errors that name file, species and key."""

import math
import tomllib
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from vlp16emu.errors import GeometryError

__all__ = ["read_tables", "record"]

_Record = TypeVar("_Record")

_KINDS = ("tree", "shrub")
"""Tables at the top of the file: plants stand as [tree.NAME] or [shrub.NAME]."""

_RANGES = {
    "number": (1, 65535),
    "fia": (1, 9999),
    "height_spread": (0, 1),
    "leaf_area_index": (0, 20),
    "bark_reflectance": (0, 1),
    "leaf_reflectance": (0, 1),
    "leaf_transmittance": (0, 1),
    "top_share": (0.1, 1),
    "length_m": (0.005, 20),
    "width_m": (0.0005, 5),
    "clumping": (0.5, 10),
    "spread_m": (0, 2),
    "base_fraction": (0, 1),
    "widest_at": (0.01, 0.99),
    "top_power": (0.2, 10),
    "whorl_spacing_m": (0.02, 5),
    "branches_per_whorl": (1, 20),
    "crook_deg": (0, 60),
    "dead_per_m": (0, 50),
    "start": (0, 0.95),
    "per_m": (0.1, 200),
    "length_share": (0.01, 2),
    "stems": (1, 100),
}
"""What a value must lie in, by key; other numbers need only be finite."""


def read_tables(path: Path) -> dict[str, dict[str, Any]]:
    """Tables of a species file by kind and name.

    Raises
    ------
    GeometryError
        for a file that cannot be read, is no TOML, or holds a table that is neither a tree nor a shrub
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise GeometryError(str(path), error.strerror or str(error), "a species file") from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise GeometryError(str(path), str(error), "TOML in UTF-8") from error
    for kind, plants in content.items():
        if kind not in _KINDS:
            raise GeometryError(f"{path}: [{kind}]", "unknown table", "[tree.NAME] or [shrub.NAME]")
        for name, row in plants.items() if isinstance(plants, dict) else [("", plants)]:
            if not isinstance(row, dict):
                raise GeometryError(f"{path}: {kind}.{name}", f"found {row!r}", f"a table [{kind}.NAME]")
    return {kind: content.get(kind, {}) for kind in _KINDS}


def record(cls: type[_Record], row: Mapping[str, Any], where: str, **given: str) -> _Record:
    """Make a dataclass of a TOML table, key by key.

    Parameters
    ----------
    where : file and species, for the message of an error
    given : fields that do not come from the table

    Raises
    ------
    GeometryError
        for an unknown or missing key, a value of the wrong type, or one out of range
    """
    hints = get_type_hints(cls)
    known = {f.name: f for f in fields(cls) if f.name not in given}  # type: ignore[arg-type]  # a dataclass
    for key in row:
        if key not in known:
            raise GeometryError(f"{where}: {key}", "unknown key", f"one of {', '.join(known)}")
    values: dict[str, Any] = dict(given)
    for key, field in known.items():
        if key in row:
            values[key] = _value(hints[key], row[key], f"{where}: {key}", key)
        elif field.default is MISSING:
            raise GeometryError(f"{where}: {key}", "key is missing")
    return cls(**values)


def _value(hint: Any, value: Any, where: str, key: str) -> Any:
    """One value, checked against the type that its field declares."""
    if is_dataclass(hint) and isinstance(hint, type):
        if not isinstance(value, dict):
            raise GeometryError(where, f"found {value!r}", "a table")
        return record(hint, value, where)
    if isinstance(hint, UnionType):
        return _value(next(t for t in get_args(hint) if t is not NoneType), value, where, key)
    if get_origin(hint) is Literal:
        if value not in get_args(hint):
            raise GeometryError(where, f"found {value!r}", f"one of {', '.join(get_args(hint))}")
        return value
    if get_origin(hint) is tuple:
        return _numbers(hint, value, where, key)
    if hint is str:
        if not isinstance(value, str) or not value:
            raise GeometryError(where, f"found {value!r}", "text")
        return value
    return _number(hint, value, where, key)


def _numbers(hint: Any, value: Any, where: str, key: str) -> tuple[float, ...]:
    """Read a list: of any length where the field says so, else of the length it declares."""
    kinds = get_args(hint)
    if not isinstance(value, list):
        raise GeometryError(where, f"found {value!r}", "a list of numbers")
    if kinds[-1] is not Ellipsis and len(value) != len(kinds):
        raise GeometryError(where, f"found {len(value)} numbers", f"{len(kinds)}")
    return tuple(_number(float, each, f"{where}[{i}]", key) for i, each in enumerate(value))


def _number(kind: type[float], value: Any, where: str, key: str) -> float:
    """Read a finite number within the range of its key."""
    fits = isinstance(value, int) if kind is int else isinstance(value, int | float)
    if not fits or isinstance(value, bool) or not math.isfinite(value):
        raise GeometryError(where, f"found {value!r}", "a whole number" if kind is int else "a number")
    low, high = _RANGES.get(key) or (-math.inf, math.inf)
    if not low <= value <= high:
        raise GeometryError(where, f"found {value}", f"{low} to {high}")
    return kind(value)
