"""Squares of a forest as the store keeps them, and how its shapes are named."""

import json
from collections.abc import Callable
from dataclasses import astuple, fields
from typing import Any, TypeVar

import numpy as np

from vlp16emu.forest.plants.crown import CrownKey
from vlp16emu.forest.plants.ivy import IvyKey
from vlp16emu.forest.plants.sapling import SaplingKey
from vlp16emu.forest.plants.shrub import ShrubKey
from vlp16emu.forest.plants.stem import StemKey
from vlp16emu.forest.stand.floor_shapes import FloorKey, FloorKind
from vlp16emu.forest.stand.models import ModelKey
from vlp16emu.forest.tiles import TileKey
from vlp16emu.store import Bundle, recalled
from vlp16emu.types import ShapeKey

T = TypeVar("T")

_KINDS: dict[str, Callable[..., ShapeKey]] = {
    "CrownKey": CrownKey,
    "IvyKey": lambda tile, number: IvyKey(TileKey(*tile), number),
    "FloorKey": lambda kind, *rest: FloorKey(FloorKind(kind), *rest),
    "ModelKey": ModelKey,
    "SaplingKey": SaplingKey,
    "ShrubKey": ShrubKey,
    "StemKey": lambda tile, number: StemKey(TileKey(*tile), number),
    "TileKey": TileKey,
}
"""How keys are made of their fields."""


def by_tile(kind: type[T], name: str, make: Callable[[int, int], T]) -> Callable[[int, int], T]:
    """Keep what is made of each tile (ix, iy): a data class of arrays, and of `keys` of shapes.

    `name` is that of all that decides it but the tile; empty where nothing is kept.
    """
    if not name:
        return make
    return lambda ix, iy: recalled(
        f"{name} {kind.__name__} {ix} {iy}", lambda: make(ix, iy), _packed, lambda bundle: _unpacked(kind, bundle)
    )


def key_text(key: ShapeKey) -> str:
    """Write a key of a forest's shape."""
    return json.dumps(_row(key))


def _row(key: Any) -> list[object]:
    return [type(key).__name__, *astuple(key)]


def _packed(thing: Any) -> Bundle:
    keys = json.dumps([_row(key) for key in thing.keys]).encode()
    return {field.name: getattr(thing, field.name) for field in fields(thing)} | {"keys": np.frombuffer(keys, np.uint8)}


def _unpacked(kind: type[T], bundle: Bundle) -> T:
    rows = json.loads(bundle["keys"].tobytes())
    return kind(**{**bundle, "keys": tuple(_KINDS[name](*values) for name, *values in rows)})
