"""Images that lie on the points."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from woods import THIN

from vlp16emu import Emulator
from vlp16emu.cli.app import run
from vlp16emu.errors import InputError
from vlp16emu.extras.clouds.points import write_points
from vlp16emu.extras.images import write_images

OpenEXR = pytest.importorskip("OpenEXR", reason="extra images")
Image = pytest.importorskip("PIL.Image", reason="extra images")

pytestmark = pytest.mark.usefixtures("kept_woods")

PLACE = {"x_m": 1.0, "y_m": -1.5, "yaw_deg": 50.0, "pitch_deg": 12.0, "roll_deg": -7.0}
TILTED = {f"motion.{key}": value for key, value in PLACE.items()}
KINDS = {"panorama": (1024, 256), "pinhole": (640, 480)}


@pytest.fixture(scope="module")
def hall():
    """The hall, seen without errors by a sensor that is not upright."""
    return Emulator("static_bench", TILTED, ideal=True)


@pytest.fixture(scope="module", params=KINDS)
def seen(request, hall, tmp_path_factory):
    """A folder with one image of a kind."""
    folder = tmp_path_factory.mktemp(request.param) / "views"
    written = write_images(hall, folder, kind=request.param, size=KINDS[request.param], duration_s=0.1)
    assert (written.images, written.interrupted) == (1, False)
    return folder


def exact(folder):
    with OpenEXR.File(str(folder / "exr" / "000000.exr"), separate_channels=True) as image:
        return {name: channel.pixels.copy() for name, channel in image.channels().items()}


def png(folder, layer):
    with Image.open(folder / layer / "000000.png") as image:
        return np.array(image)


def pixels_of(folder, world_m):
    """Column, row and depth of points, by the formulas of scenes/OUTPUTS.md and the files alone."""
    camera = json.loads((folder / "cameras.json").read_text())
    pose = np.loadtxt(folder / "poses.tum", ndmin=2)[0]
    x, y, z = ((world_m - pose[1:4]) @ Rotation.from_quat(pose[4:]).as_matrix()).T
    if camera["kind"] == "pinhole":
        z = np.where(z > 0.1, z, np.nan)
        a, b, depth_m = x / z, y / z, z
    else:
        a, b = np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))
        depth_m = np.sqrt(x**2 + y**2 + z**2)
    column, row = camera["fx"] * a + camera["cx"], camera["fy"] * b + camera["cy"]
    inside = (column >= 1) & (column < camera["width"] - 1) & (row >= 1) & (row < camera["height"] - 1)
    return np.floor(column[inside]).astype(int), np.floor(row[inside]).astype(int), depth_m[inside], inside


def around(layer, row, column):
    """(9, n) values of pixels (n,) and of their neighbours."""
    return np.array([layer[row + i, column + j] for i in (-1, 0, 1) for j in (-1, 0, 1)])


def test_points_lie_on_their_pixels(hall, seen):
    """A point's pixel has its class and instance and a depth as around it, wherever eight neighbours have that instance."""
    points = next(iter(hall.scans(duration_s=0.2, truth=True)))
    T = points.world_T_sensor
    column, row, depth_m, inside = pixels_of(seen, points.xyz_m @ T[:3, :3].T + T[:3, 3])
    layers = exact(seen)
    near, depths_m = around(layers["instance"], row, column), around(layers["Z"], row, column)
    even = (near == near[4]).all(axis=0)
    labels = points.labels
    assert even.mean() > 0.9
    assert len(np.unique(near[4][even])) >= 3
    np.testing.assert_array_equal(near[4][even], labels.instance[inside][even])
    np.testing.assert_array_equal(layers["semantic"][row, column][even], labels.semantic[inside][even])
    # Lasers of a VLP-16 start up to 11.2 mm above or below the origin (63-9243 Rev D, table 9-1).
    # Into a corner of the room half a pixel more is as much deeper at most: its walls are one instance.
    spare_m = 0.012 + depth_m / json.loads((seen / "cameras.json").read_text())["fx"] / 2
    assert (depth_m > depths_m.min(axis=0) - spare_m)[even].all()
    assert (depth_m < depths_m.max(axis=0) + spare_m)[even].all()


def test_points_of_a_walk_lie_on_the_pixels_of_a_forest(tmp_path):
    """From a walking sensor, 98 % of the points of the next 20 ms that are off edges have their pixel's instance and depth."""
    walk = Emulator("birch_walk", THIN, ideal=True)
    write_images(walk, tmp_path / "views", kind="panorama", size=(2048, 512), start_s=0.0, duration_s=0.1)
    write_points(walk, tmp_path / "points.npz", start_s=0.0, duration_s=0.02, truth=True)
    with np.load(tmp_path / "points.npz") as points:
        column, row, depth_m, inside = pixels_of(tmp_path / "views", points["world_m"])
        instance = points["instance"][inside]
    layers = exact(tmp_path / "views")
    seen, depths_m = around(layers["instance"], row, column), around(layers["Z"], row, column)
    off_edges = (seen == seen[0]).all(axis=0)
    near = (depth_m > depths_m.min(axis=0) - 0.05) & (depth_m < depths_m.max(axis=0) + 0.05)
    agree = (instance == seen[0]) & near
    assert off_edges.sum() > 1000
    assert agree[off_edges].mean() > 0.98  # leaves of herbs are as wide as pixels


