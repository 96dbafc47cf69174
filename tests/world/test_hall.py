"""The hall of known shapes."""

import numpy as np
import pytest
import trimesh

from vlp16emu.errors import GeometryError
from vlp16emu.types import Semantic
from vlp16emu.world.hall import HallWorld
from vlp16emu.world.settings import Hall, HallBox, HallPole, HallSphere

CRATE = HallBox(
    name="crate", centre_m=(-6.0, -5.0, 0.5), size_m=(2.0, 1.0, 1.0), reflectance=0.3, roughness=0.1
)
POLE = HallPole(name="pole", foot_m=(6.0, 0.0, 0.0), diameter_m=0.35, height_m=6.0)
BALL = HallSphere(name="ball", centre_m=(4.0, -5.0, 1.5), diameter_m=1.0, reflectance=0.8)
TRACK_M = np.array([[0.2, 0.1, 1.5]])


def make_hall(boxes=(CRATE,), poles=(POLE,), spheres=(BALL,)):
    size = {"length_m": 30.0, "width_m": 18.0, "height_m": 6.0}
    return HallWorld(
        Hall(kind="hall", **size, wall_roughness=0.2, boxes=[*boxes], poles=[*poles], spheres=[*spheres])
    )


def solid_of(key, offset=(0, 0, 0)):
    parts = []
    for mesh in make_hall().shape(key):
        faces = (
            mesh.faces if mesh.faces.shape[1] == 3 else mesh.faces[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
        )
        parts.append(trimesh.Trimesh(mesh.vertices_m.astype(np.float64) + offset, faces))
    whole = trimesh.util.concatenate(parts)
    whole.merge_vertices()
    return whole


def test_everything_has_a_surface_of_its_own_and_a_name():
    """Floor is ground without instance; walls and things have their reflectance, coat, instance and name."""
    hall = make_hall()
    window = hall.window(TRACK_M)
    assert window.first_surface.tolist() == [0, 2, 3, 4]
    assert window.surfaces["semantic"].tolist() == [Semantic.GROUND] + [Semantic.OTHER] * 4
    assert window.surfaces["instance"].tolist() == [0, 1, 2, 3, 4]
    assert window.surfaces["reflectance"] == pytest.approx([0.6, 0.6, 0.3, 0.5, 0.8])
    assert window.surfaces["roughness"] == pytest.approx([0.2, 0.2, 0.1, 0.0, 0.0])
    assert hall.names == {1: "walls", 2: "crate", 3: "pole", 4: "ball"}
    assert [hall.materials[m] for m in window.surfaces["material"]] == [
        "room",
        "room",
        "box",
        "pole",
        "sphere",
    ]
    assert window.world_T_shape[:, :, 3].tolist() == [[0, 0, 3], [-6, -5, 0.5], [6, 0, 0], [4, -5, 1.5]]
    assert [len(hall.shape(key)) for key in window.shapes] == [2, 1, 1, 1]


def test_walls_and_things_have_the_shading_and_the_relief_that_they_are_given():
    """Floor and walls have those of the hall, each thing its own, and none by default."""
    size = {"length_m": 30.0, "width_m": 18.0, "height_m": 6.0}
    curtain = CRATE.model_copy(update={"shading": 0.25, "relief_m": 0.02})
    hall = HallWorld(Hall(kind="hall", **size, shading=0.1, relief_m=0.003, boxes=[curtain], poles=[POLE]))
    surfaces = hall.window(TRACK_M).surfaces
    assert surfaces["shading"] == pytest.approx([0.1, 0.1, 0.25, 0.0])
    assert surfaces["relief_m"] == pytest.approx([0.003, 0.003, 0.02, 0.0])


@pytest.mark.parametrize("diameter_m", [0.05, 0.35, 3.0])
def test_pole_is_round_to_a_twentieth_of_a_millimetre(diameter_m):
    """Seen along the radius from all around, a pole's surface is right within 0.05 mm and on average
    within 2 um."""
    pole = HallPole(name="pole", foot_m=(0.0, 0.0, 0.0), diameter_m=diameter_m, height_m=2.0)
    solid = solid_of(pole)
    assert solid.is_watertight
    assert solid.volume == pytest.approx(np.pi / 4 * diameter_m**2 * 2, rel=1e-4)
    angle = np.linspace(0, 2 * np.pi, 20_011)[:-1]
    outside = np.column_stack([np.cos(angle), np.sin(angle), np.full(20_010, 1.0)]) * [5, 5, 1]
    places, rays, _ = solid.ray.intersects_location(outside, -outside * [1, 1, 0], multiple_hits=False)
    radius = np.hypot(places[:, 0], places[:, 1])
    assert len(np.unique(rays)) == 20_010
    assert np.abs(radius - diameter_m / 2).max() < 5e-5
    assert abs(radius.mean() - diameter_m / 2) < 2e-6


@pytest.mark.parametrize("diameter_m", [0.1, 4.0])
def test_sphere_is_round_to_a_tenth_of_a_millimetre(diameter_m):
    """Vertices and the middles of all faces lie within 0.1 mm of the true sphere; the ball is closed."""
    solid = solid_of(HallSphere(name="ball", centre_m=(0.0, 0.0, 0.0), diameter_m=diameter_m))
    assert solid.is_watertight
    places = np.concatenate(
        [solid.vertices, solid.triangles_center, solid.vertices[solid.edges].mean(axis=1)]
    )
    assert np.abs(np.linalg.norm(places, axis=1) - diameter_m / 2).max() < 1e-4
    assert solid.volume == pytest.approx(np.pi / 6 * diameter_m**3, rel=1e-3)


def test_a_turned_box_and_a_leaning_pole_are_where_their_angles_put_them():
    """Yaw turns a box about its centre; a pole that is pitched leans from its foot towards its yaw; what
    is not turned has the unit matrix, to the bit."""
    box = CRATE.model_copy(update={"yaw_deg": 90.0})
    leaning = {"yaw_deg": 90.0, "pitch_deg": 30.0, "height_m": 2.0, "foot_m": (6.0, 0.0, 0.1)}
    pole = POLE.model_copy(update=leaning)
    turns = make_hall(boxes=(box,), poles=(pole, POLE)).window(TRACK_M).world_T_shape[:, :, :3]
    assert turns[1] @ (1.0, 0.0, 0.0) == pytest.approx([0.0, 1.0, 0.0])
    assert turns[2] @ (0.0, 0.0, 2.0) == pytest.approx([0.0, 1.0, np.sqrt(3.0)])
    assert (turns[[0, 3, 4]] == np.eye(3)).all()


@pytest.mark.parametrize(("pitch_deg", "is_inside"), [(0.0, True), (45.0, False), (-45.0, True)])
def test_a_tilted_thing_is_inside_with_all_of_it(pitch_deg, is_inside):
    """A pole of 5 m, 2 m before a wall, is inside upright or if it leans away, and refused with its extent
    if its end is in the wall; so is a plate whose corner is."""
    pole = POLE.model_copy(update={"foot_m": (13.0, 0.0, 0.5), "height_m": 5.0, "pitch_deg": pitch_deg})
    plate = CRATE.model_copy(
        update={"centre_m": (14.0, 0.0, 3.0), "size_m": (0.1, 3.0, 5.0), "pitch_deg": pitch_deg}
    )
    if is_inside:
        make_hall(poles=(pole,))
        return
    for things in ({"poles": (pole,)}, {"boxes": (plate,)}):
        with pytest.raises(GeometryError, match=r"in x.*inside -15 to 15 m"):
            make_hall(**things)
