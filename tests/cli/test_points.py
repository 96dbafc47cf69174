"""Scenes as points."""

import numpy as np
import pytest
from kit import set_words
from woods import WORDS

from vlp16emu import Emulator
from vlp16emu.scenario import load
from vlp16emu.types import PlantPart, Semantic

pytestmark = pytest.mark.usefixtures("kept_woods")

FREE = ["--set", "sensor.model=free"]


@pytest.fixture
def points(cli, tmp_path):
    """Points of the hall as arrays, and the report."""

    def call(*options, duration=0.05, scene="static_bench"):
        path = tmp_path / "points.npz"
        outcome = cli("points", scene, path, "--duration", duration, "--json", *options)
        assert outcome.err == ""
        with np.load(path) as arrays:
            return dict(arrays), outcome.tree

    return call


def test_both_frames_are_reported(points):
    """A sensor that stands turned has the same points in the world, turned back and lifted to its height."""
    own, _ = points("--set", "motion.yaw_deg=90.0", "--set", "motion.x_m=2.0")
    x, y, z = own["sensor_m"].T
    # Azimuth 0, the sensor's x, looks north.
    np.testing.assert_allclose(own["world_m"], np.column_stack([2.0 - y, x, z + 1.5]), atol=1e-5)


@pytest.mark.parametrize("beams", [8, 16, 64, 256])
def test_a_free_table_is_what_is_seen(points, beams):
    """Elevations computed from the points are those of the table, ring by ring, and the resolution is as
    asked."""
    options = ["--set", f"sensor.beams={beams}", "--set", "sensor.vertical_fov_deg=[-25, 15]"]
    own, report = points(*FREE, *options, "--set", "sensor.azimuth_resolution_deg=0.5")
    x, y, z = own["sensor_m"].astype(float).T
    elevation_deg = np.degrees(np.arctan2(z, np.hypot(x, y)))
    np.testing.assert_allclose(elevation_deg, np.linspace(-25, 15, beams)[own["ring"]], atol=1e-4)
    assert (own["ring"] == own["laser"]).all()
    assert report["beams"] == beams
    assert report["turn"]["sequences_per_revolution"] == pytest.approx(720, rel=1e-5)
    assert report["pulses_per_s"] == pytest.approx(720 * 10 * beams, rel=1e-5)
    assert len(own["ring"]) == report["points"] == 360 * beams
    first = own["laser"] == 0
    np.testing.assert_allclose(np.diff(own["azimuth_deg"][first]), 0.5, atol=1e-5)


def test_angle_errors_show_in_the_points(points):
    """A laser that looks lower than its table meets the floor nearer, and so its points stand over the
    floor."""
    settings = ["sensor.model=free", "sensor.elevations_deg=[-30, -20, -40]", "noise.elevation_error_deg=0.3"]
    own, _ = points("--truth", *set_words(settings))
    beams = Emulator(load("static_bench", settings)).parts.head.beams
    floor = own["semantic"] == Semantic.GROUND
    told_rad = np.radians(beams.elevation_deg)
    true_rad = told_rad + np.radians(beams.elevation_error_deg)
    height_m = 1.5 - 1.5 * np.sin(told_rad) / np.sin(true_rad)
    assert (np.abs(height_m) > 1e-3).all()
    assert np.bincount(own["laser"][floor]).min() > 100
    np.testing.assert_allclose(own["world_m"][floor, 2], height_m[own["laser"][floor]], atol=1e-5)


def test_labels_name_what_was_hit(points):
    """Points with the label of a pole lie on that pole, and none is of a plant; the reflectance is the
    pole's."""
    own, _ = points("--truth", duration=0.1)
    scenario = load("static_bench")
    names = Emulator(scenario).parts.world.names
    for pole in scenario.world.poles:
        on = own["instance"] == next(number for number, name in names.items() if name == pole.name)
        assert on.sum() > 100
        gap_m = np.linalg.norm(own["world_m"][on, :2] - pole.foot_m[:2], axis=1) - pole.diameter_m / 2
        assert np.abs(gap_m).max() < 0.005  # the corners of the mesh
        np.testing.assert_allclose(own["reflectance"][on], pole.reflectance)
    for ball in scenario.world.spheres:
        on = own["instance"] == next(number for number, name in names.items() if name == ball.name)
        gap_m = np.linalg.norm(own["world_m"][on] - ball.centre_m, axis=1) - ball.diameter_m / 2
        assert np.abs(gap_m).max() < 0.005
    floor = own["semantic"] == Semantic.GROUND
    assert (own["world_m"][floor, 2] < 1e-3).all()
    assert set(own["semantic"]) == {Semantic.GROUND, Semantic.OTHER}
    assert set(own["leaf_wood"]) == set(own["part"]) == {0}


