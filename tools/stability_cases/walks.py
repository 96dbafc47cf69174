"""Walks that hardly can be walked, sharp turns of a path, and the tenth hour of a walk."""

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from stability_cases.case import Row, case, refusal
from stability_cases.poses import smooth
from vlp16emu import Emulator
from vlp16emu.engine import assemble
from vlp16emu.extras.walk.path import Path
from vlp16emu.extras.walk.route import Route
from vlp16emu.extras.walk.settings import Walk
from vlp16emu.motion.pose import Motion
from vlp16emu.scenario import Scenario, load
from vlp16emu.types import PacketKind
from vlp16emu.units import S_NS

Points = Sequence[tuple[float, float]]

_TEN_HOURS_S = 36_000


def _scenario(points_m: Points, keys: str = "harness={}") -> Scenario:
    points = [list(point) for point in points_m]
    motion = f'motion={{kind="walk",way_points_m={points},{keys}}}'
    return load("static_bench", [motion, "world.length_m=60.0", "world.width_m=60.0"])


def _walk(points_m: Points, keys: str = "harness={}") -> tuple[Motion, int]:
    scenario = _scenario(points_m, keys)
    return assemble(scenario).motion, scenario.start_ns


def _hairpin(width_m: float, away_m: float = 0.0) -> Points:
    half_m = width_m / 2
    way = [(0.0, 0.0), (6.0, 0.0), (6.0 + half_m, half_m), (6.0, width_m), (0.0, width_m)]
    return [(x + away_m, y + away_m) for x, y in way]


@case("refusal")
def impossible_paths() -> Iterator[Row]:
    """Paths that no person takes."""
    for name, points_m, says in (
        ("a waypoint twice", [(0, 0), (5, 0), (5, 0), (9, 1)], "coincides with the one before it"),
        ("a path of one waypoint", [(1, 2)], "a list of at least 2"),
        ("a path back on itself", [(0, 0), (9, 0), (0, 0)], "at least 0.1 m"),
        ("a hairpin of 0.2 m", _hairpin(0.2), "at least 0.1 m"),
        ("a path of ten thousand kilometres", [(0, 0), (1e7, 0)], "within 1e+06 m"),
        ("a path of 150 km", [(0, 0), (150_000, 0)], "at most 100 km"),
    ):
        yield refusal(name, partial(_walk, points_m), says)


def _with_prefix(rows: Iterator[Row], name: str) -> Iterator[Row]:
    for row in rows:
        yield row._replace(quantity=f"{name}: {row.quantity}")


@case("closed form: velocity over 0.5 ms, continuity")
def hairpins() -> Iterator[Row]:
    """Turns within two feet, with loose straps, here and 100 km away, and reversals at the ends of a path."""
    for away_m in (0.0, 1e5):
        motion, start_ns = _walk(_hairpin(0.6, away_m))
        rows = smooth(motion, start_ns, motion.run_time_s)
        yield from _with_prefix(rows, f"0.6 m, {away_m / 1000:g} km away")
    motion, start_ns = _walk([(0.0, 0.0), (5.0, 0.0)], "harness={},back_and_forth=true,laps=2")
    yield from _with_prefix(smooth(motion, start_ns, motion.run_time_s), "there and back")


@case("closed form: a circle")
def tight_and_wide_circles() -> Iterator[Row]:
    """Circles of 0.15 m, near the smallest radius that is walked, to 1 km, through 24 waypoints each."""
    for radius_m in (0.15, 1.0, 100.0, 1000.0):
        angle = 2 * np.pi * np.arange(25) / 24
        way_m = radius_m * np.column_stack([np.cos(angle), np.sin(angle)])
        way_m[-1] = way_m[0]
        path = Path(way_m, lambda x_m, _: 0 * x_m)
        at_m = np.linspace(0.0, path.length_m, 5_001)
        point_m = path.derivatives_at(at_m)[0][:, 0, :2]
        off = np.abs(np.hypot(*point_m.T) / radius_m - 1).max()
        yield Row("radius, relative", float(off), 1e-4)
        turn = np.abs(path.turn_rad_m(at_m) * radius_m - 1).max()
        yield Row("curvature, relative", float(turn), 0.02)
        tangent = np.linalg.norm(path.derivatives_at(at_m)[0][:, 1], axis=1)
        yield Row("length of the tangent, less one", float(np.abs(tangent - 1).max()), 1e-5)
        closed = path.derivatives_at(np.array([0.0, path.length_m]))[0]
        gap = np.abs(closed[0] - closed[1]).max() / radius_m
        yield Row("gap where it closes, over the radius", float(gap), 1e-11)


def _ring() -> Points:
    angle = 2 * np.pi * np.arange(13) / 12
    points = np.column_stack([8 * np.cos(angle) - 8, 8 * np.sin(angle)]).round(3)
    points[-1] = points[0]
    return [(float(x), float(y)) for x, y in points]


def _route() -> tuple[Path, Route]:
    path = Path(np.array(_ring()), lambda x_m, _: 0 * x_m)
    walk = Walk(kind="walk", way_points_m=_ring(), laps=1000)
    return path, Route(path, walk, np.zeros(13))


@case("closed form: speed times time along the path", is_slow=True)
def ten_hours_on_a_route() -> Iterator[Row]:
    """The tenth hour of a walk of 1000 laps: 43 km along a path in two million cells."""
    path, route = _route()
    since_s = np.linspace(0.0, 40.0, 4001)
    early = route.at(np.array([100.0]))[0][0, :3, 0]  # at cruise speed, in the third lap
    look_m = np.linspace(0.0, path.length_m, 1_000_001)
    nearest = int(np.linalg.norm(path.derivatives_at(look_m)[0][:, 0] - early, axis=1).argmin())
    point_m, tangent = path.derivatives_at(look_m[nearest : nearest + 1])[0][0, :2]
    early_m = look_m[nearest] + float((early - point_m) @ tangent) / float(tangent @ tangent)
    along_m = early_m + route.speed_m_s * (_TEN_HOURS_S - 100 + since_s)
    nodes, speed_m_s = route.at(_TEN_HOURS_S + since_s)
    true_m = path.derivatives_at(along_m % path.length_m)[0][:, 0]
    # The time is the sum of two million cells of 2 cm.
    yield Row("position, m", float(np.abs(nodes[:, :3, 0] - true_m).max()), 1e-6)
    yield Row("speed, m/s", float(np.abs(speed_m_s - route.speed_m_s).max()), 1e-9)


@case("the same packets from a run that came there; continuity", is_slow=True)
def ten_hours_of_steps() -> Iterator[Row]:
    """Gait, loose straps and mast in the tenth hour, computed at once, and after the seconds before."""
    scenario = _scenario(_ring(), "harness={},mast={},laps=1000")
    motion = assemble(scenario).motion
    tenth_ns = scenario.start_ns + _TEN_HOURS_S * S_NS
    yield from smooth(motion, tenth_ns, 20.0)
    span_s = _TEN_HOURS_S + 0.03, _TEN_HOURS_S + 0.06
    direct = [p.payload for p in Emulator(scenario).packets(*span_s) if p.kind is PacketKind.DATA]
    emulator = Emulator(scenario)
    list(emulator.packets(_TEN_HOURS_S - 0.5, _TEN_HOURS_S - 0.45))
    later = [p for p in emulator.packets(_TEN_HOURS_S, span_s[1]) if p.kind is PacketKind.DATA]
    after = [p.payload for p in later][-len(direct) :]
    differ = sum(a != b for a, b in zip(direct, after, strict=True))
    yield Row(f"packets that differ, of {len(direct)}", differ, 0)
