"""Trees of the user's own in the place of grown ones, as a forest knows them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vlp16emu.foliage.tiles import STEM
from vlp16emu.forest.plants.flora import Trees
from vlp16emu.forest.plants.stem_rings import STEM_CIRCLE
from vlp16emu.forest.stand.inventory import INVENTORY
from vlp16emu.forest.stand.placed import PlacedThings
from vlp16emu.types import Array, IntArray, Mesh, ShapeKey


@dataclass(frozen=True, slots=True)
class ModelKey:
    """Name of a model's shape."""

    number: int  # among the models of the scene
    content: str  # digest of all that decides it


class Models:
    """The models of a scene that has none."""

    def has(self, trees: Trees) -> NDArray[np.bool_]:
        """Which trees (n,) look like one of the models."""
        return np.zeros(len(trees), np.bool_)

    def placed(self, _trees: Trees, *, is_exact: bool) -> list[PlacedThings]:  # noqa: ARG002  # there are none
        """Place trees (n,) that all have models: those of each model together; `is_exact` as of `PlacedThings`."""
        return []

    def shape(self, key: ModelKey) -> tuple[Mesh, ...]:
        """Meshes of a model."""
        raise KeyError(key)

    def far_parts(self, _key: ShapeKey) -> tuple[int, ...] | None:
        """Parts of a model's meshes as they are seen from afar; None for any other shape."""
        return None

    def far_stems(self, _keys: Sequence[ShapeKey], _world_T_shape: Array, _rows: IntArray) -> NDArray[np.void]:
        """Stems, as `STEM`, of those of placements (n,) that are models, by their first surfaces."""
        return np.zeros(0, STEM)

    def inventory(self, _trees: Trees) -> NDArray[np.void]:
        """Take the inventory (n,) `INVENTORY` of trees that all have models."""
        return np.zeros(0, INVENTORY)

    def circles(self, _trees: Trees) -> NDArray[np.void]:
        """Circles `STEM_CIRCLE` along the stems of trees that all have models."""
        return np.zeros(0, STEM_CIRCLE)
