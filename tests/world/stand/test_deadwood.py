"""Logs that are uprooted, broken and rotten, and broken stumps."""

from itertools import product

import numpy as np
import pytest

from vlp16emu.types import PlantPart, Semantic
from vlp16emu.world.polyline import Corridor, distance_m
from vlp16emu.world.stand.floor_shapes import FloorKind
from vlp16emu.world.stand.placed import Site
from vlp16emu.world.stand.scatter import layer_of
from vlp16emu.world.stand.settings import Logs, Stumps

FAR = np.array([[0.0, 1e5]])
NEAR = np.array([[-10.0, 10.0], [170.0, 60.0]])
NO_TRUNKS = np.zeros((0, 3))
TILES = list(product(range(8), range(8)))
SIZES = {"per_ha": 200.0, "species": ["norway_spruce"], "diameter_m": (0.2, 0.6), "length_m": (3.0, 12.0)}


def layer(**shares):
    return layer_of(Logs(**SIZES, **{"uprooted": 0.0, "broken": 0.0, "decayed": 0.0, **shares}), seed=6)


def placed(one, *, path=FAR, trunks=NO_TRUNKS, tiles=TILES):
    """Transforms and surface rows by kind, of 2.6 hectares of level ground."""
    found = {}
    for ix, iy in tiles:
        site = Site(
            seed=6, ix=ix, iy=iy, height_m=lambda x, y: 0 * x, path=Corridor(path, 0.8), trunks=trunks
        )
        things = one.place(site)
        for i, which in enumerate(things.shape.tolist()):
            kind = things.keys[which].kind
            found.setdefault(kind, []).append((things.world_T_shape[i], things.surfaces[i, 0]))
    return {
        kind: (np.array([T for T, _ in rows]), np.array([row for _, row in rows]))
        for kind, rows in found.items()
    }


def size_m(world_T):
    return np.linalg.norm(world_T[:, :, :3], axis=1)


def test_shares_are_those_that_were_asked_for():
    """Of some 500 logs the shares with plates, in two pieces and flattened are those of the section, within 3 sigma."""
    found = placed(layer(uprooted=0.3, broken=0.25, decayed=0.4))
    whole, pieces, plates = (
        len(found[kind][0]) for kind in (FloorKind.LOG, FloorKind.BROKEN_LOG, FloorKind.ROOT_PLATE)
    )
    logs = whole + pieces / 2
    _, wide, high = size_m(found[FloorKind.LOG][0]).T
    for share, expected in (
        (plates / logs, 0.3),
        (pieces / 2 / logs, 0.25),
        ((high < 0.9 * wide).mean(), 0.7 * 0.4),
    ):
        assert share == pytest.approx(expected, abs=3 * np.sqrt(expected * (1 - expected) / whole))


def test_a_root_plate_stands_at_the_butt():
    """Its origin is the thick end of its log, across which it stands, 0.3 of its width over the ground; it is 1 m and four diameters wide."""
    found = placed(layer(uprooted=1.0))
    logs, (plates, rows) = found[FloorKind.LOG][0], found[FloorKind.ROOT_PLATE]
    butt_m = logs[:, :, 3] - logs[:, :, 0] / 2
    assert plates[:, :, 3] == pytest.approx(butt_m)
    length, diameter, _ = size_m(logs).T
    wide = size_m(plates)
    assert wide[:, 1] == pytest.approx(1 + 4 * diameter)
    assert wide[:, 0] == pytest.approx(wide[:, 1] / 4)
    assert butt_m[:, 2] == pytest.approx(0.3 * wide[:, 1], abs=0.05)
    along = (plates[:, :, 0] / wide[:, :1] * logs[:, :, 0] / length[:, None]).sum(axis=1)
    assert along == pytest.approx(1.0)
    assert set(rows["semantic"]) == {Semantic.DEADWOOD}
    assert set(rows["part"]) == {PlantPart.ROOT_FLARE}


