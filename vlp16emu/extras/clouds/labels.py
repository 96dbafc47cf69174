"""Labels as the data sets that people train on have them. The classes of each scheme are in labels.toml, with their source."""

from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import InputError
from vlp16emu.settings import toml
from vlp16emu.types import HeightField, PlantPart, Semantic


@cache
def _schemes() -> Mapping[str, Mapping[str, Any]]:
    return toml(files("vlp16emu.extras.clouds").joinpath("labels.toml").read_text("utf-8"))


def scheme_names() -> tuple[str, ...]:
    """Return the names of all schemes."""
    return tuple(_schemes())


class LabelScheme:
    """Numbers of classes by semantic class and plant part, from a table of labels.toml."""

    def __init__(self, name: str, table: Mapping[str, Any]) -> None:
        self.name = name
        self.source: str = table["source"]  # publisher of the numbers, and their meaning
        self._codes = np.full((len(Semantic), len(PlantPart)), table["none"], np.uint8)
        for semantic in Semantic:
            for part in PlantPart:
                keys = f"{semantic.name}.{part.name}".lower(), semantic.name.lower()
                self._codes[semantic, part] = next((table[k] for k in keys if k in table), table["none"])

    def codes(self, semantic: NDArray[np.uint8], part: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Classes (n,) of points by `Semantic` (n,) and `PlantPart` (n,)."""
        codes: NDArray[np.uint8] = self._codes[semantic, part]
        return codes


def label_scheme(name: str, *, where: str = "labels") -> LabelScheme:
    """Return a scheme by its name; InputError, in the name of `where`, if there is none."""
    if name not in _schemes():
        raise InputError(where, f"found {name}", ", ".join(scheme_names()))
    return LabelScheme(name, _schemes()[name])


class PointLabels:
    """Labels of points by one scheme, block by block, and heights over the ground."""

    def __init__(self, scheme: LabelScheme, height_m: HeightField) -> None:
        self._scheme, self._height_m = scheme, height_m
        self._numbers: dict[int, int] = {}

    def of(self, points: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Return arrays (n,) `label`, `tree_id` and `height_m` by `world_m` (n, 3), `semantic`, `part`, `instance` (n,)."""
        x_m, y_m, z_m = np.ascontiguousarray(points["world_m"].T)
        return {
            "label": self._scheme.codes(points["semantic"], points["part"]),
            "tree_id": self._dense(points["instance"], points["semantic"]),
            "height_m": (z_m - self._height_m(x_m, y_m)).astype(np.float32),
        }

    def _dense(self, instance: NDArray[np.uint32], semantic: NDArray[np.uint8]) -> NDArray[np.uint32]:
        """Numbers (n,) of the trees, 1, 2, 3 ... in the order in which they are met; 0 of what is no tree."""
        is_tree = semantic == Semantic.TREE
        met, first, back = np.unique(instance[is_tree], return_index=True, return_inverse=True)
        for i in np.argsort(first).tolist():
            self._numbers.setdefault(int(met[i]), len(self._numbers) + 1)
        dense = np.zeros(len(instance), np.uint32)
        dense[is_tree] = np.array([self._numbers[i] for i in met.tolist()], np.uint32)[back]
        return dense
