"""Images that lie on the points of the lidar."""

import json
import subprocess
import sys
from dataclasses import replace
from threading import Event

import numpy as np
import pytest
from kit import set_words
from scipy.spatial.transform import Rotation
from woods import THIN

from vlp16emu import Emulator
from vlp16emu.cli.app import run
from vlp16emu.errors import InputError, MissingExtraError, OutputError, RunError
from vlp16emu.extras.camera import folder as folder_of
from vlp16emu.extras.camera.folder import read_images, write_images
from vlp16emu.extras.camera.shot import Photographer
from vlp16emu.types import PlantPart, Semantic

pytest.importorskip("PIL.Image", reason="the extra picture is not installed")

SMALL = {"camera.width_px": 160, "camera.height_px": 120}
TILTED = {"motion.x_m": 1.0, "motion.y_m": -1.5, "motion.yaw_deg": 50.0, "motion.roll_deg": -7.0, **SMALL}
MOUNTED = {
    "camera.mount.lever_arm_m": [0.15, -0.05, -0.1],
    "camera.mount.yaw_deg": 10.0,
    "camera.mount.pitch_deg": 8.0,
    "camera.focal_px": [130.0, 126.0],
    "camera.principal_px": [84.0, 55.5],
    "camera.distortion": [-0.2, 0.05, 0.001, -0.0005, 0.01],
}


@pytest.fixture(scope="module")
def hall():
    """The hall, without errors, seen by a tilted carrier and a camera with every key."""
    return Emulator("static_bench", {**TILTED, **MOUNTED}, ideal=True)


@pytest.fixture(scope="module")
def seen(hall, tmp_path_factory):
    """A folder with two images of the hall."""
    folder = tmp_path_factory.mktemp("hall") / "images"
    written = write_images(hall, folder, duration_s=0.2, every_s=0.1)
    assert (written.images, written.simulated_s, written.interrupted) == (2, 0.2, False)
    return folder


def files_of(folder):
    return {
        path.relative_to(folder): path.read_bytes() for path in sorted(folder.rglob("*.*")) if path.is_file()
    }


def world_points(emulator, duration_s=0.1):
    """Points (n, 3) in the world and their instances."""
    scans = list(emulator.scans(duration_s=duration_s, truth=True))
    world_m = []
    for scan in scans:
        T = emulator.world_T_sensor(scan.t_ns)
        world_m.append(np.einsum("nij,nj->ni", T[:, :3, :3], scan.xyz_m) + T[:, :3, 3])
    return np.concatenate(world_m), np.concatenate([scan.labels.instance for scan in scans])


def test_points_of_the_lidar_lie_in_the_depth(hall, seen, tool_named):
    """Through a bent lens on an arm, points of the lidar off edges differ from the depth by less than a
    millimetre in the median."""
    found = tool_named("images").compared(seen, *world_points(hall))
    assert len(found.difference_m) > 800
    assert np.median(np.abs(found.difference_m)) < 0.001
    assert np.quantile(np.abs(found.difference_m), 0.9) < 0.005


def test_points_of_a_walk_lie_in_the_depth_of_a_forest(tmp_path, kept_woods, tool_named):
    """From a walking person among birches, the median difference off edges is below 5 mm, and leaf, stem
    and ground are labelled."""
    walk = Emulator("birch_walk", {**THIN, "camera.width_px": 320, "camera.height_px": 240}, ideal=True)
    write_images(walk, tmp_path / "images", duration_s=0.1)
    found = tool_named("images").compared(tmp_path / "images", *world_points(walk, 0.3))
    assert len(found.difference_m) > 500
    assert np.median(np.abs(found.difference_m)) < 0.005
    _, _, (shot,) = read_images(tmp_path / "images")
    assert {Semantic.GROUND, Semantic.TREE} <= set(shot.semantic.ravel().tolist())
    assert {PlantPart.LEAF, PlantPart.STEM} <= set(shot.part.ravel().tolist())
    assert (shot.depth_m[shot.semantic == Semantic.NONE] == 0).all()
    ground = shot.rgb[180:][shot.semantic[180:] == Semantic.GROUND].sum(axis=1)
    assert np.quantile(ground, 0.95) > 1.6 * np.quantile(ground, 0.05)  # sun and shade
    sky = shot.rgb[:60][shot.semantic[:60] == Semantic.NONE].astype(int)
    assert (sky[:, 2] > sky[:, 0]).mean() > 0.99


