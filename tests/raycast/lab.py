"""What tests of casters share: a small window with every difficulty, and a wood that is seen from afar."""

import math
from dataclasses import replace
from types import MappingProxyType, SimpleNamespace

import numpy as np
import trimesh

from vlp16emu.foliage.lanes import Ground, Medium, Pulse
from vlp16emu.foliage.leaves import draw_owners, room_for_leaves, take_leaves
from vlp16emu.foliage.march import march
from vlp16emu.foliage.stems import find_stems_ahead, room_for_stems, stems_of
from vlp16emu.foliage.tiles import STEM, FarTile, TiledWindow
from vlp16emu.foliage.voxel import KNOTS, QUANTILES
from vlp16emu.forest.tiles import TileKey, ground_mesh
from vlp16emu.motion.pose import StaticMotion
from vlp16emu.raycast.beam import Footprint
from vlp16emu.raycast.near import EmbreeCaster
from vlp16emu.raycast.settings import Beam
from vlp16emu.sensor.beams import BEAM_TABLES
from vlp16emu.sensor.clock import Clock, ClockSpan
from vlp16emu.sensor.head import Head
from vlp16emu.sensor.rotor import Encoder, Rotor, Spin
from vlp16emu.types import SURFACE, Firings, Hits, Mesh, PlantPart, Semantic, SensorModel, Sway, Window

UTM_M = np.array([432_100.0, 6_901_234.0, 87.0])
NEAR_M = BEAM_TABLES[SensorModel.VLP_16].near_m
FAR_M = 100.0


def soup(key):
    """Two meshes of random small faces: triangles, and planar quads above them."""
    rng = np.random.default_rng(key)
    corners_m = rng.uniform(-1, 1, (200, 1, 3)) + rng.normal(0, 0.2, (200, 4, 3))
    corners_m[:, 3] = corners_m[:, 0] + corners_m[:, 2] - corners_m[:, 1]
    triangles = Mesh(corners_m[:, :3].reshape(-1, 3).astype("f4"), np.arange(600, dtype="u4").reshape(-1, 3))
    quads = Mesh(
        (corners_m + [0, 0, 1]).reshape(-1, 3).astype("f4"), np.arange(800, dtype="u4").reshape(-1, 4)
    )
    return triangles, quads


def placed(count, *, at=UTM_M, scaled=True, seed=1):
    """Window of `count` turned, mirrored and scaled soups about a point."""
    rng = np.random.default_rng(seed)
    transforms = np.zeros((count, 3, 4))
    for transform in transforms:
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        transform[:, :3] = turn @ np.diag(rng.uniform(0.5, 2.0, 3)) if scaled else turn
        transform[:, 3] = at + rng.uniform(-8, 8, 3)
    surfaces = np.zeros(2 * count, SURFACE)
    surfaces["reflectance"] = rng.uniform(0.1, 0.9, 2 * count)
    return Window(
        origin_m=np.asarray(at, float),
        shapes=(1, 2, 3),
        shape=(np.arange(count) % 3).astype("i4"),
        world_T_shape=transforms,
        first_surface=(np.arange(count) * 2).astype("u4"),
        surfaces=surfaces,
    )


def pulses(count, *, first=0, at=UTM_M, tilt_deg=2.0, every=1):
    """Firings of a static sensor in the middle of it, by every n-th of its lasers."""
    rotor = Rotor((Spin(0, 0.0, 600),), Encoder(1))
    head = Head(BEAM_TABLES[SensorModel.VLP_16], rotor, Clock((ClockSpan(0),)), 10**18)
    standing = StaticMotion(np.asarray(at, float) + [0, 0, 0.1], 30.0, tilt_deg, 1.0)
    firings = head.aim(first, count, standing.poses_at, beam_axis=True)
    names = ("t_ns", "azimuth_deg", "origin_m", "direction", "beam_axis")
    return replace(firings, **{name: getattr(firings, name)[:, ::every].copy() for name in names})


def straight(start_ns, step_ns, placement, foot_z_m, lean):
    """Sway of placements (m,) along straight lines, by `lean` (k, m, 2) per metre over the foot."""
    m = len(placement)
    return Sway(start_ns, step_ns, placement, foot_z_m, np.ones(m), np.tile([0.0, 1.0], (m, 1)), lean)


