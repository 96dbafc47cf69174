"""Faces that are thin, tilted, doubled, crossed, grazed, edge-on, or where the sensor itself is."""

from collections.abc import Iterator

import numpy as np
from mpmath import mp, mpf

from stability_cases.case import Row, case
from stability_cases.lab import PULSES, beam, cast, detect_pulses, faces, open_scene, pulses, unit_of, wall
from vlp16emu import Emulator
from vlp16emu.engine import Engine
from vlp16emu.scenario import load
from vlp16emu.types import F8, Firings, Mesh

_FLOOR_M = 150.0
_FLOAT32 = 2.0**-23
_CLOSED = "closed form in float64"


def _cone(count: int, half_deg: float) -> Firings:
    """Pulses from the origin within a square cone about x."""
    reach = np.tan(np.radians(half_deg))
    aside = np.random.default_rng(1).uniform(-reach, reach, (count, 2))
    direction = np.column_stack([np.ones(count), aside])
    return pulses(np.zeros((count, 3)), direction / np.linalg.norm(direction, axis=1)[:, None])


@case(_CLOSED)
def slivers() -> Iterator[Row]:
    """A wall of triangles ten thousand and ten million times longer than wide."""
    for width_m in (2e-3, 2e-6):
        edge_m = width_m * (np.arange(4001) - 2000)
        low = np.full(4000, -10.0)
        high = np.full(4000, 10.0)
        x = np.full(4000, 10.0)
        a = np.column_stack([x, edge_m[:-1], low])
        b = np.column_stack([x, edge_m[1:], low])
        c = np.column_stack([x, edge_m[1:], high])
        d = np.column_stack([x, edge_m[:-1], high])
        corners = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
        count = 16 * PULSES
        rng = np.random.default_rng(2)
        y_m = edge_m[-1] * rng.uniform(-0.99, 0.99, count)
        target = np.column_stack([np.full(count, 10.0), y_m, rng.uniform(-9, 9, count)])
        range_m = np.linalg.norm(target, axis=1)
        hits = cast(open_scene([faces(corners)]), pulses(np.zeros((count, 3)), target / range_m[:, None]))
        met = np.isfinite(hits.range_m)
        yield Row(f"{width_m:g} m wide: pulses through, of {count}", int((~met).sum()), 0)
        yield Row(f"{width_m:g} m wide: range, m", float(np.abs(hits.range_m - range_m)[met].max()), 1e-5)


@case(_CLOSED)
def fan() -> Iterator[Row]:
    """A disc of 20 000 slivers of 12 m that share one corner, hit from its rim to 1 mm from the corner."""
    count = 20_000
    angle = 2 * np.pi * np.arange(count) / count
    rim = np.column_stack([np.full(count, 10.0), 12 * np.cos(angle), 12 * np.sin(angle)])
    vertices = np.concatenate([[[10.0, 0.0, 0.0]], rim]).astype(np.float32)
    number = np.arange(count, dtype=np.uint32)
    triangles = np.column_stack([0 * number, number + 1, (number + 1) % count + 1]).astype(np.uint32)
    shots = 16 * PULSES
    rng = np.random.default_rng(3)
    turn = rng.uniform(0, 2 * np.pi, shots)
    away_m = np.geomspace(1e-3, 11.9, shots)
    target = np.column_stack([np.full(shots, 10.0), away_m * np.cos(turn), away_m * np.sin(turn)])
    range_m = np.linalg.norm(target, axis=1)
    scene = open_scene([Mesh(vertices, triangles)])
    hits = cast(scene, pulses(np.zeros((shots, 3)), target / range_m[:, None]))
    met = np.isfinite(hits.range_m)
    yield Row(f"pulses through, of {shots}", int((~met).sum()), 0)
    yield Row("range, m", float(np.abs(hits.range_m - range_m)[met].max()), 1e-5)


