"""Points in the formats that other programs open, read back through those programs' own libraries."""

import shutil
import subprocess
import sys
from concurrent.futures import CancelledError
from datetime import UTC, date, datetime
from threading import Event

import numpy as np
import pytest
from woods import THIN

from vlp16emu import Emulator
from vlp16emu.errors import MissingExtraError
from vlp16emu.extras.clouds.cloud import (
    LABEL_COLUMNS,
    SCENE_COLUMNS,
    TRUTH_COLUMNS,
    CloudMetadata,
    label_scheme,
    point_file,
)
from vlp16emu.extras.clouds.las import adjusted_gps_s, echoes_of, local_wkt
from vlp16emu.extras.clouds.points import write_points
from vlp16emu.extras.truth.truth import write_truth
from vlp16emu.types import PlantPart, Semantic

laspy = pytest.importorskip("laspy")
pytest.importorskip("lazrs")

pytestmark = pytest.mark.usefixtures("kept_woods")

SETTINGS = THIN | {
    "sensor.max_range_m": 12.0,
    "sensor.return_mode": "dual",
    "gps.height_m": 312.5,
    "beam.rays": 8,
    "beam.model": "fixed",
}
SUFFIXES = ("npz", "laz", "las", "pcd")
LABELLED = SCENE_COLUMNS + TRUTH_COLUMNS + LABEL_COLUMNS


@pytest.fixture(scope="module")
def cloud(tmp_path_factory):
    """Folder with 0.15 s of a walk with two returns, as points.SUFFIX; and the arrays."""
    folder, emulator = tmp_path_factory.mktemp("cloud"), Emulator("birch_walk", SETTINGS)
    for suffix in SUFFIXES:
        write_points(emulator, folder / f"points.{suffix}", duration_s=0.15, labels="for-instance")
    with np.load(folder / "points.npz") as arrays:
        return folder, dict(arrays)


@pytest.mark.parametrize("suffix", ["las", "laz"])
def test_las_has_the_points_where_they_are(cloud, suffix):
    """Through laspy coordinates are within half of 0.1 mm, and fields and extra dimensions are the arrays
    themselves."""
    folder, own = cloud
    read = laspy.read(folder / f"points.{suffix}")
    assert (str(read.header.version), read.header.point_format.id) == ("1.4", 6)
    assert read.header.point_count == len(own["t_ns"]) > 10_000
    assert np.abs(read.xyz - own["world_m"]).max() < 0.51e-4
    np.testing.assert_allclose(read.header.mins, read.xyz.min(axis=0))
    assert (read.intensity == own["reflectivity"].astype(int) * 256).all()
    assert (read.user_data == own["return_number"]).all()
    assert (read.point_source_id == 1).all()
    assert (read.classification == own["label"]).all()
    same = ("ring", "laser", "instance", "semantic", "part", "leaf_wood", "species")
    others = {
        "treeID": own["tree_id"],
        "distance": own["distance_m"],
        "azimuth": own["azimuth_deg"].astype("f4"),
    }
    others |= {"height_above_ground": own["height_m"], "vp_z": own["viewpoint_m"][:, 2]}
    for name, array in ({name: own[name] for name in same} | others).items():
        np.testing.assert_array_equal(read[name], array, err_msg=name)


def test_las_says_which_time_and_coordinate_system_it_has(cloud):
    """GPS time is UTC with 18 leap seconds, from 1980-01-06, less 1e9 s; the WKT record is that of the
    scene's origin."""
    folder, own = cloud
    read = laspy.read(folder / "points.laz")
    assert read.header.global_encoding.gps_time_type == laspy.header.GpsTimeType.STANDARD
    assert read.header.creation_date == date(2026, 6, 12)  # of the scene, not of today
    t_s = own["t_ns"] / 1e9 - datetime(1980, 1, 6, tzinfo=UTC).timestamp() + 18 - 1e9
    np.testing.assert_allclose(read.gps_time, t_s, rtol=0, atol=3e-7)
    assert read.header.global_encoding.wkt
    assert read.header.vlrs.get("WktCoordinateSystemVlr")[0].string.rstrip("\0") == local_wkt(
        62.24, 25.75, 312.5
    )