def assert_same_bits(ours, other):
    """Both casts have the same sub-rays, which met the same, bit by bit."""
    for name in Hits.__slots__:
        assert getattr(ours, name).tobytes() == getattr(other, name).tobytes(), name


def joined(pieces):
    return Hits(*(np.concatenate([getattr(piece, name) for piece in pieces]) for name in Hits.__slots__))


def beam(model, **changed):
    """The footprint of a VLP-16, with other settings."""
    seed = changed.pop("seed", 7)
    return Footprint(Beam(model=model, rays=32), seed, resolution_m=1.0).with_settings(**changed)


def level_pulses(y_m):
    """Firings (k, 1) along x from points beside each other, k positions y."""
    origin_m = np.column_stack([0.0 * np.asarray(y_m), y_m, 0.0 * np.asarray(y_m)])
    return rays(origin_m, np.tile([1.0, 0.0, 0.0], (len(origin_m), 1)))


def upright(*rectangles, reflectance=0.5):
    """Window of upright rectangles (x, y from, y to, z from, z to), each a surface, and its shapes."""
    meshes = tuple(
        Mesh(
            np.array([[x, y0, z0], [x, y1, z0], [x, y1, z1], [x, y0, z1]], "f4"),
            np.array([[0, 1, 2, 3]], "u4"),
        )
        for x, y0, y1, z0, z1 in rectangles
    )
    surfaces = np.zeros(len(meshes), SURFACE)
    surfaces["reflectance"] = reflectance
    place = np.eye(3, 4)[None].copy()
    window = Window(np.zeros(3), ("all",), np.zeros(1, "i4"), place, np.zeros(1, "u4"), surfaces)
    return window, lambda _key: meshes


def world(shape):
    """What a caster needs of a world of faces alone."""
    return SimpleNamespace(
        shape=shape, near_m=math.inf, far_tile=None, seed=0, name="", shape_name=lambda _: ""
    )


def opened(workers, window=None, shape=soup):
    """Scene of a window, that of thirty soups if none is given."""
    return EmbreeCaster(world(shape), workers).open(placed(30) if window is None else window)


def square_leaves(rng, middle_m, half_m):
    """Square leaves of all directions about places (n, 3)."""
    u, v = (rng.normal(size=middle_m.shape) for _ in range(2))
    v -= (u * v).sum(1)[:, None] / (u * u).sum(1)[:, None] * u
    u, v = (half_m * w / np.linalg.norm(w, axis=1)[:, None] for w in (u, v))
    corners_m = np.stack([middle_m - u - v, middle_m + u - v, middle_m + u + v, middle_m - u + v], axis=1)
    return Mesh(
        corners_m.reshape(-1, 3).astype("f4"), np.arange(4 * len(middle_m), dtype="u4").reshape(-1, 4)
    )


SIDES = 96  # of the polygons that stand for circles
ANGLES = 2 * np.pi / SIDES * np.arange(SIDES)


def fan(rings):
    """Walls of a pipe, triangles, between rings of `SIDES` vertices."""
    here = np.arange(SIDES)
    after, low = np.roll(here, -1), (np.arange(rings - 1) * SIDES)[:, None]
    one = np.stack([low + here, low + after, low + SIDES + after], axis=-1).reshape(-1, 3)
    other = np.stack([low + here, low + SIDES + after, low + SIDES + here], axis=-1).reshape(-1, 3)
    return np.concatenate([one, other]).astype("u4")


def stem_mesh(stem, corner_m):
    """Flare and stem of a `STEM`, polygons of the circles' area."""
    axis = stem["axis"]
    one = np.cross(axis, [0.0, 1.0, 0.0])
    one /= np.linalg.norm(one)
    circle = np.cos(ANGLES)[:, None] * one + np.sin(ANGLES)[:, None] * np.cross(axis, one)
    circle *= np.sqrt(2 * np.pi / SIDES / np.sin(2 * np.pi / SIDES))
    at_m = stem["foot_m"] - corner_m + stem["along_m"][:, None] * axis
    at_m[:, :2] += stem["aside_m"].T
    rings_m = (at_m[:, None] + stem["radius_m"][:, None, None] * circle).astype("f4")
    top = int(np.flatnonzero(stem["along_m"] == stem["flare_m"])[0])
    parts = rings_m[: top + 1], rings_m[top:]
    return [Mesh(part.reshape(-1, 3), fan(len(part))) for part in parts]