@case(_CLOSED)
def degenerate_faces() -> Iterator[Row]:
    """A wall among 4000 triangles without area: points, needles, and slivers of the last bit of float32."""
    rng = np.random.default_rng(9)
    corner = rng.uniform([4.0, -3.0, -3.0], [9.0, 3.0, 3.0], (4000, 3))[:, None]
    along = 0.3 * rng.normal(size=(4000, 1, 3))
    step = np.array([0.0, 1.0, 2.0])[None, :, None] * (np.arange(4000) % 3 > 0)[:, None, None]
    none = corner + step * along
    none[::3, 2] = np.nextafter(none[::3, 0].astype(np.float32), np.float32(np.inf))
    firings = _cone(8 * PULSES, 20.0)
    hits = cast(open_scene([faces(none), wall(25.0)]), firings)
    met = hits.surface == 1
    yield Row(f"pulses that a face without area stops, of {len(met)}", int((~met).sum()), 0)
    true_m = 25.0 / firings.direction[..., 0].ravel()
    yield Row("range, m", float(np.abs(hits.range_m - true_m)[met].max()), 1e-5)


def _plane_range_m(corners: F8, direction: F8) -> float:
    """Range along a direction (3,) from the origin to the plane through three corners, with 40 digits."""
    with mp.workdps(40):
        a, b, c = (mp.matrix([mpf(float(x)) for x in corner]) for corner in corners)
        u = b - a
        v = c - a
        normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
        along = sum(n * mpf(float(d)) for n, d in zip(normal, direction, strict=True))
        return float(sum(n * x for n, x in zip(normal, a, strict=True)) / along)


def _triangle_error_m(size_m: float, plane_m: float) -> tuple[F8, F8]:
    """Cast at a tilted triangle; return errors (n,) in metres, and over those of a direction in float32."""
    rng = np.random.default_rng(4)
    ahead = np.ones(3) / np.sqrt(3)
    corners = size_m / np.sqrt(2) * (np.eye(3) - 1 / 3) + plane_m * ahead
    corners = corners.astype(np.float32).astype(np.float64)
    # Targets fill the circle inside the triangle, as far as it is in reach.
    away_m = min(0.28 * size_m, 100.0) * np.sqrt(rng.uniform(size=PULSES))
    turn = rng.uniform(0, 2 * np.pi, PULSES)
    across = np.array([1.0, -1.0, 0.0]) / np.sqrt(2)
    target_m = plane_m * ahead + np.outer(away_m * np.cos(turn), across)
    target_m += np.outer(away_m * np.sin(turn), np.cross(ahead, across))
    origin_m = rng.uniform(-0.5, 0.5, (PULSES, 3))
    direction = target_m - origin_m
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    hits = cast(open_scene([faces(corners[None])]), pulses(origin_m, direction))
    true_m = [_plane_range_m(corners - o, d) for o, d in zip(origin_m, direction, strict=True)]
    error_m = np.abs(hits.range_m - np.array(true_m))
    # A direction in float32 moves the spot aside, on a grazed face by that over the cosine.
    share = error_m / (1e-6 + _FLOAT32 * np.array(true_m) / (direction @ ahead))
    return error_m, share


@case("mpmath, 40 digits")
def tilted_triangle() -> Iterator[Row]:
    """A tilted triangle with edges of 173 m, 10 km and 1 mm, hit at up to 84 degrees from its normal."""
    for name, size_m, plane_m in (("173 m", 173.0, 57.7), ("10 km", 10_000.0, 10.0), ("1 mm", 1e-3, 10.0)):
        error_m, share = _triangle_error_m(size_m, plane_m)
        yield Row(f"{name}: pulses through, of {len(error_m)}", int((~np.isfinite(error_m)).sum()), 0)
        yield Row(f"{name}: range, m", float(error_m.max()), 1e-4)
        yield Row(f"{name}: error over that of a direction in float32", float(share.max()), 1)


@case("a second run of the same cast; closed form in float64")
def coincident_faces() -> Iterator[Row]:
    """The same face twice in one place, as two surfaces, as two instances, and as two crates."""
    firings = _cone(8 * PULSES, 20.0)
    cosine = firings.direction[..., 0].ravel()
    for name, meshes, times in (("two faces", [wall(10.0)] * 2, 1), ("two instances", [wall(10.0)], 2)):
        first, again = (cast(open_scene(meshes, times=times), firings) for _ in range(2))
        yield Row(f"{name}: pulses that change", int((first.surface != again.surface).sum()), 0)
        yield Row(f"{name}: range, m", float(np.abs(first.range_m - 10.0 / cosine).max()), 1e-5)
    crate = "centre_m=[-6.0,-5.0,0.5],size_m=[2.0,1.0,1.0]"
    scene = load("static_bench", [f'world.boxes=[{{name="one",{crate}}},{{name="other",{crate}}}]'])
    labels = [
        np.concatenate([r.surface for r in Emulator(scene, threads=threads).returns(0.0, 0.1, truth=True)])
        for threads in (1, 3)
    ]
    yield Row("two crates: labels that differ by threads", int((labels[0] != labels[1]).sum()), 0)