def test_sunlit_ground_is_brighter_than_shade(tmp_path):
    """Under trees the same surface seen at the same slant comes in light and in shade; in a hall there is no sun."""
    walk = Emulator("birch_walk", THIN, ideal=True)
    write_images(walk, tmp_path / "views", kind="pinhole", size=(320, 240), duration_s=0.1)
    ground = png(tmp_path / "views", "semantic") == 1
    rows = np.flatnonzero(ground.sum(axis=1) > 100)[-5:]
    rgb = png(tmp_path / "views", "rgb")[rows].sum(axis=2)[ground[rows]]
    assert 0.05 < (rgb > (int(rgb.min()) + int(rgb.max())) / 2).mean() < 0.95
    assert rgb.max() > 1.5 * rgb.min()


def test_png_and_exr_agree(seen):
    """PNG files have the labels of the OpenEXR file, and its depth in steps of 2 mm; all files are of one size."""
    layers = exact(seen)
    for name in ("semantic", "part", "species"):
        np.testing.assert_array_equal(png(seen, name), layers[name])
    assert np.abs(png(seen, "depth") * 0.002 - layers["Z"]).max() < 0.00101
    assert layers["Z"].max() > 3
    assert png(seen, "rgb").shape == (*layers["Z"].shape, 3)
    assert len(np.unique(png(seen, "rgb").reshape(-1, 3), axis=0)) > 50


def test_threads_change_no_byte(seen, tmp_path):
    """One thread gives the bytes that several give."""
    kind = json.loads((seen / "cameras.json").read_text())["kind"]
    one, out = Emulator("static_bench", TILTED, ideal=True, threads=1), tmp_path / "views"
    write_images(one, out, kind=kind, size=KINDS[kind], duration_s=0.1)
    names = sorted(path.relative_to(out) for path in out.rglob("*.*"))
    assert names == sorted(path.relative_to(seen) for path in seen.rglob("*.*"))
    assert len(names) == 8
    for name in names:
        assert (out / name).read_bytes() == (seen / name).read_bytes(), name


def test_each_image_has_its_pose(hall, tmp_path):
    """Images are taken at the beginning of the span and every so often before its end."""
    written = write_images(hall, tmp_path / "views", size=(64, 16), start_s=0.5, duration_s=0.35, every_s=0.1)
    poses = np.loadtxt(tmp_path / "views" / "poses.tum")
    assert written.images == len(poses) == 4
    seconds = poses[:, 0] - hall.scenario.start_ns / 1e9
    np.testing.assert_allclose(seconds, [0.5, 0.6, 0.7, 0.8], atol=1e-6)
    names = sorted(path.name for path in (tmp_path / "views" / "rgb").iterdir())
    assert names == [f"{number:06d}.png" for number in range(4)]


@pytest.mark.parametrize(
    ("asked", "line"),
    [
        ({"kind": "fisheye"}, "--kind: found fisheye; expected panorama or pinhole"),
        ({"size": (1001, 100)}, "--size: found 1001x100"),
        ({"size": (64, 64)}, "--size: found 64x64; expected a panorama at most half as high"),
        ({"fov_deg": 90.0}, "--fov: found 90; expected 360 of a panorama"),
        ({"kind": "pinhole", "fov_deg": 180.0}, "--fov: found 180; expected a number of degrees from 1 to 170"),
        ({"every_s": 0.0}, "every_s: found 0"),
    ],
)
def test_cameras_that_cannot_be_are_refused(hall, tmp_path, asked, line):
    """What is wrong is named, and no folder is made."""
    with pytest.raises(InputError) as error:
        write_images(hall, tmp_path / "views", **asked)
    assert line in str(error.value)
    assert list(tmp_path.iterdir()) == []


def test_the_command_writes_them(tmp_path, capsys):
    """The verb takes size, field of view and span, and reports what it wrote; a size that is none is refused."""
    words = ["images", "static_bench", str(tmp_path / "views"), "--json", "--kind", "pinhole"]
    assert run([*words, "--size", "64x48", "--fov", "60", "--every", "0.2", "--duration", "0.3"]) == 0
    said = json.loads(capsys.readouterr().out)
    camera = json.loads((tmp_path / "views" / "cameras.json").read_text())
    assert (said["images"], said["width"], said["height"], said["kind"]) == (2, 64, 48, "pinhole")
    assert camera["fx"] == pytest.approx(32 / np.tan(np.radians(30)))
    assert said["bytes"] == sum(path.stat().st_size for path in (tmp_path / "views").glob("*/*"))
    assert run(["images", "static_bench", str(tmp_path / "more"), "--size", "64"]) == 2
    assert "--size: found 64; expected width and height" in capsys.readouterr().err