CROWN_PARTS = PlantPart.BRANCH_FIRST_ORDER, PlantPart.LEAF


def crown():
    """Branches and leaves in a ball of 2 m about 3 m over the origin, more faces than are taken one by
    one."""
    rng, twigs = np.random.default_rng(5), 40

    def ball(count):
        at_m = rng.normal(size=(count, 3))
        return 2 * at_m / np.linalg.norm(at_m, axis=1)[:, None] * rng.random((count, 1)) ** (1 / 3) + [
            0,
            0,
            3,
        ]

    leaf = square_leaves(rng, ball(1500), 0.06)
    rings_m = ball(twigs)[:, None] + [[0.0, 0.0, 0.0], [0.5, 0.1, 0.2]]
    rings_m = rings_m[:, :, None] + 0.02 * np.column_stack([0 * ANGLES, np.cos(ANGLES), np.sin(ANGLES)])
    faces = np.concatenate([2 * SIDES * n + fan(2) for n in range(twigs)]).astype("u4")
    return Mesh(rings_m.reshape(-1, 3).astype("f4"), faces), leaf


def stone():
    block = trimesh.creation.box(bounds=[[-0.4, -0.3, 0.0], [0.4, 0.3, 0.5]])
    return (Mesh(block.vertices.astype("f4"), block.faces.astype("u4")),)


def bumpy(x, y):
    """Ground that slopes and waves."""
    return 0.12 * x - 0.05 * y + 0.4 * np.sin(x / 3.1) * np.cos(y / 4.3) + 3.3


FACING = np.linspace(0.2, 0.9, QUANTILES, dtype="f4")
"""Quantiles of the cosine of incidence of low things."""