def _box(low_m: tuple[float, ...], high_m: tuple[float, ...]) -> Mesh:
    spans = np.stack([low_m, high_m])
    ends = [(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    corners = np.array([[spans[i, 0], spans[j, 1], spans[k, 2]] for i, j, k in ends])
    sides = [(0, 2, 6, 4), (1, 5, 7, 3), (0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6)]
    return Mesh(corners.astype(np.float32), np.array(sides, np.uint32))


@case(_CLOSED)
def crossed_boxes() -> Iterator[Row]:
    """Boxes that reach into each other, some of their faces flush."""
    spans = [((8, -2, -2), (12, 2, 2)), ((7, -1, -1), (13, 1, 1))]
    spans += [((8, 0, -3), (10, 3, 0)), ((9, -3, -3), (11, 3, 3))]
    firings = _cone(4 * PULSES, 16.0)
    got_m = cast(open_scene([_box(*span) for span in spans]), firings).range_m
    to_m = []
    with np.errstate(divide="ignore"):
        for span in spans:
            sides_m = [(side_m - firings.origin_m) / firings.direction for side_m in np.array(span)]
            enter_m = np.minimum(*sides_m).max(axis=-1)
            leave_m = np.maximum(*sides_m).min(axis=-1)
            to_m.append(np.where(enter_m <= leave_m, enter_m, np.inf))
    true_m = np.min(to_m, axis=0).reshape(-1)
    error_m = np.abs(np.nan_to_num(got_m, posinf=0.0) - np.nan_to_num(true_m, posinf=0.0))
    yield Row("range, m", float(error_m.max()), 1e-5)


@case(_CLOSED)
def sensor_inside() -> Iterator[Row]:
    """A sensor in a closed box of 2 m, and one whose spin axis lies in a surface, through which it sees."""
    box_m = 'world.boxes=[{name="cage",centre_m=[0,0,1.5],size_m=[2,2,2]}]'
    returns = list(Emulator(load("static_bench", [box_m])).returns(0.0, 0.1))
    origin = np.concatenate([r.firings.origin_m for r in returns]) - [0, 0, 1.5]
    direction = np.concatenate([r.firings.direction for r in returns])
    with np.errstate(divide="ignore"):
        true_m = ((1.0 - np.sign(direction) * origin) / np.abs(direction)).min(axis=-1)
    got_m = np.concatenate([r.distance_m[..., 0] for r in returns])
    yield Row("closed box: range, m", float(np.abs(got_m - true_m).max()), 1e-5)

    plate = faces(np.array([[(0, -9, -9), (0, 9, -9), (0, 9, 9), (0, -9, 9)]]))
    head = unit_of("static_bench").head
    aimed = head.aim(0, 1920, unit_of("static_bench", "motion.height_m=1.5").motion.poses_at)
    direction = aimed.direction.reshape(-1, 3)
    hits = cast(open_scene([plate, wall(5.0, 500.0)]), pulses(np.zeros_like(direction), direction))
    ahead = direction[:, 0] > 0.1
    yield Row("on a surface: pulses stopped by it", int((hits.surface[ahead] != 1).sum()), 0)
    error_m = np.abs(hits.range_m - 5.0 / np.where(ahead, direction[:, 0], np.inf))[ahead]
    yield Row("on a surface: range of the wall behind, m", float(error_m.max()), 1e-4)


@case(_CLOSED)
def edge_on() -> Iterator[Row]:
    """Leaves in the plane of the pulse, exactly and within a billionth of a degree, before a wall."""
    count = 8 * PULSES
    tilt_rad = np.concatenate([np.zeros(PULSES), np.geomspace(1e-11, 1e-4, count - PULSES)])
    y_m = 0.5 * np.arange(count)
    corners = np.array([(9.97, 0, -0.02), (10.03, 0, -0.02), (10.03, 0, 0.02), (9.97, 0, 0.02)])
    leaves = np.tile(corners, (count, 1, 1))
    leaves[:, :, 1] = y_m[:, None] + (leaves[:, :, 0] - 10.0) * tilt_rad[:, None]
    scene = open_scene([faces(leaves), wall(15.0, 2 * y_m[-1])])
    firings = pulses(np.column_stack([0 * y_m, y_m, 0 * y_m]), np.tile([1.0, 0.0, 0.0], (count, 1)))
    for name, light in (("one ray", None), ("64 rays", beam("fixed"))):
        hits = cast(scene, firings) if light is None else cast(scene, firings, light)
        sound = np.isfinite(hits.range_m) & (hits.cos_incidence >= 0) & (hits.cos_incidence <= 1)
        yield Row(f"{name}: rays lost or without a cosine", int((~sound).sum()), 0)
    error_m = np.abs(detect_pulses(scene, firings, beam("fixed")).distance_m[..., 0] - 15.0)
    yield Row("64 rays: range of the wall behind, m", float(error_m.max()), 1e-4)


def grazing_error_m(incidence_deg: float, light: str = "none") -> F8:
    """Return the errors (n,), in metres, of ranges of 10 to 100 m to a floor; NaN for a pulse that is lost.

    With `light` "adaptive" the beam has its width, and the errors are 0 for ranges that a code can hold.
    """
    signs = np.array([[(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]])
    scene = open_scene([faces(_FLOOR_M * signs)])
    cosine = np.cos(np.radians(incidence_deg))
    level = np.sqrt(1 - cosine**2)
    range_m = np.linspace(10.0, 100.0, PULSES)
    turned = np.linspace(0.0, 2 * np.pi, PULSES)
    origin_m = np.column_stack([0 * turned, 0 * turned, range_m * cosine])
    direction = np.column_stack([level * np.cos(turned), level * np.sin(turned), np.full(PULSES, -cosine)])
    firings = pulses(origin_m, direction)
    if light == "none":
        found_m = cast(scene, firings).range_m.astype(np.float64)
        return np.where(np.isfinite(found_m), np.abs(found_m - range_m), np.nan)
    found_m = detect_pulses(scene, firings, beam(light)).distance_m.astype(np.float64)
    return np.where((found_m >= 0) & (found_m <= 131.07), 0.0, np.nan)


@case(_CLOSED)
def grazing() -> Iterator[Row]:
    """A floor at up to 89.9999 degrees from its normal, 10 to 100 m away: 0.2 mm below the sensor."""
    for incidence_deg in (80.0, 89.0, 89.9, 89.99, 89.9999):
        error_m = float(grazing_error_m(incidence_deg).max())
        yield Row(f"{incidence_deg:g} deg: range, m", error_m, 4 * 100 * _FLOAT32)
        lost = np.isnan(grazing_error_m(incidence_deg, "adaptive"))
        yield Row(f"{incidence_deg:g} deg, wide beam: returns out of limits", int(lost.sum()), 0)


@case(_CLOSED)
def vast_hall() -> Iterator[Row]:
    """A hall of 10 km, whose floor and walls are two triangles each, from 1.5 m above the floor."""
    none = ["world.boxes=[]", "world.poles=[]", "world.spheres=[]", "sensor.max_range_m=131.07"]
    scenario = load("static_bench", ["world.length_m=10000.0", "world.width_m=10000.0", *none])
    returns = list(Engine.of(scenario).returns(0, 0.1))
    origin = np.concatenate([r.firings.origin_m for r in returns])
    direction = np.concatenate([r.firings.direction for r in returns])
    cast_m = np.concatenate([r.distance_m[..., 0] for r in returns])
    with np.errstate(divide="ignore"):
        level_m = np.where(direction[..., 2] < 0, 0.0, scenario.world.height_m)
        true_m = (level_m - origin[..., 2]) / direction[..., 2]
    seen = true_m <= 131.07
    error_m = float(np.abs(cast_m - true_m)[seen].max())
    yield Row(f"ranges of up to {true_m[seen].max():.0f} m, m", error_m, 1e-5)
    yield Row("returns from nothing within reach", int((cast_m[~seen] > 0).sum()), 0)
