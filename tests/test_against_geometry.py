"""The hall of `static_bench` against closed formulas for its planes, poles and balls."""

import numpy as np
import pytest
from raycast.reference import ReferenceScene

from vlp16emu.engine import Engine, assemble
from vlp16emu.extras.accuracy.audit import apart_m, compare, errors_of
from vlp16emu.extras.accuracy.sweep import Bench, beam_settings, join_detections
from vlp16emu.scenario import load


def to_box_inside(o, d, half, low, high):
    """Distance to the walls of a room from inside."""
    with np.errstate(divide="ignore"):
        t = np.where(d > 0, (np.array([*half, high]) - o) / d, (np.array([-half[0], -half[1], low]) - o) / d)
    return np.where(np.abs(d) < 1e-12, np.inf, t).min(axis=-1)


def to_box(o, d, centre, size):
    """Distance to an upright box from outside, inf where missed."""
    with np.errstate(divide="ignore"):
        a = (centre - np.divide(size, 2) - o) / d
        b = (centre + np.divide(size, 2) - o) / d
    enter, leave = np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)
    return np.where((enter <= leave) & (enter > 0), enter, np.inf)


def to_pole(o, d, foot, diameter):
    """Distance to an endless upright cylinder."""
    return _quadratic(o[..., :2] - foot[:2], d[..., :2], diameter / 2)


def to_ball(o, d, centre, diameter):
    """Distance to a sphere."""
    return _quadratic(o - centre, d, diameter / 2)


def _quadratic(p, d, r):
    """First positive root of |p + t d| = r."""
    a, b, c = (d * d).sum(-1), (p * d).sum(-1), (p * p).sum(-1) - r * r
    root = b * b - a * c
    near = (-b - np.sqrt(np.maximum(root, 0))) / a
    return np.where((root >= 0) & (near > 0), near, np.inf)


@pytest.fixture(scope="module")
def sweep():
    """One revolution: cast distances, closed-form distances, and which thing is nearest."""
    scenario = load("static_bench")
    world = scenario.world
    returns = list(Engine.of(scenario).returns(0, 0.1))
    o = np.concatenate([r.firings.origin_m for r in returns])
    d = np.concatenate([r.firings.direction for r in returns])
    things = [to_box_inside(o, d, (world.length_m / 2, world.width_m / 2), 0.0, world.height_m)]
    things += [to_box(o, d, np.array(b.centre_m), b.size_m) for b in world.boxes]
    things += [to_pole(o, d, np.array(p.foot_m), p.diameter_m) for p in world.poles]
    things += [to_ball(o, d, np.array(s.centre_m), s.diameter_m) for s in world.spheres]
    things = np.array(things)
    return np.concatenate([r.distance_m[..., 0] for r in returns]), things.min(axis=0), things.argmin(axis=0)


def test_distances_are_true_to_the_millimetre(sweep):
    """All but pulses that graze an edge agree with the closed formulas within 1 mm, half of them within
    0.01 mm."""
    cast_m, true_m, _ = sweep
    error_m = np.abs(cast_m - true_m)
    assert (error_m > 1e-3).mean() < 2e-4
    assert np.median(error_m) < 1e-5


def test_every_thing_in_the_hall_is_seen(sweep):
    """Room, crate, three poles and two balls all give returns, and each of them at its true distance."""
    cast_m, true_m, thing = sweep
    for number in range(7):
        error_m = np.abs(cast_m - true_m)[thing == number]
        assert len(error_m) > 50
        assert np.quantile(error_m, 0.98) < 1e-3


def test_a_hall_of_ten_kilometres_is_true_to_a_hundredth_of_a_millimetre():
    """From 1.5 m over a floor of 10 km every return has the distance of the plane, within 0.01 mm at up to
    131 m."""
    none = [
        "world.boxes=[]",
        "world.poles=[]",
        "world.spheres=[]",
        "noise.preset=ideal",
        "sensor.max_range_m=131.07",
    ]
    scenario = load(
        "static_bench", ["world.length_m=10000.0", "world.width_m=10000.0", "beam.model=none", *none]
    )
    returns = list(Engine.of(scenario).returns(0, 0.1))
    o, d = (np.concatenate([getattr(r.firings, name) for r in returns]) for name in ("origin_m", "direction"))
    cast_m = np.concatenate([r.distance_m[..., 0] for r in returns])
    true_m = to_box_inside(o, d, (5000.0, 5000.0), 0.0, scenario.world.height_m)
    assert np.array_equal(cast_m > 0, true_m <= 131.07)
    assert true_m[cast_m > 0].max() > 80.0
    assert np.abs(cast_m - true_m)[cast_m > 0].max() < 1e-5