class Tiles:
    """Squares of ground with stems, crowns over some of them, and stones; a `World` that is a medium
    beyond `near_m`."""

    name = ""
    parts = MappingProxyType({"crown": CROWN_PARTS, "stone": (PlantPart.NONE,)})

    def __init__(
        self,
        near_m=2.0,
        across=1,
        *,
        per_tile=4,
        things=True,
        crowns_far=True,
        height_m=bumpy,
        seed=99,
        bow_m=0.0,
        low=False,
    ):
        self.near_m, self.seed, self.height_m, self.across, self._bow_m = (
            near_m,
            seed,
            height_m,
            across,
            bow_m,
        )
        self._low = low
        self._kept, self._per_tile, self._things, self._crowns_far = {}, per_tile, things, crowns_far
        self._shapes = {"crown": crown(), "stone": stone()}

    def tile(self, ix, iy):
        """Stems, placements of crowns and stones as (key, 3 x 4), and surfaces of a tile."""
        if (ix, iy) in self._kept:
            return self._kept[ix, iy]
        rng = np.random.default_rng([ix + 1000, iy + 1000])
        stems, placed = np.zeros(self._per_tile, STEM), []
        for n, stem in enumerate(stems):
            x, y = 20 * ix + rng.uniform(0, 20), 20 * iy + rng.uniform(0, 20)
            axis = np.array([*rng.normal(0, 0.06, 2), 1.0])
            stem["foot_m"], stem["axis"] = [x, y, self.height_m(x, y)], axis / np.linalg.norm(axis)
            high_m, dbh_m = rng.uniform(8, 14), rng.uniform(0.15, 0.5)
            stem["along_m"] = np.concatenate([[-0.6, 0.0, 0.4], np.linspace(1.0, high_m, 13)])
            stem["radius_m"] = dbh_m / 2 * np.clip((high_m - stem["along_m"]) / (high_m - 1.3), 0.0, 1.2)
            stem["radius_m"][:2] *= [1.7, 1.3]
            bent = self._bow_m * np.sin(np.pi * np.clip(stem["along_m"] / high_m, 0.0, 1.0))
            stem["aside_m"] = bent * np.array([[np.cos(n)], [np.sin(n)]])
            stem["flare_m"], stem["row"] = stem["along_m"][2], [1 + 2 * n, 2 + 2 * n]
            if n % 2 == 0 and self._things:
                turn, size = rng.uniform(0, 2 * np.pi), rng.uniform(0.8, 1.3)
                c, s = size * np.cos(turn), size * np.sin(turn)
                top_m = stem["foot_m"] + (high_m - 5.0) * stem["axis"]
                placed.append(("crown", np.column_stack([[[c, -s, 0], [s, c, 0], [0, 0, size]], top_m])))
        for _ in range(6 if self._things else 0):
            x, y = 20 * ix + rng.uniform(0, 20), 20 * iy + rng.uniform(0, 20)
            own = np.diag(rng.uniform(0.5, 2.0, 3))
            placed.append(("stone", np.column_stack([own, [x, y, self.height_m(x, y) - 0.1]])))
        rows = [(Semantic.GROUND, PlantPart.NONE)]
        rows += [(Semantic.TREE, part) for _ in stems for part in (PlantPart.ROOT_FLARE, PlantPart.STEM)]
        first = []
        for key, _ in placed:
            first.append(len(rows))
            tree = [(Semantic.TREE, part) for part in CROWN_PARTS]
            rows += tree if key == "crown" else [(Semantic.STONE, PlantPart.NONE)]
        rows.append((Semantic.GROUND, PlantPart.NONE))  # that of low things
        surfaces = np.zeros(len(rows), SURFACE)
        surfaces["semantic"], surfaces["part"] = np.array(rows).T
        surfaces["reflectance"] = 0.4
        surfaces["instance"] = 1000 * (100 * (ix + 50) + iy + 50) + np.arange(len(rows))
        self._kept[ix, iy] = stems, placed, np.array(first, np.int64), surfaces
        return self._kept[ix, iy]

    def shape_name(self, _key):
        """Nothing of it is kept on disk."""
        return ""

    def corner_m(self, ix, iy):
        """South-west corner, at an even metre near the ground."""
        x, y = 20.0 * ix, 20.0 * iy
        return np.array([x, y, 2.0 * np.round(self.height_m(x + 10, y + 10) / 2)])

    def far_tile(self, ix, iy):
        """Describe a tile from afar."""
        stems, placed, first, surfaces = self.tile(ix, iy)
        own = [i for i, (key, _) in enumerate(placed) if self._crowns_far or key != "crown"]
        placed, first = [placed[i] for i in own], first[own]
        corner_m, keys = self.corner_m(ix, iy), [*self.parts] if placed else []
        edge_m = np.arange(-2, 83) * 0.25
        x, y = np.meshgrid(corner_m[0] + edge_m, corner_m[1] + edge_m, indexing="ij")
        return FarTile(
            corner_m,
            tuple(keys),
            np.array([keys.index(key) for key, _ in placed], np.int64),
            np.array([place for _, place in placed]).reshape(-1, 3, 4),
            first,
            np.cumsum([0, *(len(self.parts[key]) for key in keys)]),
            np.array([part for key in keys for part in self.parts[key]], "u1"),
            stems,
            self.height_m(x, y),
            self.sides(ix, iy, len(surfaces) - 1),
            FACING,
        )

    def sides(self, ix, iy, row):
        """Low things, on a third of the squares of a tile, if there are any."""
        rng = np.random.default_rng([ix + 1000, iy + 1000, 1])
        code = rng.integers(1, 256, (80, 80)) * (rng.random((80, 80)) < self._low / 3)
        return np.where(code, row << 8 | code, 0).astype("u4")

    def core(self, _key):
        """Branches do not begin inside a stem."""

    def shape(self, key):
        """Meshes of a tile, ground first, of a crown or of a stone."""
        if key in self._shapes:
            return self._shapes[key]
        _, ix, iy = key
        corner_m = np.array([20.0 * ix, 20.0 * iy, np.round(self.height_m(20.0 * ix + 10, 20.0 * iy + 10))])
        ground = ground_mesh(TileKey(ix, iy), self.height_m)
        return (ground, *(mesh for stem in self.tile(ix, iy)[0] for mesh in stem_mesh(stem, corner_m)))

    def window(self, track_m, tiles=None):
        """Some tiles, those about the middle if none are said."""
        about = range(-self.across, self.across + 1)
        tiles = [(ix, iy) for ix in about for iy in about] if tiles is None else tiles
        shapes, shape, places, first, begins, rows, tables = {}, [], [], [], [], 0, []
        for ix, iy in tiles:
            _, placed, own, surfaces = self.tile(ix, iy)
            low_m = np.round(self.height_m(20.0 * ix + 10, 20.0 * iy + 10))
            here = np.column_stack([np.eye(3), [20.0 * ix, 20.0 * iy, low_m]])
            for key, place in ((("tile", ix, iy), here), *placed):
                shape.append(shapes.setdefault(key, len(shapes)))
                places.append(place)
            first += [rows, *(rows + own).tolist()]
            begins.append((ix, iy, rows))
            rows += len(surfaces)
            tables.append(surfaces)
        return TiledWindow(
            origin_m=np.round(np.mean(track_m, axis=0)),
            shapes=tuple(shapes),
            shape=np.array(shape, "i4"),
            world_T_shape=np.array(places),
            first_surface=np.array(first, "u4"),
            surfaces=np.concatenate(tables),
            track_m=np.asarray(track_m),
            tiles=tuple(begins),
            far=np.ones(len(shape), np.bool_),
            low=np.zeros(len(shape), np.bool_),
        )