def test_fog_is_of_no_class(points):
    """Points that the air throws back lie before what else is there, and carry no class, part or plant."""
    own, _ = points("--truth", "--set", "weather.visibility_m=30", duration=0.1)
    air = own["semantic"] == Semantic.NONE
    assert 100 < air.sum() < 0.5 * air.size
    assert np.median(own["distance_m"][air]) < 0.5 * np.median(own["distance_m"][~air])
    for name in ("part", "leaf_wood", "instance", "species", "reflectance"):
        assert not own[name][air].any()


def test_leaves_are_distinguished_from_wood(points):
    """In a forest every point on a leaf is labelled leaf, on any other part of a plant wood, elsewhere
    neither."""
    own, _ = points("--truth", *WORDS, scene="birch_walk")
    assert {0, 1, 2} == set(own["leaf_wood"])
    assert (own["leaf_wood"] == 2).tolist() == (own["part"] == PlantPart.LEAF).tolist()
    assert (own["leaf_wood"] == 0).tolist() == (own["part"] == PlantPart.NONE).tolist()
    assert (own["species"][own["semantic"] == Semantic.TREE] > 0).all()


def test_a_lone_echo_is_reported_once(points):
    """In dual return an echo that is strongest and last at once is one point, as in single return."""
    single, _ = points()
    dual, report = points("--set", "sensor.return_mode=dual")
    np.testing.assert_array_equal(single["t_ns"], dual["t_ns"])
    assert report["returns"] == {"strongest": len(single["t_ns"]), "last": 0, "second_strongest": 0}


def test_pieces_make_the_whole(points):
    """Spans that meet hold each pulse once."""
    whole, _ = points(duration=0.23)
    pieces = [points("--start", start, duration=length)[0] for start, length in ((0, 0.1), (0.1, 0.13))]
    for name in ("t_ns", "world_m", "distance_m"):
        np.testing.assert_array_equal(whole[name], np.concatenate([piece[name] for piece in pieces]))


def test_a_ply_says_what_its_labels_mean(cli, tmp_path):
    """The header lists classes, parts, and leaf or wood with their numbers."""
    cli("points", "static_bench", tmp_path / "x.ply", "--duration", "0.02", "--truth")
    lines = (tmp_path / "x.ply").read_bytes().partition(b"end_header")[0].decode().splitlines()
    comments = [line for line in lines if line.startswith(("comment semantic: ", "comment part: "))]
    for line, labels in zip(comments, (Semantic, PlantPart), strict=True):
        codes = dict(code.split(" ") for code in line.partition(": ")[2].split(", "))
        assert codes == {str(int(label)): label.name.lower() for label in labels}
    assert "comment leaf_wood: 0 neither, 1 wood, 2 leaf" in lines


def test_points_have_the_truth_of_their_run(cli, tmp_path):
    """`--truth-folder` writes beside the points what `truth` writes over the same span, also for a free
    sensor."""
    for free in ([], FREE):
        span = ["--start", "0.1", "--duration", "0.3", *free]
        beside, alone = tmp_path / "beside", tmp_path / "alone"
        outcome = cli("points", "static_bench", tmp_path / "x.npz", *span, "--truth-folder", beside)
        assert outcome.code == 0
        assert cli("truth", "static_bench", alone, *span).code == 0
        assert len(list(alone.iterdir())) == 4
        for path in alone.iterdir():
            assert (beside / path.name).read_bytes() == path.read_bytes(), path.name


def test_people_get_a_summary(cli, tmp_path):
    """Without --json the beams, the sequences of a turn and the pulses of a second stand in a few lines."""
    out = cli("points", "static_bench", tmp_path / "x.ply", "--duration", "0.02", *FREE).out
    assert "\n  beams      16\n  elevation  -15, 15 deg\n" in out
    assert " of 1 800 firing sequences, 0.2 deg apart\n" in out
    assert "\n  pulses     287997." in out