class ExactHall(ReferenceScene):
    """The hall without triangles: closed formulas in float64, as a scene that can be cast against."""

    def __init__(self, scenario):
        super().__init__(assemble(scenario).world.window(np.zeros((1, 3))), shape=tuple)
        self._world = scenario.world

    def _rays(self, origin_m, d, *_):
        """Cast rays; nothing in the hall is out of reach."""
        world, o = self._world, origin_m + self._origin_m
        half, high = np.array([world.length_m / 2, world.width_m / 2]), world.height_m
        n = len(o)
        ranges, cosines = [to_box_inside(o, d, half, 0.0, high)], []
        at = o + d * ranges[0][:, None]
        wall = np.concatenate([half - np.abs(at[:, :2]), np.minimum(at[:, 2:], high - at[:, 2:])], axis=1)
        cosines.append(np.abs(d)[np.arange(n), wall.argmin(axis=1)])
        for box in world.boxes:
            ranges.append(to_box(o, d, np.array(box.centre_m), box.size_m))
            at = np.abs(o + d * np.where(np.isfinite(ranges[-1]), ranges[-1], 0.0)[:, None] - box.centre_m)
            cosines.append(np.abs(d)[np.arange(n), (np.divide(box.size_m, 2) - at).argmin(axis=1)])
        for pole in world.poles:
            ranges.append(to_pole(o, d, np.array(pole.foot_m), pole.diameter_m))
            cosines.append(round_cosine(o[:, :2] - pole.foot_m[:2], d[:, :2], ranges[-1], pole.diameter_m))
        for ball in world.spheres:
            ranges.append(to_ball(o, d, np.array(ball.centre_m), ball.diameter_m))
            cosines.append(round_cosine(o - ball.centre_m, d, ranges[-1], ball.diameter_m))
        nearest = np.argmin(ranges, axis=0)
        floor = (nearest == 0) & (wall.argmin(axis=1) == 2) & (d[:, 2] < 0)
        pick = nearest, np.arange(n)
        surface = np.where(floor, 0, nearest + 1).astype(np.uint32)
        return np.array(ranges)[pick].astype(np.float32), surface, np.array(cosines)[pick].astype(np.float32)


def round_cosine(p, d, t, diameter):
    """Cosine of incidence on a cylinder or sphere at range t."""
    with np.errstate(invalid="ignore"):
        return np.abs(((p + d * t[:, None]) * d).sum(-1)) / (diameter / 2)


def test_errors_that_accuracy_reports_are_the_true_ones():
    """Held against closed formulas instead of its own answer, every setting has the same error in the
    hall."""
    scenario = load("static_bench")
    unit = assemble(scenario).units[0]
    bench, apart = Bench(unit, 512), apart_m(scenario.detector)
    settings = [light for light in beam_settings(scenario, unit.seed) if "target" not in light.name]
    exact, opened = ExactHall(scenario), []
    look = lambda *seen: opened.append(seen[3])  # noqa: E731  # the emulator's own scene
    list(Engine.of(scenario, taps=[look]).returns(0, 0.01))
    aimed = [bench.aim(range(first, first + 8)) for first in range(0, 1808, 192)]
    answers = {
        scene: join_detections([bench.answer(scene, firings, settings[-1].beam) for firings in aimed])
        for scene in (opened[0], exact)
    }
    for light in settings:
        returns = join_detections([bench.detections(opened[0], firings, light.beam) for firings in aimed])
        reported, true = (errors_of(compare(answer, returns, apart), apart) for answer in answers.values())
        assert reported.returns == true.returns > 1000
        assert reported.mean_error_m == pytest.approx(true.mean_error_m, rel=0.05, abs=1e-4), light.name
        assert reported.range_rmse_m == pytest.approx(true.range_rmse_m, rel=0.05, abs=3e-4), light.name
        assert reported.reflectivity_rmse == pytest.approx(true.reflectivity_rmse, rel=0.1, abs=0.1), (
            light.name
        )