def test_a_row_of_a_rolling_shutter_is_that_of_its_time(kept_woods):
    """Each row of a rolling shutter shows what an image of one instant shows at that row's time; rows
    differ by the readout."""
    settings = {**THIN, **SMALL, "camera.readout_s": 0.1}
    walk = Emulator("birch_walk", settings, ideal=True)
    still = walk.changed({"camera.readout_s": 0.0})
    rolling, global_ = (Photographer(one.engine) for one in (walk, still))
    t_ns = walk.scenario.start_ns + 2_000_000_000
    shot = rolling.take(t_ns)
    times_ns = rolling.row_times_ns(t_ns, np.arange(120.0))
    assert times_ns[-1] - times_ns[0] == 100_000_000
    assert times_ns[0] + times_ns[-1] == 2 * t_ns
    for row in (0, 80, 119):
        instant = global_.take(int(times_ns[row]))
        np.testing.assert_array_equal(shot.depth_m[row], instant.depth_m[row])
        np.testing.assert_array_equal(shot.instance[row], instant.instance[row])
    assert (shot.depth_m[0] != global_.take(t_ns).depth_m[0]).any()
    np.testing.assert_array_equal(shot.world_T_camera, global_.pose(t_ns))


def test_threads_change_no_byte(seen, hall, tmp_path):
    """One thread gives the bytes that several give."""
    one = hall.with_engine(replace(hall.engine, threads=1))
    write_images(one, tmp_path / "images", duration_s=0.2, every_s=0.1)
    assert files_of(tmp_path / "images") == files_of(seen)


def test_an_image_depends_on_its_time_alone(seen, hall, tmp_path):
    """The second image of a run is the first of a run that begins there."""
    write_images(hall, tmp_path / "images", start_s=0.1, duration_s=0.1)
    _, _, (alone,) = read_images(tmp_path / "images")
    _, _, (_, second) = read_images(seen)
    assert alone.t_ns == second.t_ns == hall.scenario.start_ns + 100_000_000
    for name in ("rgb", "depth_m", "semantic", "instance"):
        np.testing.assert_array_equal(getattr(alone, name), getattr(second, name))


def test_more_samples_smooth_colours_alone(hall, seen, tmp_path):
    """Four rays for a colour change the colours of edges; depth and labels stay those of the pixel's
    middle."""
    write_images(hall, tmp_path / "images", duration_s=0.1, samples=2)
    smooth, rough = files_of(tmp_path / "images"), files_of(seen)
    for layer in ("depth", "semantic", "part", "instance"):
        name = next(name for name in smooth if name.parts[0] == layer)
        assert smooth[name] == rough[name]
    (_, _, (a,)), (_, _, shots) = read_images(tmp_path / "images"), read_images(seen)
    change = np.abs(a.rgb.astype(int) - next(shots).rgb)
    assert change.max() > 10
    assert np.median(change) <= 2


def test_depth_as_float32_has_all_digits(hall, seen, tmp_path):
    """Float depth equals the PNG's millimetres to half of one, and the PNG has 0 beyond 65.535 m."""
    write_images(hall, tmp_path / "images", duration_s=0.1, depth="float32")
    (_, _, (exact,)), (_, _, shots) = read_images(tmp_path / "images"), read_images(seen)
    coarse = next(shots)
    assert exact.depth_m.dtype == np.float32
    assert 0 < np.abs(exact.depth_m - coarse.depth_m).max() < 0.000501
    far = folder_of._in_mm(np.array([0.0, 65.5354, 65.5356, 90.0], np.float32))
    assert far.tolist() == [0, 65535, 0, 0]


