"""Conditions of a real walk in the field: the tables that `conditions = "field"` gives."""

from vlp16emu.settings import merge_tables
from vlp16emu.trees import Tree

_MOUNT = {"error_deg": 0.3, "error_mm": 5.0}
"""Extrinsics of a backpack are known within a degree and a centimetre by self-calibration (Pan, Shao et al.,
IEEE TGRS 61, 5703713, 2023); from a drawing within a third of a degree and half a centimetre for each axis
(assumption)."""
_DELAY_S = (0.016, 0.020)
"""With the 4 ms of jitter of `imu.preset = "field"` 20 ms on average, as between a Velodyne and other sensors
without a wire for their clocks (ros-drivers/velodyne, pull request 88)."""
_FIELD: Tree = {"imu": {"preset": "field", "delay_s": _DELAY_S, "mount": _MOUNT}}
_STRAPS_HZ = 4.0
"""Straps of a pack worn tight: twice the 2 Hz of suspended packs (source in `Harness`), assumption."""
_AXES = ("fore_aft", "sideways", "vertical", "roll", "pitch", "yaw")
_ON_FOOT: Tree = {
    "motion": {
        "kind": "walk",
        "gait": {"preset": "uneven"},
        "harness": {f"{axis}_hz": _STRAPS_HZ for axis in _AXES},
        "mount": _MOUNT,
        "mast": {},
    },
    "people": {},
}
_FORESTS = ("forest", "plot")
_IN_A_FOREST: Tree = {"wind": {"speed_m_s": 2.0}}
"""A light breeze, 1.6 to 3.3 m/s (Beaufort scale, WMO code table 1100)."""


def in_the_field(tree: Tree) -> Tree:
    """Return a scene with the keys of field conditions that it does not give itself."""
    motion, world = (
        one.get("kind") if isinstance(one := tree.get(key), dict) else None for key in ("motion", "world")
    )
    base = _FIELD | (_ON_FOOT if motion == "walk" else {}) | (_IN_A_FOREST if world in _FORESTS else {})
    units = tree.get("rig")
    if isinstance(units, list):
        tree = tree | {
            "rig": [merge_tables({"mount": _MOUNT}, one) if isinstance(one, dict) else one for one in units]
        }
    return merge_tables(base, tree)
