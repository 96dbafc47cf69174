"""What shapes become in voxels: area, owners, and blocks that windows share."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from raycast import lab

from vlp16emu.foliage import cloud as clouds_room
from vlp16emu.foliage.cloud import TILTS, Library, cloud_of, look_through
from vlp16emu.foliage.medium import Block, Shelf, block_of
from vlp16emu.foliage.voxel import (
    COLUMNS,
    CROWN,
    GROUND,
    KIND_BIT,
    KNOTS,
    LEVEL,
    LOW,
    QUANTILES,
    SHARE_BIT,
    TAU_PER_M,
    TILE_BIT,
    TUFTS,
    VOXEL_M,
)
from vlp16emu.types import Mesh, PlantPart

PARTS = np.array([PlantPart.BRANCH_FIRST_ORDER, PlantPart.LEAF], "u1")
AZIMUTHS = 2 * np.pi * (np.arange(720) + 0.5) / 720


def towards(sine):
    """Directions (720, 3) of one elevation, all around."""
    level = math.sqrt(1 - sine * sine)
    return np.column_stack([level * np.cos(AZIMUTHS), level * np.sin(AZIMUTHS), np.full(720, sine)])


def normals(mesh):
    """Area normals (n, 3) of the triangles of a mesh."""
    corners = mesh.vertices_m[mesh.faces].astype(float)
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    first = np.cross(b - a, c - a) / 2
    return first if corners.shape[1] == 3 else np.concatenate([first, np.cross(c - a, corners[:, 3] - a) / 2])


@pytest.fixture(scope="module")
def crown():
    """Meshes of branches and leaves, and their cloud."""
    meshes = lab.Tiles().shape("crown")
    return meshes, cloud_of(meshes, PARTS)


@pytest.mark.parametrize("knot", range(3))
def test_the_projected_area_of_a_cloud_is_that_of_its_faces(crown, knot):
    """Over all azimuths the mean projected area equals brute force over all faces to 1 %, for wood and
    leaves each."""
    meshes, cloud = crown
    for number, (mesh, share) in enumerate(zip(meshes, (0.5, 1.0), strict=True)):
        true_m2 = share * np.abs(normals(mesh) @ towards(KNOTS[knot]).T).sum(axis=0).mean()
        # The area itself is more or less where faces hide each other otherwise than at random.
        ours_m2 = share * np.linalg.norm(normals(mesh), axis=1).sum() * cloud.projection[number, knot]
        assert ours_m2 == pytest.approx(true_m2, rel=0.01)


@pytest.mark.parametrize("tilt_deg", [3.0, 8.0, 20.0, 60.0])
def test_level_light_meets_a_leaf_in_proportion_to_the_sine_of_its_tilt(tilt_deg):
    """Over all azimuths, level light meets 2 / pi sin(tilt) of a leaf's area (Ross 1981), to 7 %, also where
    it lies nearly level."""
    tilt = math.radians(tilt_deg)
    along, across = np.array([math.cos(tilt), 0, math.sin(tilt)]) * 0.05, np.array([0, 0.05, 0])
    leaf = Mesh(np.stack([along, across, -along, -across]).astype("f4"), np.arange(4, dtype="u4")[None])
    cloud = cloud_of([leaf], PARTS[1:])
    assert cloud.projection[0, 0] == pytest.approx(2 / np.pi * math.sin(tilt), rel=0.07)


@pytest.mark.parametrize("knot", range(3))
def test_cosines_of_a_cloud_are_those_with_which_light_meets_its_faces(crown, knot):
    """Quantiles of the cosine of incidence equal those of all faces, weighted by projected area, to 0.02."""
    meshes, cloud = crown
    for number, mesh in enumerate(meshes):
        own = normals(mesh)
        area_m2 = np.linalg.norm(own, axis=1)
        met = np.abs(own @ towards(KNOTS[knot])[::8].T).ravel()
        cosine = (met.reshape(len(own), -1) / area_m2[:, None]).ravel()
        order = np.argsort(cosine)
        so_far = np.cumsum(met[order]) / met.sum()
        true = cosine[order][np.searchsorted(so_far, (np.arange(QUANTILES) + 0.5) / QUANTILES)]
        assert np.abs(cloud.cosine[number, knot] - true).max() < 0.02


def test_leaves_that_hide_each_other_count_once():
    """Of four leaves behind one another an area like that of one is left; of leaves apart, all but a
    little."""
    leaf_m = np.array([[0.0, 0.1, 0.1], [0.0, 0.16, 0.1], [0.0, 0.16, 0.16], [0.0, 0.1, 0.16]])
    behind = np.array([leaf_m + [x, 0, 0] for x in (0.1, 0.15, 0.2, 0.25)])
    apart = np.array([leaf_m + [0.1, y, 0] for y in (0.0, 0.1, 0.2, 0.3)])
    for leaves_m, left in ((behind, 0.25), (apart, 1.0)):
        corners = np.concatenate([leaves_m, leaves_m[:, :, [1, 0, 2]]])  # as many seen along y
        kept = look_through(corners, np.array([0, 8]), np.ones(1, np.float32))[0]
        assert kept == pytest.approx(left, rel=0.06)


@pytest.mark.parametrize(("parts", "left"), [(PARTS, 0.25), (PARTS[1:], 1.0)])
def test_leaves_of_a_sapling_hide_each_other_as_those_of_a_crown(parts, left):
    """Four leaves behind one another count like one in a shape of wood and leaves with few faces; ferns,
    which have leaves alone, keep all."""
    leaf_m = np.array([[0.0, 0.1, 0.1], [0.0, 0.16, 0.1], [0.0, 0.16, 0.16], [0.0, 0.1, 0.16]])
    behind = np.array([leaf_m + [x, 0, 0] for x in (0.1, 0.15, 0.2, 0.25)])
    corners_m = np.concatenate([behind, behind[:, :, [1, 0, 2]]])
    leaves = Mesh(corners_m.reshape(-1, 3).astype("f4"), np.arange(32, dtype="u4").reshape(8, 4))
    no_wood = Mesh(np.zeros((0, 3), "f4"), np.zeros((0, 4), "u4"))
    cloud = cloud_of([no_wood, leaves][-len(parts) :], parts)
    assert len(cloud.corners_m) == 8
    assert cloud.corner_share == pytest.approx(left, rel=0.06)


@pytest.mark.parametrize(("twigs_x_m", "left"), [(0.2, 0.0), (0.35, 0.5)])
def test_a_twig_behind_leaves_counts_as_it_is_seen(twigs_x_m, left):
    """Twigs between two sheets of leaves are hidden, and twigs behind both of them count half: from one side
    they are in front. What the sheets lose is what these twigs hide."""

    def sheet(x_m):
        return np.array([[x_m, y, z] for y, z in ((0.1, 0.1), (0.4, 0.1), (0.4, 0.4), (0.1, 0.4))])

    twigs = np.array([[twigs_x_m, y, z] for y, z in ((0.2, 0.1), (0.22, 0.1), (0.22, 0.4), (0.2, 0.4))])
    along_x = np.array([sheet(0.15), sheet(0.25), twigs])
    corners = np.concatenate([along_x, along_x[:, :, [1, 0, 2]]])[[0, 1, 3, 4, 2, 5]]
    kept = look_through(corners, np.array([0, 4, 6]), np.ones(2, np.float32))[0]
    hidden = 0.3 * 0.3 / VOXEL_M**2
    leaves, twig = kept[0] * 2 * 0.3 * 0.3, kept[4] * 0.02 * 0.3
    assert leaves + twig == pytest.approx(-np.log(1 - hidden) * VOXEL_M**2, rel=0.05)
    assert kept[4] * hidden / -np.log(1 - hidden) == pytest.approx(left, abs=0.03)


def test_a_cloud_is_where_its_faces_are(monkeypatch):
    """Where nothing is hidden, cells add up to the area of each mesh, and their middle is that of the
    faces, to a millimetre."""

    def all_in_view(corners, *_):
        return np.ones(len(corners)), np.zeros((2, 2, TILTS)), 0.0

    monkeypatch.setattr(clouds_room, "look_through", all_in_view)
    meshes = lab.Tiles().shape("crown")
    cloud = cloud_of(meshes, PARTS)
    assert len(cloud.corners_m) == 0
    for number, (mesh, share) in enumerate(zip(meshes, (0.5, 1.0), strict=True)):
        corners = mesh.vertices_m[mesh.faces].astype(float)
        if corners.shape[1] == 3:
            corners = corners[:, [0, 1, 2, 2]]
        area_m2 = (
            np.linalg.norm(np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]), axis=1) / 2
        )
        middle_m = np.average(corners.mean(axis=1), axis=0, weights=area_m2)
        own = cloud.mesh == number
        assert cloud.area_m2[own].sum() == pytest.approx(share * area_m2.sum(), rel=1e-5)
        assert (
            np.abs(np.average(cloud.place_m[own], axis=0, weights=cloud.area_m2[own]) - middle_m).max() < 1e-3
        )


def test_branches_begin_at_the_bark():
    """A rod of 1 m that begins on the axis of a stem 0.2 m wide counts by nine tenths, to 2 %; one inside the
    stem not at all, one above its top as a whole."""
    angle = np.arange(6) * np.pi / 3
    rim = 0.01 * np.column_stack([0 * angle, np.cos(angle), np.sin(angle)])
    vertices_m = np.concatenate([rim, rim + [1.0, 0.0, 0.0]])
    i, j = np.arange(6), np.roll(np.arange(6), -1)
    faces = np.concatenate([np.column_stack([i, j, j + 6]), np.column_stack([i, j + 6, i + 6])]).astype("u4")
    core = np.array([[-1.0, 2.0], [0.1, 0.1]])
    for scale, lift_m, left in ((1.0, 0.0, 0.9), (0.08, 0.0, 0.0), (1.0, 3.0, 1.0)):
        rod = Mesh((vertices_m * [scale, 1, 1] + [0, 0, lift_m]).astype("f4"), faces)
        whole, rest = (cloud_of([rod], PARTS[:1], own) for own in (None, core))
        area_m2 = [
            (np.linalg.norm(np.cross(c[:, 2] - c[:, 0], c[:, 3] - c[:, 1]), axis=1) * one.corner_share).sum()
            for one in (whole, rest)
            for c in [one.corners_m]
        ]
        assert area_m2[1] / area_m2[0] == pytest.approx(left, rel=0.02)


def hovering(world, place):
    """Tile of a world whose ground is 3 m lower, so that nothing stands in it."""
    tile = world.far_tile(*place)
    return replace(tile, ground_m=tile.ground_m - 3.0)


@pytest.fixture(scope="module")
def blocks():
    """World, library and blocks of nine tiles."""
    world = lab.Tiles()
    clouds = [cloud_of(world.shape("crown"), PARTS), cloud_of(world.shape("stone"), PARTS[:1])]
    library, shape_of = Library.of(clouds), {"crown": 0, "stone": 1}
    tiles = {place: hovering(world, place) for place in itertools.product(range(-2, 3), repeat=2)}
    made = {
        place: block_of(library, shape_of, tiles, *place) for place in itertools.product((-1, 0, 1), repeat=2)
    }
    return world, library, tiles, made


@pytest.mark.parametrize("knot", range(3))
def test_blocks_hold_all_the_area_of_what_stands_on_them(blocks, knot):
    """Over nine tiles, area in voxels is that of the faces whose middles lie over them, to 3 %, by each
    elevation."""
    world, _, tiles, made = blocks
    code = [block.record >> np.uint32(7 * knot) & 127 for block in made.values()]
    found_m2 = sum(TAU_PER_M[own].sum() * VOXEL_M**3 for own in code)
    true_m2, light = 0.0, towards(KNOTS[knot])[::8].T
    for tile in tiles.values():
        for which, place in zip(tile.shape, tile.world_T_shape, strict=True):
            for number, mesh in enumerate(world.shape(tile.keys[which])):
                vertices_m = mesh.vertices_m.astype(float) @ place[:, :3].T + place[:, 3]
                over = np.abs(vertices_m[mesh.faces].mean(axis=1)[:, :2] - 10.0).max(axis=1) < 30.0
                own = Mesh(vertices_m.astype("f4"), mesh.faces[over])
                share = 1.0 if number == 1 else 0.5
                true_m2 += share * np.abs(normals(own) @ light).sum(axis=0).mean()
    assert found_m2 == pytest.approx(true_m2, rel=0.03)


@pytest.mark.parametrize(("ground_m", "share", "left"), [(0.0, 1.0, 1.0), (0.1, 0.8, 1.0), (0.3, 0.4, 0.5)])
def test_low_plants_are_as_dense_as_the_voxel_over_the_ground_makes_them(ground_m, share, left):
    """Area of a voxel is that of faces over the ground, spread over the volume that is over the ground: of
    two leaves at 0.2 and 0.4 m, one is left over ground at 0.3 m, in 0.2 of 0.5 m."""
    leaf_m = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.1, 0.0, 0.05], [0.0, 0.0, 0.05]])
    corners_m = np.concatenate([leaf_m + [0, 0, z] for z in (0.2, 0.4)]).astype("f4")
    (code,) = codes_of_a_shape(Mesh(corners_m, np.arange(8, dtype="u4").reshape(2, 4)), ground_m)
    true_m2 = left * 2 * 0.1 * 0.05 * 2 / np.pi
    assert TAU_PER_M[code] * VOXEL_M**3 * share == pytest.approx(true_m2, rel=2.0 / code)


@pytest.mark.parametrize(("tilt_deg", "left"), [(0.0, 0.95), (20.0, 0.95), (60.0, 1.0)])
def test_leaves_that_lie_nearly_level_hide_each_other_beyond_a_voxel(tilt_deg, left):
    """Leaves tilted by at most 20 degrees keep 0.95 of their area, steeper ones all of it."""
    tilt = np.radians(tilt_deg)
    along, across = 0.1 * np.array([np.cos(tilt), 0, np.sin(tilt)]), np.array([0, 0.2, 0])
    corners_m = np.tile(np.stack([along, across, -along, -across]) + [0, 0, 3.2], (16, 1))
    faces = np.arange(64, dtype="u4").reshape(16, 4)
    (code,) = codes_of_a_shape(Mesh(corners_m.astype("f4"), faces), 0.0, knot=2)
    assert TAU_PER_M[code] * VOXEL_M**3 == pytest.approx(left * 16 * 0.04 * np.cos(tilt), rel=0.025)


def codes_of_a_shape(mesh, ground_m, knot=0):
    """Codes of the voxels of a tile on level ground with one shape of leaves at (5.1, 5.1, 0)."""
    record = records_of_a_shape(cloud_of([mesh], PARTS[1:]), ground_m)
    code = record >> np.uint32(7 * knot) & 127
    return code[code > 0].tolist()


def records_of_a_shape(cloud, ground_m):
    """Records of the voxels of a tile on level ground with one cloud at (5.1, 5.1, 0)."""
    world = lab.Tiles(per_tile=0, things=False, height_m=lambda x, y: 0.0 * x + 0.0 * y + ground_m)
    tiles = {place: world.far_tile(*place) for place in itertools.product((-1, 0, 1), repeat=2)}
    tiles[0, 0] = replace(
        tiles[0, 0],
        keys=("low",),
        shape=np.zeros(1, "i8"),
        world_T_shape=np.column_stack([np.eye(3), [5.1, 5.1, 0.0]])[None],
        first_surface=np.ones(1, "i8"),
    )
    return block_of(Library.of([cloud]), {"low": 0}, tiles, 0, 0).record


@pytest.mark.parametrize(("leaf_m", "tufts"), [(0.03, False), (0.2, True)])
def test_large_leaves_are_tufts(leaf_m, tufts):
    """Upright square leaves of 200 mm are tufts, and those of 30 mm are none; the share of the variance
    between squares of 62 mm is that of numpy, along x and y, to 0.02."""
    rng = np.random.default_rng(5)
    middle_m = rng.random((300 if tufts else 12000, 3)) * [3.0, 3.0, 3.0]
    across, up = np.array([1.0, 1.0, 0.0]) * leaf_m / 2, np.array([0.0, 0.0, leaf_m / 2])
    corners_m = np.stack([middle_m + a * across + b * up for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))], 1)
    share = np.ones(1, "f4")
    *_, coarse = clouds_room.look_through(corners_m, np.array([0, len(corners_m)]), share)
    between = every = 0.0
    for axis in (0, 1):
        side = np.floor(corners_m[..., 1 - axis] * 64).astype(int) + 64
        height = np.floor(corners_m[..., 2] * 64).astype(int) + 64
        slab = np.floor(middle_m[:, axis] / VOXEL_M).astype(int)
        for number in np.unique(slab):
            hidden = np.zeros((512, 512), bool)
            for a, b in zip(side[slab == number], height[slab == number], strict=True):
                hidden[a.min() : a.max(), b.min() : b.max()] = True
            voxels = hidden.reshape(16, 32, 16, 32).transpose(0, 2, 1, 3)
            squares = voxels.reshape(16, 16, 8, 4, 8, 4).mean(axis=(3, 5))
            between += squares.var(axis=(2, 3)).sum()
            every += voxels.var(axis=(2, 3)).sum()
    assert coarse == pytest.approx(between / every, abs=0.02)
    assert (coarse > clouds_room._TUFTS) == tufts


def test_a_voxel_has_the_kind_of_its_foliage():
    """Voxels with ground are of low plants; over it level leaves, tufts and other leaves have kinds."""
    corners_m = np.array([[0, 0, 2], [0.02, 0, 2], [0.02, 0.02, 2], [0, 0.02, 2]]) + 0.1
    turned_m = corners_m[:, [2, 0, 1]] - [2.0, 0.0, -2.0]
    face = np.arange(4, dtype="u4").reshape(1, 4)
    level, upright = (cloud_of([Mesh(m.astype("f4"), face)], PARTS[1:]) for m in (corners_m, turned_m))
    for cloud, kind in ((level, LEVEL), (upright, CROWN), (replace(upright, tufts=True), TUFTS)):
        record = records_of_a_shape(cloud, 0.0)
        record = record[record & np.uint32(127 << 7) > 0]
        assert (record >> KIND_BIT == kind).all()
        assert len(record) == 1
        low = records_of_a_shape(cloud, 2.0)
        assert (low[low & GROUND > 0] >> KIND_BIT == LOW).all()


def place_of(owner):
    """Number of the tile, and row of its surfaces, of an owner."""
    return int(owner >> TILE_BIT) & 15, int(owner) & 0xFFFFFFFF


def test_owners_have_their_shares(blocks):
    """Each record's shares rise to 255, and over a block each owner has the area of its own cells, within
    rounding."""
    _, library, tiles, made = blocks
    block = made[0, 0]
    ends = np.append(block.first_owner[1:], len(block.owner))
    area_of = {}
    for at, (begin, end) in enumerate(zip(block.first_owner.tolist(), ends.tolist(), strict=True)):
        code = int(block.record[at])
        assert (code & 127 > 0) == (end > begin)
        if end == begin:
            continue
        shares = (block.owner[begin:end] >> SHARE_BIT).astype(int)
        assert (np.diff(shares) >= 0).all()
        assert shares[-1] == 255
        # An owner has the drawn numbers that are above its forerunner's share, up to its own: of 0 .. 255.
        own = np.diff([-1, *shares]) / 256
        for n, part in enumerate(own):
            name = place_of(block.owner[begin + n])
            area_of[name] = area_of.get(name, 0.0) + part * TAU_PER_M[code >> 7 & 127] * VOXEL_M**3
    checked, low_m = 0, np.array([0.0, 0.0, 2.0 * block.bottom])
    for number, (dx, dy) in enumerate(itertools.product((-1, 0, 1), repeat=2)):
        tile = tiles[dx, dy]
        for which, place, row in zip(tile.shape, tile.world_T_shape, tile.first_surface, strict=True):
            if tile.keys[which] != "crown":
                continue
            cells_m = library.place_m[: library.first_cell[1]] @ place[:, :3].T + place[:, 3] - low_m
            inside = ((cells_m[:, :2] >= 0) & (cells_m[:, :2] < COLUMNS * VOXEL_M)).all(axis=1)
            scale = abs(np.linalg.det(place[:, :3])) ** (2 / 3)
            for mesh in (0, 1):
                own = inside & (library.mesh[: library.first_cell[1]] == mesh)
                true = (
                    scale * library.area_m2[: library.first_cell[1]][own].sum() * library.projection[mesh, 1]
                )
                if true > 1.0:
                    assert area_of[number, int(row) + mesh] == pytest.approx(true, rel=0.1)
                    checked += 1
    assert checked >= 2


def test_a_block_depends_on_its_neighbours_only(blocks):
    """A block made of nine tiles is, byte by byte, the one made with tiles farther off present too."""
    world, library, _, made = blocks
    more = {place: hovering(world, place) for place in itertools.product(range(-3, 4), repeat=2)}
    again = block_of(library, {"crown": 0, "stone": 1}, more, 0, 0)
    for name in ("mask", "first", "record", "first_owner", "owner"):
        assert getattr(again, name).tobytes() == getattr(made[0, 0], name).tobytes()


def block(number, records, owners):
    """Make a block whose numbers are its own; each record but the first has one owner, and that has the
    rest."""
    return Block(
        bottom=number,
        mask=np.full((10, 10, 1), number, np.uint64),
        first=np.arange(100, dtype=np.uint32).reshape(10, 10, 1) % np.uint32(records),
        record=np.full(records, number, np.uint32),
        first_owner=np.arange(records, dtype=np.uint32),
        owner=np.arange(owners, dtype=np.uint64) + np.uint64(1000 * number),
    )


class User:
    """Somebody who uses blocks."""


def found(shelf, name, arrays):
    """Read a block from arrays of a shelf."""
    laid, (record, first_owner, owner) = shelf.blocks[name], arrays
    shift = laid.records.start
    return Block(
        laid.bottom,
        laid.mask,
        laid.first - np.uint32(shift),
        record[laid.records],
        first_owner[laid.records] - np.uint32(laid.owners.start),
        owner[laid.owners],
    )


def same(one, other):
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in Block.__slots__)


def test_what_is_open_keeps_its_blocks_whatever_comes_and_goes():
    """Blocks of the last two of many windows are as they were made, in the arrays that each window got, also
    beside blocks without owners, as of tiles without plants; room that is free is used again."""
    rng, open_windows, shelf = np.random.default_rng(3), [], Shelf()
    for start in range(60):
        names = [(start + i, 0) for i in range(6)]
        shelf.clear(names)
        for name in names:
            if name not in shelf.blocks:
                records, owners = rng.integers(2, 400, 2).tolist()
                shelf.put(name, block(name[0], records, owners * (start % 3 > 0)), len(names))
        laid = {name: found(shelf, name, shelf.arrays) for name in names}
        kept = {
            name: replace(each, **{n: getattr(each, n).copy() for n in Block.__slots__[1:]})
            for name, each in laid.items()
        }
        user = User()
        shelf.keep(user, names)
        open_windows = [*open_windows[-1:], (user, names, shelf.arrays, kept)]
        for _, others, arrays, before in open_windows:
            assert all(same(found(shelf, name, arrays), before[name]) for name in others)
            assert all((before[name].record == name[0]).all() for name in others)
            assert all((before[name].owner // np.uint64(1000) == name[0]).all() for name in others)
        assert len(shelf.arrays[0]) <= 3 * 7 * 400  # three times those of both windows
