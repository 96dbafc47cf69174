"""What surfaces are made of, by `SURFACE` material number."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from vlp16emu.world.plants.flora import Flora

__all__ = ["BARK_SPREAD", "GROUND_MATERIALS", "LEAF_SPREAD", "bark_material", "material_names"]

GROUND_MATERIALS = ("litter", "stone", "dead wood", "grass")
"""Names of the first numbers."""


BARK_SPREAD, LEAF_SPREAD = 0.08, 0.04
"""Half-range of reflectance between plants; assumptions (wide spread in the near infrared: Juola et al. 2020)."""


def material_names(plants: Flora) -> tuple[str, ...]:
    """All materials by number: those on the ground, then bark and leaf of each tree and shrub."""
    parts = (f"{name} {what}" for name in (*plants.trees, *plants.shrubs) for what in ("bark", "leaf"))
    return (*GROUND_MATERIALS, *parts)


def bark_material(species: NDArray[np.uint16], plants: Flora) -> NDArray[np.int64]:
    """Material numbers of the bark of species by number, (n,); that of the leaf is the next."""
    row: NDArray[np.int64] = _rows(plants)[species]
    return len(GROUND_MATERIALS) + 2 * row


@cache
def _rows(plants: Flora) -> NDArray[np.int64]:
    """Place in the table by species number."""
    numbers = list(plants.names)
    row_of = np.zeros(max(numbers) + 1, np.int64)
    row_of[numbers] = np.arange(len(numbers))
    return row_of