def colmap_pixels(folder, number, world_m):
    """Pixels (n, 2) of points by COLMAP's text model, counted from the corner of the first pixel."""
    _, model, _, _, *numbers = (folder / "sparse/0/cameras.txt").read_text().split()
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = (*map(float, numbers[:9]),)
    assert model == "FULL_OPENCV"
    line = (folder / "sparse/0/images.txt").read_text().splitlines()[2 * number].split()
    qw, qx, qy, qz, *t = map(float, line[1:8])
    x, y, z = (Rotation.from_quat([qx, qy, qz, qw]).apply(world_m) + t).T
    x, y = x / z, y / z
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.column_stack([fx * u + cx, fy * v + cy])


def test_poses_of_all_forms_reproject_known_points(hall, seen):
    """Corners of the hall's crate have the same pixel by cameras.json, TUM, COLMAP and nerfstudio, and its
    label there."""
    x, y, z = (
        np.array([-6.0, -5.0, 0.5]) + np.array(np.meshgrid(*[(-0.5, 0.5)] * 3)).reshape(3, -1).T * [2, 1, 1]
    ).T
    corners_m = np.column_stack([x, y, z])
    cameras, lens, _ = read_images(seen)
    T = np.array(cameras["images"][1]["world_T_camera"])
    camera_m = (corners_m - T[:3, 3]) @ T[:3, :3]
    pose = np.loadtxt(seen / "poses.tum")[1]
    np.testing.assert_allclose(Rotation.from_quat(pose[4:]).as_matrix(), T[:3, :3], atol=1e-11)
    np.testing.assert_allclose(pose[1:4], T[:3, 3], atol=1e-9)
    frame = json.loads((seen / "transforms.json").read_text())["frames"][1]
    opengl = np.array(frame["transform_matrix"])
    turned = (corners_m - opengl[:3, 3]) @ opengl[:3, :3]
    np.testing.assert_allclose(turned * [1, -1, -1], camera_m, atol=1e-9)
    ahead = camera_m[:, 2] > 0.1
    np.testing.assert_allclose(
        colmap_pixels(seen, 1, corners_m)[ahead], lens.project(camera_m[ahead]) + 0.5, atol=1e-6
    )
    body = hall.parts.motion.poses_at(np.array([cameras["images"][1]["t_ns"]]))
    mount = np.array(cameras["rig"]["body_T_camera"]["matrix"])
    np.testing.assert_allclose(body.world_R_body[0] @ mount[:3, :3], T[:3, :3], atol=1e-12)
    np.testing.assert_allclose(
        body.world_R_body[0] @ [0.15, -0.05, -0.1] + body.world_p_body_m[0], T[:3, 3], atol=1e-12
    )


def test_a_level_camera_has_a_level_horizon(tmp_path):
    """Without tilt, the depth of the hall's floor is the same along a row, and a person's camera looks
    where the person goes."""
    level = Emulator("static_bench", SMALL, ideal=True)
    write_images(level, tmp_path / "images", duration_s=0.1)
    _, _, (shot,) = read_images(tmp_path / "images")
    floor = shot.depth_m[110]
    assert shot.semantic[110].tolist() == [Semantic.GROUND] * 160
    assert np.ptp(floor) <= 0.0011
    np.testing.assert_allclose(shot.world_T_camera[:3, 2], [1, 0, 0], atol=1e-12)


def test_a_camera_changes_no_packet(tmp_path):
    """A capture has the same bytes with and without [camera], and a scene without one loads none of it."""
    files = []
    for settings in ({}, SMALL):
        emulator = Emulator("static_bench", settings)
        files.append(emulator.record(tmp_path / "x.pcap", duration_s=0.05).sha256)
    assert files[0] == files[1]
    words = "import sys; from vlp16emu import Emulator; Emulator('static_bench'); "
    words += "import vlp16emu.extras.bag.write; "
    words += "sys.exit(any(name.startswith('vlp16emu.extras.camera') for name in sys.modules))"
    assert subprocess.run([sys.executable, "-c", words], check=False).returncode == 0


def test_errors_of_the_extrinsics_are_the_cameras_own(tmp_path):
    """With an error of the mount, the folder has the true extrinsics and those that its user knows."""
    settings = {**SMALL, "camera.mount.error_deg": 0.5, "camera.mount.pitch_deg": 3.0}
    write_images(Emulator("static_bench", settings), tmp_path / "images", duration_s=0.1)
    rig = json.loads((tmp_path / "images/cameras.json").read_text())["rig"]
    true, given = (np.array(rig[key]["matrix"])[:3, :3] for key in ("body_T_camera", "given_body_T_camera"))
    assert 0.05 < np.degrees(np.arccos((np.trace(true.T @ given) - 1) / 2)) < 3


