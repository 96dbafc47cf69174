"""Coverage of each stem by the returns of a run, from their ground truth."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import InputError
from vlp16emu.extras.truth.slots import SlotReader
from vlp16emu.forest.plants.flora import Table, Trees
from vlp16emu.forest.plants.stem_rings import StemForms, axis_m, stem_forms
from vlp16emu.types import F8, I8, U4, PlantPart, Semantic
from vlp16emu.world.vectors import places_m

STEM_SEEN = np.dtype(
    [
        ("returns_stem", "<u4"),  # from root flare and stem, second leaders too
        ("stem_seen", "<f8"),  # share of the surface between 0.3 m and the crown base, in cells of 10 degrees by 0.5 m
        ("breast_seen_deg", "<f8"),  # of the stem's girth between 1.1 m and 1.5 m, in cells of 10 degrees
    ]
)
"""Coverage of a stem by returns."""

_SECTORS = 36  # cells around a stem

_LOW_M, _CELL_M = 0.3, 0.5  # beginning of the cells above the foot, and their height

_BREAST_M = (1.1, 1.5)

_ASIDE_M = 0.5
"""A return is from the stem itself, and of this world, if it is nearer to the axis than this plus a diameter."""

_COLUMNS = ["world_x_m", "world_y_m", "world_z_m", "semantic", "part", "instance"]


def tables_of_returns(folder: Path) -> list[Path]:
    """Return the ground truth of the returns of a run, a table per unit; InputError if there is none."""
    tables = sorted(folder.glob("returns*.parquet"))
    if not tables:
        raise InputError(str(folder), "no returns.parquet", "the truth of a run with --truth-returns")
    return tables


def stems_seen(trees: Trees, tables: Sequence[Path], *, table: Table | None = None) -> NDArray[np.void]:
    """Return the coverage of stems by the returns of a run: (n,) `STEM_SEEN`; InputError if a file is no table of returns, or of another world.

    Parameters
    ----------
    trees : (n,) `TREE` records of the run's world, at rest, by id; of models with form 0
    table : species; the program's own if None
    """
    forms, order = stem_forms(trees, table=table), np.argsort(trees["id"])
    cells = np.maximum(np.ceil((trees["crown_base_m"] - _LOW_M) / _CELL_M), 1).astype(np.int64)
    first = _SECTORS * np.cumsum([0, *cells.tolist()])
    hit, breast = np.zeros(first[-1], np.bool_), np.zeros((len(trees), _SECTORS), np.bool_)
    rows = np.zeros(len(trees), STEM_SEEN)
    for path in tables:
        for returns in SlotReader(path).returns(_COLUMNS):
            which, at_m = _of_stems(returns, trees["id"][order])
            which = order[which]
            rows["returns_stem"] += np.bincount(which, minlength=len(trees)).astype(np.uint32)
            up_m, aside_m, sector = _about_axes(trees, forms, which, at_m)
            near = aside_m < trees["dbh_m"][which] + _ASIDE_M
            if len(near) and near.mean() < 0.5:
                found = f"returns from stems {np.median(aside_m):.1f} m off the axes of the scene's trees"
                raise InputError(str(path), found, "those of a run of this scene")
            level = np.floor((up_m - _LOW_M) / _CELL_M).astype(np.int64)
            inside = near & (level >= 0) & (up_m < trees["crown_base_m"][which])
            hit[(first[which] + _SECTORS * level + sector)[inside]] = True
            inside = near & (up_m > _BREAST_M[0]) & (up_m < _BREAST_M[1])
            breast[which[inside], sector[inside]] = True
    owner = np.repeat(np.arange(len(trees)), _SECTORS * cells)
    rows["stem_seen"] = np.bincount(owner, hit, len(trees)) / (_SECTORS * cells)
    rows["breast_seen_deg"] = 360 / _SECTORS * breast.sum(axis=1)
    return rows


def _of_stems(returns: dict[str, F8], ids: U4) -> tuple[I8, F8]:
    """Return the returns from stems of trees with these ids (n,), ascending: row of the tree (k,), and place (k, 3)."""
    is_stem = np.isin(returns["part"], (PlantPart.STEM, PlantPart.ROOT_FLARE))
    is_stem &= (returns["semantic"] == Semantic.TREE) & np.isin(returns["instance"], ids)
    at_m = np.column_stack([returns[name][is_stem] for name in _COLUMNS[:3]])
    return np.searchsorted(ids, returns["instance"][is_stem]), at_m


def _about_axes(trees: Trees, forms: StemForms, which: I8, at_m: F8) -> tuple[F8, F8, I8]:
    """Return height over the foot, distance from the axis and sector (k,) of places (k, 3) on trees `which` (k,)."""
    own = trees[which]
    from_foot_m = at_m - places_m(own)
    up_m = from_foot_m[:, 2]
    aside_m = from_foot_m[:, :2] - axis_m(own, forms.of(which), up_m[:, None])[:, 0, :2]
    turn = np.arctan2(aside_m[:, 1], aside_m[:, 0]) / (2 * np.pi) % 1.0
    sector = np.minimum(_SECTORS * turn, _SECTORS - 1).astype(np.int64)
    return up_m, np.hypot(*aside_m.T), sector