def test_ply_has_only_types_that_its_readers_take(cloud):
    """Open3D 0.20 takes float, double, uchar, int and uint16 and drops other scalars, also uint32 and the
    same number of bits by the name ushort; trimesh reads the arrays themselves, also the numbers of meshes
    near 2^32."""
    trimesh = pytest.importorskip("trimesh")
    folder, own = cloud
    path = folder / "points.ply"
    largest = {**own, "instance": own["instance"] | np.uint32(2**32 - 2**16)}
    with point_file(path, LABELLED, CloudMetadata(()), where="out") as writer:
        writer.write(largest)
    head = path.read_bytes().partition(b"end_header")[0].decode().splitlines()
    kinds = {line.split()[1] for line in head if line.startswith("property")}
    assert kinds == {"float", "double", "uchar", "uint16"}
    data = trimesh.load(path, process=False).metadata["_ply_raw"]["vertex"]["data"]
    for column, name in (("instance", "instance"), ("species", "species"), ("tree_id", "treeID")):
        np.testing.assert_array_equal(data[name], largest[column])


@pytest.mark.parametrize(
    ("utc", "leaps"),
    [("1980-01-06", 0), ("1981-07-01", 1), ("1998-12-31", 12), ("1999-01-01", 13), ("2016-12-31", 17)],
)
def test_leap_seconds_are_those_of_the_day(utc, leaps):
    """GPS time is ahead of UTC by the leap seconds since 1980 (IERS Bulletin C)."""
    t_ns = np.array([np.datetime64(utc, "ns").astype(np.int64)])
    days = (np.datetime64(utc) - np.datetime64("1980-01-06")).astype(int)
    assert adjusted_gps_s(t_ns)[0] == days * 86_400 + leaps - 1_000_000_000


def test_returns_of_a_pulse_are_numbered_from_the_nearest(cloud):
    """Pulses with two returns have number 1 on the nearer and 2 on the farther one; others are 1 of 1."""
    folder, own = cloud
    read = laspy.read(folder / "points.laz")
    number, count = np.asarray(read.return_number), np.asarray(read.number_of_returns)
    assert set(zip(number.tolist(), count.tolist(), strict=True)) == {(1, 1), (1, 2), (2, 2)}
    pulse = own["t_ns"]
    _, of_pulse, sizes = np.unique(pulse, return_inverse=True, return_counts=True)
    assert (sizes[of_pulse] == count).all()
    first = {int(t): r for t, r in zip(pulse[number == 1], own["distance_m"][number == 1], strict=True)}
    assert all(
        first[int(t)] < r for t, r in zip(pulse[number == 2], own["distance_m"][number == 2], strict=True)
    )


def test_echoes_of_lasers_that_fire_at_once_are_kept_apart():
    """Two lasers at one instant are two pulses."""
    t_ns, laser, distance_m = (
        np.array([5, 5, 5, 9]),
        np.array([0, 0, 1, 1], "u2"),
        np.array([4.0, 3.0, 7.0, 8.0]),
    )
    block = {"t_ns": t_ns, "laser": laser, "distance_m": distance_m}
    number, count = echoes_of(block)
    assert (number.tolist(), count.tolist()) == ([2, 1, 1, 1], [2, 2, 1, 1])
    assert [len(part) for part in echoes_of({name: array[:0] for name, array in block.items()})] == [0, 0]


def test_laz_is_read_alike_by_the_reference_decoder(cloud):
    """LASzip, whose format it is, unpacks the same bytes as the plain file has."""
    pytest.importorskip("laszip")
    folder, _ = cloud
    unpacked = laspy.read(folder / "points.laz", laz_backend=laspy.LazBackend.Laszip)
    assert (unpacked.points.array == laspy.read(folder / "points.las").points.array).all()