def no_medium():
    """A medium that holds nothing, to put something into."""
    none = np.zeros(0, np.uint32)
    return Medium(
        near_m=0.0,
        corner_m=(0.0, 0.0, 0.0),
        corner=(0, 0, 0),
        brick=np.zeros((1, 1, 1, 2), np.uint64),
        record=none,
        first_owner=none,
        owner=np.zeros(0, np.uint64),
        surface=np.zeros((1, 1, 9), np.uint32),
        cosine=np.zeros((0, len(KNOTS), QUANTILES), np.float32),
        ground=Ground(
            np.zeros((2, 2), np.float32),
            np.zeros((1, 1), np.uint32),
            0.0,
            0.0,
            0.0,
            np.zeros((1, 1), "u4"),
            FACING,
        ),
        stems=stems_of(
            np.zeros((0, 8)),
            np.zeros((0, 5, 16), np.float32),
            np.zeros((0, 2), np.uint32),
            np.zeros(0, np.float32),
        ),
        seed=0,
    )


def sight_of(medium, axes, far_m, aside_m=0.0, spread=0.0):
    """List the stems of a medium that pulses, origins and directions (n, 6), may meet."""
    ahead = room_for_stems(medium.stems)
    find_stems_ahead(medium.stems, ahead, axes, medium.near_m, far_m, aside_m, spread)
    return ahead


def march_through(medium, lanes, count, line, far_m, aside_m=0.0, spread=0.0, ahead=None):
    """Follow a pulse's lanes, `count` of them, through a medium; its middle is `line` (6,), what is
    `ahead` by `sight_of`."""
    line = np.array(line, "f4")
    ahead = ahead or sight_of(medium, line[None], far_m, aside_m, spread)
    pulse = Pulse(lanes, count, np.float32(medium.near_m), line, np.float32(aside_m), np.float32(spread))
    march(medium, medium.brick.reshape(-1), ahead, pulse)
    leaves = room_for_leaves(1)
    found = take_leaves(lanes, 0, count, leaves, 0)
    draw_owners(medium, leaves, found, lanes.row[None], lanes.surface[None])


def rays(origin_m, direction, first=0):
    """Firings (k, 1) of rays (k, 3), k a multiple of 8; their horizontal axis is across z."""
    across = np.cross(direction, [0.0, 0.0, 1.0]) + 1e-9
    across /= np.linalg.norm(across, axis=1)[:, None]
    lines = Firings.rays(0, np.array(origin_m)[:, None], np.array(direction, float)[:, None])
    return replace(lines, index=first, beam_axis=across[:, None])
