"""The species table: all plants that a world may hold; and what surfaces are made of, by `SURFACE` material number."""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from vlp16emu.errors import GeometryError, readable
from vlp16emu.explain import explain
from vlp16emu.forest.plants.species import Plant, Shrub, Species
from vlp16emu.settings import toml
from vlp16emu.types import Array, IntArray

Trees = NDArray[np.void]
Table = Mapping[str, Species]
_Kind = TypeVar("_Kind", bound=Plant)
_FIRST_OWN_NUMBER = 1000  # smaller numbers belong to the table that comes with the program


@dataclass(frozen=True, slots=True, eq=False)
class Flora:
    """All plants that a world may hold, by name, in the order of the table; a user's own come last."""

    trees: Mapping[str, Species]
    shrubs: Mapping[str, Shrub]

    @property
    def names(self) -> dict[int, str]:
        """Names of all plants by number."""
        return {plant.number: name for table in (self.trees, self.shrubs) for name, plant in table.items()}


def species_table(path: Path | None = None) -> Mapping[str, Species]:
    """All trees of `flora`."""
    return flora(path).trees


def shrub_table(path: Path | None = None) -> Mapping[str, Shrub]:
    """All shrubs of `flora`."""
    return flora(path).shrubs


@cache
def flora(path: Path | str | None = None) -> Flora:
    """Read the plants of the program, and those of a user's file of the same form after them, numbered from 1000.

    Raises GeometryError, naming file, species and key, where the user's file is wrong.
    """
    with resources.as_file(resources.files("vlp16emu.forest").joinpath("species.toml")) as shipped:
        trees, shrubs = _plants(shipped, 1)
    if path is not None:
        own_trees, own_shrubs = _plants(Path(path), _FIRST_OWN_NUMBER)
        for name in (*own_trees, *own_shrubs):
            if name in trees or name in shrubs:
                found = "a plant of that name is in the table already"
                raise GeometryError(f"{path}: {name}", found, "another name")
        trees, shrubs = trees | own_trees, shrubs | own_shrubs
    return Flora(MappingProxyType(trees), MappingProxyType(shrubs))


def _plants(path: Path, first_number: int) -> tuple[dict[str, Species], dict[str, Shrub]]:
    with readable(path, "a species file", GeometryError):
        text = path.read_text(encoding="utf-8")
    try:
        tables = toml(text)
    except (ValueError, RecursionError) as error:
        raise GeometryError(str(path), str(error), "TOML") from None
    for kind in tables.keys() - {"tree", "shrub"}:
        raise GeometryError(f"{path}: [{kind}]", "unknown table", "[tree.NAME] or [shrub.NAME]")
    trees = _of_kind(Species, path, "tree", tables, first_number)
    shrubs = _of_kind(Shrub, path, "shrub", tables, first_number)
    taken: dict[int, str] = {}
    for plant in (*trees.values(), *shrubs.values()):
        other = taken.setdefault(plant.number, plant.name)
        if other != plant.name:
            where = f"{path}: {plant.name}.number"
            raise GeometryError(where, f"found {plant.number}, which is that of {other}", "one of its own")
    return trees, shrubs


def _of_kind(
    section: type[_Kind], path: Path, kind: str, tables: Mapping[str, Any], first_number: int
) -> dict[str, _Kind]:
    rows = tables.get(kind, {})
    plants = {}
    for name, row in rows.items() if isinstance(rows, dict) else [("", rows)]:
        if not isinstance(row, dict):
            raise GeometryError(f"{path}: {kind}.{name}", f"found {row!r:.80}", f"a table [{kind}.NAME]")
        try:
            plants[name] = section.model_validate(row, context={"name": name, "first_number": first_number})
        except ValidationError as error:
            key, found, expected = explain(error, section.model_json_schema())
            raise GeometryError(f"{path}: {kind}.{name}.{key}", found, expected) from None
    return plants


def known(names: Sequence[str], table: Mapping[str, _Kind], where: str) -> list[_Kind]:
    """Rows of a species table by name: that of the table, with any case and any space, or the scientific one.

    Raises GeometryError for a name that is not in the table.
    """
    latin = {" ".join(_plain(row.scientific_name).split()[:2]): row for row in table.values()}  # without author
    rows = latin | {_plain(row.name): row for row in table.values()}
    for name in names:
        if _plain(name) not in rows:
            near = difflib.get_close_matches(_plain(name), rows, n=1)
            expected = f"{rows[near[0]].name}, the nearest known one" if near else f"one of {', '.join(table)}"
            raise GeometryError(where, f"unknown species {name!r}", expected)
    return [rows[_plain(name)] for name in names]


def _plain(name: str) -> str:
    return " ".join(name.replace("_", " ").replace("-", " ").lower().split())


def tapers(trees: Trees, *, table: Table | None = None) -> Array:
    """Tapers of trees (n,) `TREE`, (n, 13) for `taper_radius_m`; `table` is that of the program if none is given."""
    rows = {one.number: one.taper.row for one in (table or species_table()).values()}
    own = _by_number(trees["species"], rows, 13)
    own[:, -1] = trees["taper"]
    return own


def stem_keys(numbers: NDArray[np.uint16], *, table: Table | None = None) -> Array:
    """Row of `StemForm` by species number, (n, 10)."""
    return _by_number(numbers, {one.number: one.stem.row for one in (table or species_table()).values()}, 10)


def _by_number(numbers: NDArray[np.uint16], rows: Mapping[int, Array], width: int) -> Array:
    return np.array([rows[int(number)] for number in numbers]).reshape(-1, width)


GROUND_MATERIALS = ("litter", "stone", "dead wood", "grass", "herb", "fern", "dwarf shrub", "moss")
"""Names of the first numbers."""
BARK_SPREAD, LEAF_SPREAD = 0.08, 0.04
"""Half-range of reflectance between plants; assumptions (wide spread in the near infrared: Juola et al. 2020)."""


def material_names(plants: Flora) -> tuple[str, ...]:
    """All materials by number: those on the ground, then bark and leaf of each tree and shrub."""
    parts = (f"{name} {what}" for name in (*plants.trees, *plants.shrubs) for what in ("bark", "leaf"))
    return (*GROUND_MATERIALS, *parts)


def bark_material(species: NDArray[np.uint16], plants: Flora) -> IntArray:
    """Material numbers of the bark of species by number, (n,); that of the leaf is the next."""
    row: IntArray = _rows(plants)[species]
    return len(GROUND_MATERIALS) + 2 * row


@cache
def _rows(plants: Flora) -> IntArray:
    numbers = list(plants.names)
    row_of = np.zeros(max(numbers) + 1, np.int64)
    row_of[numbers] = np.arange(len(numbers))
    return row_of