def test_the_top_of_an_uprooted_log_lies_on_the_ground():
    """The axis of its thin end is less than its radius over the ground, up to what its straight line rises."""
    logs = placed(layer(uprooted=1.0))[FloorKind.LOG][0]
    top_m = (logs[:, :, 3] + logs[:, :, 0] / 2)[:, 2]
    assert top_m == pytest.approx(0.75 * size_m(logs)[:, 1] / 2, abs=0.02)


def test_a_broken_log_lies_in_two_pieces_with_a_gap():
    """The upper piece is thinner, begins 2 to 10 % of the length beyond the lower one, and is turned by up to 12 degrees."""
    for tile in TILES[:16]:
        whole = placed(layer(), tiles=[tile])[FloorKind.LOG][0]
        pieces = placed(layer(broken=1.0), tiles=[tile])[FloorKind.BROKEN_LOG][0]
        butts, tops = np.split(pieces, 2)
        length, diameter, _ = size_m(whole).T
        assert butts[:, :2, 3] - butts[:, :2, 0] / 2 == pytest.approx(whole[:, :2, 3] - whole[:, :2, 0] / 2)
        gap_m = tops[:, :2, 3] - tops[:, :2, 0] / 2 - butts[:, :2, 3] - butts[:, :2, 0] / 2
        share = np.hypot(*gap_m.T) / length
        assert ((share > 0.0199) & (share < 0.1001)).all()
        assert (size_m(tops)[:, 1] < diameter).all()
        assert (diameter < size_m(butts)[:, 1]).all()
        along = [
            piece[:, :2, 0] / np.linalg.norm(piece[:, :2, 0], axis=1, keepdims=True)
            for piece in (butts, tops)
        ]
        assert (along[0] * along[1]).sum(axis=1).min() > np.cos(np.radians(12.01))


def test_a_rotten_log_is_flat_and_sunk():
    """Up to half as high as it was and a fifth wider, with its upper side 0.3 to 0.75 of its former diameter over the ground."""
    logs, sound = (placed(layer(decayed=share))[FloorKind.LOG][0] for share in (1.0, 0.0))
    (_, wide, high), (_, diameter, _) = size_m(logs).T, size_m(sound).T
    assert ((high / diameter < 0.86) & (high / diameter > 0.49)).all()
    assert ((wide / diameter > 1.05) & (wide / diameter < 1.21)).all()
    top = (logs[:, 2, 3] + high / 2) / diameter
    assert ((top > 0.3) & (top < 0.76)).all()


def test_plates_and_pieces_keep_off_the_path_and_trunks():
    """No part of a plate is nearer to the path than 0.8 m, or in a trunk; a log is left out whole if any part of it would be."""
    one, trunk = layer(uprooted=0.5, broken=0.5), np.array([[50.0, 90.0, 6.0]])
    found = placed(one, path=NEAR, trunks=trunk)
    plates = found[FloorKind.ROOT_PLATE][0]
    assert len(plates) > 50
    edges_m = np.concatenate([plates[:, :2, 3] + side * plates[:, :2, 1] for side in (-0.5, 0.0, 0.5)])
    assert distance_m(edges_m, NEAR).min() >= 0.8
    assert np.hypot(*(edges_m - trunk[0, :2]).T).min() >= 6.0
    assert len(found[FloorKind.BROKEN_LOG][0]) % 2 == 0
    free = placed(one)
    assert len(free[FloorKind.ROOT_PLATE][0]) > len(plates)


def test_stumps_are_broken_by_share():
    """Three in ten stumps are jagged, within 3 sigma, and all of them lie where they would without."""
    section = {"per_ha": 200.0, "species": ["silver_birch"]}
    found = placed(layer_of(Stumps(**section, broken=0.3), seed=6))
    (sound,), (broken,) = ([found[kind][0]] for kind in (FloorKind.STUMP, FloorKind.BROKEN_STUMP))
    n = len(sound) + len(broken)
    assert len(broken) / n == pytest.approx(0.3, abs=3 * np.sqrt(0.21 / n))
    felled = placed(layer_of(Stumps(**section, broken=0.0), seed=6))[FloorKind.STUMP][0]
    rows = {row.tobytes() for row in felled}
    assert {row.tobytes() for row in np.concatenate([sound, broken])} == rows