def test_a_folder_with_content_is_left_alone(hall, tmp_path):
    """A folder that has a file is refused and unchanged; an empty one is filled."""
    (tmp_path / "own.txt").write_text("mine")
    with pytest.raises(OutputError, match="is there already; expected a new or empty folder"):
        write_images(hall, tmp_path, duration_s=0.1)
    assert [path.name for path in tmp_path.iterdir()] == ["own.txt"]
    (tmp_path / "empty").mkdir()
    write_images(hall, tmp_path / "empty", duration_s=0.1)
    assert (tmp_path / "empty" / "cameras.json").exists()


def test_ctrl_c_keeps_the_images_so_far(hall, tmp_path):
    """A stop after the second image leaves a whole folder of two; a stop before the first leaves nothing."""
    stop, done = Event(), []

    def progress(done_s):
        done.append(done_s)
        if len(done) == 2:
            stop.set()

    written = write_images(hall, tmp_path / "two", duration_s=1.0, every_s=0.1, progress=progress, stop=stop)
    assert (written.images, written.interrupted) == (2, True)
    assert len(list(read_images(tmp_path / "two")[2])) == 2
    with pytest.raises(folder_of.CancelledError):
        write_images(hall, tmp_path / "none", duration_s=1.0, stop=stop)
    assert [path.name for path in tmp_path.iterdir()] == ["two"]


def test_a_full_disk_leaves_the_images_before(hall, tmp_path, monkeypatch):
    """An error of the disk ends the run with a line that names where the images are left."""
    png, calls = folder_of.ImageFolder._png, []

    def full(self, *of):
        calls.append(of)
        if len(calls) > 5:
            raise OSError(28, "No space left on device")
        png(self, *of)

    monkeypatch.setattr(folder_of.ImageFolder, "_png", full)
    with pytest.raises(RunError, match=r"image 000001: No space left on device; it is left as .*part"):
        write_images(hall, tmp_path / "images", duration_s=0.5, every_s=0.1)
    (left,) = tmp_path.iterdir()
    assert (left / "rgb" / "000000.png").exists()


def test_without_pillow_the_line_names_the_extra(hall, tmp_path, monkeypatch):
    """Without pillow the error names it and its extra, and no folder is made."""
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(
        MissingExtraError, match=r"writing images needs pillow: pip install 'vlp16emu\[picture\]'"
    ):
        write_images(hall, tmp_path / "images", duration_s=0.1)
    assert list(tmp_path.iterdir()) == []


def test_a_damaged_folder_is_named(seen, tmp_path):
    """A folder without the files of `images` is refused in a line."""
    with pytest.raises(InputError, match=r"cameras.json: .*expected a folder that `images` has written"):
        read_images(tmp_path)
    (tmp_path / "cameras.json").write_text("{}")
    with pytest.raises(InputError, match=r"cameras\.json: .*missing"):
        read_images(tmp_path)
    assert seen.exists()


def test_the_command_writes_them(tmp_path, capsys):
    """The verb takes span, depth and settings, and prints what it wrote; a bad option is refused with exit
    code 2."""
    words = [
        "images",
        "static_bench",
        str(tmp_path / "images"),
        "--json",
        "--every",
        "0.2",
        "--duration",
        "0.3",
    ]
    assert run([*words, *set_words(SMALL)]) == 0
    made = json.loads(capsys.readouterr().out)
    assert (made["images"], made["width_px"], made["height_px"], made["interrupted"]) == (2, 160, 120, False)
    assert made["bytes"] == sum(len(content) for content in files_of(tmp_path / "images").values())
    assert run(["images", "static_bench", str(tmp_path / "more"), "--samples", "9"]) == 2
    assert "--samples: found 9; expected a whole number from 1 to 8" in capsys.readouterr().err
    assert run(words) == 2
    assert "is there already" in capsys.readouterr().err
