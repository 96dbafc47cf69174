"""Trees of the user's own in the place of grown ones, as a forest knows them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import log
from vlp16emu.foliage.tiles import STEM
from vlp16emu.forest.plants.flora import Flora, Trees, flora
from vlp16emu.forest.plants.stem_rings import STEM_CIRCLE
from vlp16emu.forest.stand.inventory import COPIED, INVENTORY
from vlp16emu.forest.stand.placed import PlacedThings, plant_surfaces
from vlp16emu.types import Array, IntArray, Mesh, ShapeKey

_ALIKE = 1.25  # models that stretch a tree by no more than this over the one that stretches it least are as good


@dataclass(frozen=True, slots=True)
class ModelKey:
    """Name of a model's shape."""

    number: int  # among the models of the scene
    content: str  # digest of all that decides it


class Models:
    """The models of a scene, each a `TreeModel` that stands for trees of its species; none by default."""

    def __init__(self, models: Sequence[Any] = (), plants: Flora | None = None) -> None:
        self._models, self._plants = models, plants or flora()
        self._species = np.array(sorted({model.species.number for model in models}), np.uint16)

    def has(self, trees: Trees) -> NDArray[np.bool_]:
        """Which trees (n,) look like one of the models."""
        return np.isin(trees["species"], self._species)

    def placed(self, trees: Trees, *, is_exact: bool) -> list[PlacedThings]:
        """Place trees (n,) that all have models: those of each model together; `is_exact` as of `PlacedThings`."""
        return [
            PlacedThings(
                (ModelKey(i, self._models[i].content),),
                np.zeros(len(own), np.int64),
                self._models[i].world_T_model(own),
                plant_surfaces(own, self._models[i].parts, self._plants),
                own,
                is_exact=is_exact,
            )
            for i, own in self._by_model(trees)
        ]

    def shape(self, key: ModelKey) -> tuple[Mesh, ...]:
        """Meshes of a model."""
        meshes: tuple[Mesh, ...] = self._models[key.number].meshes
        return meshes

    def far_parts(self, key: ShapeKey) -> tuple[int, ...] | None:
        """Parts of a model's meshes as they are seen from afar; None for any other shape."""
        return self._models[key.number].far_parts if isinstance(key, ModelKey) else None

    def far_stems(self, keys: Sequence[ShapeKey], world_T_shape: Array, rows: IntArray) -> NDArray[np.void]:
        """Stems, as `STEM`, of those of placements (n,) that are models, by their first surfaces."""
        of = np.array([key.number if isinstance(key, ModelKey) else -1 for key in keys], np.int64)
        stems = (model.far_stems(world_T_shape[of == i], rows[of == i]) for i, model in enumerate(self._models))
        return np.concatenate([np.zeros(0, STEM), *stems])

    def inventory(self, trees: Trees) -> NDArray[np.void]:
        """Take the inventory (n,) `INVENTORY` of trees that all have models, from their meshes.

        The crown begins with the lowest leaf, or branch where there are no leaves; its width is the mean over all
        directions. One side of each leaf face counts.
        """
        rows = np.zeros(len(trees), INVENTORY)
        for name in COPIED:
            rows[name] = trees[name]
        for i, row in enumerate(rows):
            self._models[self._chosen(trees[i : i + 1])].measure(row, trees[i : i + 1])
        return rows

    def circles(self, trees: Trees) -> NDArray[np.void]:
        """Circles `STEM_CIRCLE` along the stems of trees that all have models."""
        own = (self._models[i].circles(own) for i, own in self._by_model(trees))
        return np.concatenate([np.zeros(0, STEM_CIRCLE), *own])

    def _by_model(self, trees: Trees) -> list[tuple[int, Trees]]:
        chosen = np.array([self._chosen(trees[i : i + 1]) for i in range(len(trees))], np.int64)
        return [(i, trees[chosen == i]) for i in np.unique(chosen).tolist()]

    def _chosen(self, tree: Trees) -> int:
        """Choose the model of one tree (1,) by its size, and among those that are as good by its azimuth's last digits."""
        fits = [i for i, model in enumerate(self._models) if model.species.number == tree["species"][0]]
        if len(fits) == 1:
            return fits[0]
        stretch = [abs(float(log(across / along))) for i in fits for across, along in self._models[i].scale(tree)]
        good = [i for i, own in zip(fits, stretch, strict=True) if own <= min(stretch) + log(_ALIKE)]
        return good[int(tree["crown_azimuth_deg"][0] * 1e6) % len(good)]
