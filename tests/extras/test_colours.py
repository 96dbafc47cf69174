"""Colours that stand side by side in pictures."""

import itertools

import numpy as np
import pytest

from vlp16emu.extras.colours import colour_of_kind, colours_of_plant

STANDS = (
    ("silver_birch", "norway_spruce", "scots_pine", "european_beech", "sycamore", "english_oak"),
    ("white_oak", "black_walnut"),
    ("sugar_maple", "red_maple", "white_oak", "black_walnut"),
)
"""Species that grow together in scenes and presets, and North American ones."""
SIGHTS = {
    "normal": np.eye(3),
    # Machado, Oliveira and Fernandes (2009), severity 1, for linear RGB.
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
}
LEAST = 12.0  # differences of CIE 1976; 2.3 is just noticeable


def lab(rgb, sight):
    """Return the colour as seen, in CIE L*a*b*, white D65."""
    share = np.array(rgb) / 255
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    to_xyz = np.array(
        [
            [0.4124564, 0.3575761, 0.1804375],
            [0.2126729, 0.7151522, 0.0721750],
            [0.0193339, 0.1191920, 0.9503041],
        ]
    )
    xyz = to_xyz @ np.clip(np.array(SIGHTS[sight]) @ linear, 0, 1) / [0.95047, 1.0, 1.08883]
    x, y, z = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


@pytest.mark.parametrize("sight", SIGHTS)
@pytest.mark.parametrize("stand", STANDS, ids=lambda stand: stand[0])
def test_leaves_stems_ground_and_undergrowth_can_be_told_apart(stand, sight):
    """Leaves of species that grow together differ from each other, from stems, ground, grass, stones and
    shrubs, and stems from the ground."""
    leaves = {name: colours_of_plant(name)[0] for name in stand}
    stems = {f"stem of {name}": colours_of_plant(name)[1] for name in stand}
    floor = {name: colour_of_kind(name) for name in ("ground", "grass", "stone", "shrub")}
    pairs = [*itertools.combinations(leaves.items(), 2), *itertools.combinations(floor.items(), 2)]
    pairs += itertools.product(leaves.items(), (stems | floor).items())
    pairs += itertools.product(stems.items(), [(name, rgb) for name, rgb in floor.items() if name != "stone"])
    close = [
        (a, b)
        for (a, one), (b, other) in pairs
        if np.linalg.norm(lab(one, sight) - lab(other, sight)) < LEAST
    ]
    assert close == []
