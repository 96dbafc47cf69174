"""Faces that are thin, grazed, edge-on, or where the sensor itself is."""

import numpy as np
from stability.lab import PULSES, beam, cast, detected, faces, opened, pulses, unit_of, wall

from vlp16emu import Emulator
from vlp16emu.scenario import load

_FLOOR_M = 150.0
_FLOAT32 = 2.0**-23


def test_slivers():
    """No pulse goes through a wall of triangles ten thousand and ten million times longer than wide; ranges are true to 10 um."""
    for width_m in (2e-3, 2e-6):
        edge_m = width_m * (np.arange(4001) - 2000)
        low, high = np.full(4000, -10.0), np.full(4000, 10.0)
        x = np.full(4000, 10.0)
        a, b = np.column_stack([x, edge_m[:-1], low]), np.column_stack([x, edge_m[1:], low])
        c, d = np.column_stack([x, edge_m[1:], high]), np.column_stack([x, edge_m[:-1], high])
        corners = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
        count = 16 * PULSES
        rng = np.random.default_rng(2)
        target = np.column_stack(
            [np.full(count, 10.0), edge_m[-1] * rng.uniform(-0.99, 0.99, count), rng.uniform(-9, 9, count)]
        )
        range_m = np.linalg.norm(target, axis=1)
        hits = cast(opened([faces(corners)]), pulses(np.zeros((count, 3)), target / range_m[:, None]))
        met = np.isfinite(hits.range_m)
        name = f"slivers {width_m:g} m wide, 20 m long"
        assert met.all(), name
        assert np.abs(hits.range_m - range_m)[met].max() <= 1e-5, name


def test_inside():
    """A sensor in a closed box sees its walls; one whose spin axis lies in a surface sees through it."""
    box_m = 'world.boxes=[{name="cage",centre_m=[0,0,1.5],size_m=[2,2,2]}]'
    returns = list(Emulator(load("static_bench", [box_m])).returns(0.0, 0.1))
    origin = np.concatenate([r.firings.origin_m for r in returns]) - [0, 0, 1.5]
    direction = np.concatenate([r.firings.direction for r in returns])
    with np.errstate(divide="ignore"):
        true_m = ((1.0 - np.sign(direction) * origin) / np.abs(direction)).min(axis=-1)
    got_m = np.concatenate([r.distance_m[..., 0] for r in returns])
    assert np.abs(got_m - true_m).max() <= 1e-5

    plate, far = faces(np.array([[(0, -9, -9), (0, 9, -9), (0, 9, 9), (0, -9, 9)]])), wall(5.0, 500.0)
    head = unit_of("static_bench").head
    aimed = head.aim(0, 1920, unit_of("static_bench", "motion.height_m=1.5").motion.poses_at)
    direction = aimed.direction.reshape(-1, 3)
    origin = np.zeros_like(direction)
    hits = cast(opened([plate, far]), pulses(origin, direction))
    ahead = direction[:, 0] > 0.1
    seen = hits.surface[ahead] == 1
    assert seen.all()  # pulses stopped by it
    error_m = np.abs(hits.range_m - 5.0 / np.where(ahead, direction[:, 0], np.inf))[ahead]
    assert error_m.max() <= 1e-4  # largest error of the wall behind, m


def test_edge_on():
    """Behind leaves in the plane of the pulse, exactly and within a billionth of a degree, the wall is seen at its range."""
    count = 8 * PULSES
    tilt_rad = np.concatenate([np.zeros(PULSES), np.geomspace(1e-11, 1e-4, count - PULSES)])
    y_m = 0.5 * np.arange(count)
    corners = np.array([(9.97, 0, -0.02), (10.03, 0, -0.02), (10.03, 0, 0.02), (9.97, 0, 0.02)])
    leaves = np.tile(corners, (count, 1, 1))
    leaves[:, :, 1] = y_m[:, None] + (leaves[:, :, 0] - 10.0) * tilt_rad[:, None]
    scene = opened([faces(leaves), wall(15.0, 2 * y_m[-1])])
    firings = pulses(np.column_stack([0 * y_m, y_m, 0 * y_m]), np.tile([1.0, 0.0, 0.0], (count, 1)))
    for name, light in (("one ray", None), ("64 rays", beam("fixed"))):
        hits = cast(scene, firings) if light is None else cast(scene, firings, light)
        sound = np.isfinite(hits.range_m) & (hits.cos_incidence >= 0) & (hits.cos_incidence <= 1)
        assert sound.all(), f"leaf edge-on, {name}"  # rays lost or without a cosine
        if light is not None:
            error_m = np.abs(detected(scene, firings, light).distance_m[..., 0] - 15.0)
            assert error_m.max() <= 1e-4, f"leaf edge-on, {name}"  # error of the wall behind, m


def test_grazing():
    """A floor at up to 89.99 degrees from its normal, 10 to 100 m away, is met to four steps of float32."""
    floor = [(-_FLOOR_M, -_FLOOR_M, 0), (_FLOOR_M, -_FLOOR_M, 0), (_FLOOR_M, _FLOOR_M, 0), (-_FLOOR_M, _FLOOR_M, 0)]
    scene = opened([faces(np.array([floor]))])
    for incidence_deg in (80.0, 89.0, 89.9, 89.99):
        cosine = np.cos(np.radians(incidence_deg))
        level = np.sqrt(1 - cosine**2)
        range_m = np.linspace(10.0, 100.0, PULSES)
        turned = np.linspace(0.0, 2 * np.pi, PULSES)
        origin_m = np.column_stack([0 * turned, 0 * turned, range_m * cosine])
        direction = np.column_stack([level * np.cos(turned), level * np.sin(turned), np.full(PULSES, -cosine)])
        firings = pulses(origin_m, direction)
        hits = cast(scene, firings)
        error_m = float(np.abs(hits.range_m - range_m).max())
        assert error_m <= 4 * 100 * _FLOAT32, f"floor at {incidence_deg:g} deg"
        wide = detected(scene, firings, beam("adaptive"))
        fit = np.isfinite(wide.distance_m) & (wide.distance_m >= 0) & (wide.distance_m <= 131.07)
        assert fit.all(), f"floor at {incidence_deg:g} deg, wide beam"  # returns out of limits