@pytest.mark.parametrize("height_m", [0.0, 312.5, 2000.0])
def test_the_coordinate_system_is_that_of_the_world(height_m):
    """PROJ projects points of the world, taken to the ellipsoid by pymap3d, onto their east and north
    within 1 mm at 1 km."""
    pyproj = pytest.importorskip("pyproj")
    import pymap3d

    crs = pyproj.CRS.from_wkt(local_wkt(62.24, 25.75, height_m))
    assert crs.is_compound
    angle = np.linspace(0, 2 * np.pi, 33)
    for radius_m, most_m in ((100.0, 1e-4), (1000.0, 1e-3)):
        east_m, north_m = radius_m * np.cos(angle), radius_m * np.sin(angle)
        latitude, longitude, _ = pymap3d.enu2geodetic(east_m, north_m, 0 * angle, 62.24, 25.75, height_m)
        across = pyproj.Transformer.from_crs("EPSG:4326", crs.sub_crs_list[0], always_xy=True)
        x_m, y_m = across.transform(longitude, latitude)
        assert np.hypot(x_m - east_m, y_m - north_m).max() < most_m


def test_the_bytes_do_not_depend_on_the_day_or_the_run(tmp_path):
    """A second process with another clock writes the same bytes in every format."""
    code = (
        "import datetime, sys, laspy.header as h\n"
        "h.date = type('D', (datetime.date,), {'today': classmethod(lambda c: datetime.date(1999, 2, 3))})\n"
        "from vlp16emu import Emulator, write_points\n"
        "e = Emulator('static_bench', threads=1)\n"
        f"[write_points(e, f'{tmp_path}/far.{{s}}', duration_s=0.02, labels='for-instance') for s in "
        f"{SUFFIXES!r}]\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=300)
    for suffix in SUFFIXES[1:]:
        here = tmp_path / f"here.{suffix}"
        write_points(Emulator("static_bench"), here, duration_s=0.02, labels="for-instance")
        assert here.read_bytes() == (tmp_path / f"far.{suffix}").read_bytes(), suffix


def test_pcd_is_read_by_pcls_tools(cloud, tmp_path):
    """PCL's converter reads all fields, and its text has our numbers."""
    tool = shutil.which("pcl_convert_pcd_ascii_binary") or pytest.skip("no PCL tools (Debian: pcl-tools)")
    folder, own = cloud
    text = tmp_path / "text.pcd"
    subprocess.run([tool, folder / "points.pcd", text, "0"], check=True, capture_output=True, timeout=60)
    lines = text.read_text().splitlines()
    names = next(line.split()[1:] for line in lines if line.startswith("FIELDS"))
    table = np.array([line.split() for line in lines[lines.index("DATA ascii") + 1 :]], float)
    wanted = {"x": own["world_m"][:, 0], "intensity": own["reflectivity"], "instance": own["instance"]}
    for name, array in (wanted | {"treeID": own["tree_id"], "time": own["t_ns"] / 1e9}).items():
        np.testing.assert_allclose(table[:, names.index(name)], array, rtol=1e-6, atol=1e-6, err_msg=name)


def test_a_missing_library_is_named(monkeypatch, tmp_path):
    """Without laspy the line says what to install, and no file is left."""
    monkeypatch.setitem(sys.modules, "laspy", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'vlp16emu\[cloud\]'"):
        write_points(Emulator("static_bench"), tmp_path / "a.laz", duration_s=0.05)
    assert list(tmp_path.iterdir()) == []


def test_a_stop_before_the_first_block_replaces_nothing(tmp_path):
    """A run that ends before there is a point, or a sample of truth, leaves an earlier file, and makes no
    folder."""
    (stop := Event()).set()
    emulator, earlier = Emulator("static_bench"), tmp_path / "x.csv"
    earlier.write_text("mine")
    for write, to in ((write_points, earlier), (write_truth, tmp_path / "truth")):
        with pytest.raises(CancelledError):
            write(emulator, to, stop=stop)
    assert [*tmp_path.iterdir()] == [earlier]
    assert earlier.read_text() == "mine"


def test_a_file_without_points_can_be_read(tmp_path):
    """A sensor that sees nothing makes files that are whole."""
    emulator = Emulator("static_bench", {"sensor.max_range_m": 0.6})
    for suffix in ("laz", "pcd"):
        assert write_points(emulator, tmp_path / f"none.{suffix}", duration_s=0.05).points == 0
    assert laspy.read(tmp_path / "none.laz").header.point_count == 0


def test_points_in_map_coordinates_keep_their_digits(tmp_path):
    """Far from the origin the offset takes the metres off that 32 bits cannot hold."""
    place_m = np.array([500_123.25, 6_900_456.5, 120.0])
    block = {name: np.arange(3) for name in ("t_ns", "laser")} | {
        "world_m": place_m + np.arange(3)[:, None],
        "distance_m": np.ones(3),
        "reflectivity": np.zeros(3, "u1"),
        "return_number": np.zeros(3, "u1"),
    }
    columns = [column for column in SCENE_COLUMNS if column.name in block]
    with point_file(tmp_path / "far.las", columns, CloudMetadata(()), where="far.las") as writer:
        writer.write(block)
    read = laspy.read(tmp_path / "far.las")
    np.testing.assert_allclose(read.xyz, block["world_m"], atol=0.51e-4)
    assert read.header.offsets.tolist() == [500_000.0, 6_900_000.0, 0.0]


@pytest.mark.parametrize(
    ("scheme", "ground", "stem", "leaf", "branch", "shrub", "nothing"),
    [
        ("for-instance", 2, 4, 5, 6, 1, 0),
        ("digiforests", 1, 3, 4, 4, 2, 0),
        ("asprs", 2, 5, 5, 5, 4, 1),
        ("semantickitti", 72, 71, 70, 70, 70, 0),
    ],
)
def test_schemes_have_the_published_numbers(scheme, ground, stem, leaf, branch, shrub, nothing):
    """Classes are those of the data sets' own documents, which `source` in labels.toml names."""
    surfaces = [
        (Semantic.GROUND, PlantPart.NONE),
        (Semantic.TREE, PlantPart.STEM),
        (Semantic.TREE, PlantPart.LEAF),
        (Semantic.TREE, PlantPart.DEAD_BRANCH),
        (Semantic.SHRUB, PlantPart.LEAF),
        (Semantic.NONE, PlantPart.NONE),
    ]
    semantic, part = np.array(surfaces, "u1").T
    assert label_scheme(scheme).codes(semantic, part).tolist() == [ground, stem, leaf, branch, shrub, nothing]


def test_labels_are_dense_and_heights_are_over_the_ground(cloud):
    """Trees are 1, 2, 3 ... with one number to an instance; ground points are within 15 cm of height 0,
    others above."""
    _, own = cloud
    tree = own["semantic"] == Semantic.TREE
    pairs = set(zip(own["instance"][tree].tolist(), own["tree_id"][tree].tolist(), strict=True))
    assert sorted(number for _, number in pairs) == list(range(1, len(pairs) + 1))
    assert not own["tree_id"][~tree].any()
    assert np.abs(own["height_m"][own["semantic"] == Semantic.GROUND]).max() < 0.15
    assert own["height_m"][own["part"] == PlantPart.LEAF].min() > -0.15
    gap_m = np.linalg.norm(own["world_m"] - own["viewpoint_m"], axis=1) - own["distance_m"]
    assert np.abs(gap_m).max() < 0.02  # the lasers' vertical offsets
