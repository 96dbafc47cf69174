"""Images in bags, read back by rosbags."""

from concurrent.futures import Future
from threading import Event

import numpy as np
import pytest

from vlp16emu import Emulator
from vlp16emu.errors import InputError
from vlp16emu.extras.bag.write import write_bag
from vlp16emu.extras.camera.folder import read_images, write_images
from vlp16emu.extras.camera.shot import Photographer

pytest.importorskip("rosbags", reason="the extra ros is not installed")
pytest.importorskip("PIL.Image", reason="the extra picture is not installed")
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

SETTINGS = {
    "camera.width_px": 64,
    "camera.height_px": 48,
    "camera.rate_hz": 10,
    "camera.distortion": [-0.1, 0.02, 0.001, 0.002, 0.003],
    "camera.mount.lever_arm_m": [0.1, 0.0, -0.2],
    "camera.mount.pitch_deg": 5.0,
}
LAYERS = {
    "rgb": ("rgb8", 3),
    "depth": ("32FC1", 4),
    "semantic": ("8UC1", 1),
    "part": ("8UC1", 1),
    "instance": ("32SC1", 4),
}


def messages(path):
    """Messages by topic, in the order of the bag."""
    found = {}
    with AnyReader([path]) as reader:
        for connection, t_ns, raw in reader.messages():
            found.setdefault(connection.topic, []).append((t_ns, reader.deserialize(raw, connection.msgtype)))
    return found


def stamp_ns(message):
    stamp = message.header.stamp
    return stamp.sec * 10**9 + stamp.nanosec


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A folder with captures, truth, images and bags of one run of 0.25 s."""
    place = tmp_path_factory.mktemp("bags")
    emulator = Emulator("static_bench", SETTINGS)
    emulator.record(place / "x.pcap", duration_s=0.25, truth=place / "truth")
    write_images(emulator, place / "images", duration_s=0.25, depth="float32")
    return emulator, place


@pytest.mark.parametrize("name", ["run.mcap", "run.bag", "of_capture.bag"])
def test_bags_have_the_images_of_the_folder(bench, name):
    """Bags of a run, and of its capture with a folder, have each layer with its pixels, stamp, intrinsics
    and frame."""
    emulator, place = bench
    if name.startswith("run"):
        emulator.record(place / name, duration_s=0.25)
    else:
        write_bag(place / "x.pcap", place / name, place / "truth", images=place / "images")
    found = messages(place / name)
    _, lens, shots = read_images(place / "images")
    shots = list(shots)
    for layer, (encoding, size) in LAYERS.items():
        pictures = found[f"/camera/{layer}/image_raw"]
        assert len(pictures) == len(found[f"/camera/{layer}/camera_info"]) == len(shots) == 3
        for (logged_ns, image), (_, info), shot in zip(
            pictures, found[f"/camera/{layer}/camera_info"], shots, strict=True
        ):
            assert (image.height, image.width, image.encoding, image.step) == (48, 64, encoding, 64 * size)
            assert logged_ns == stamp_ns(image) == stamp_ns(info) == shot.t_ns
            assert image.header.frame_id == info.header.frame_id == "camera_optical_frame"
            matrix, d = (
                getattr(info, key, None) if hasattr(info, key) else getattr(info, key.upper())
                for key in ("k", "d")
            )
            np.testing.assert_array_equal(np.reshape(matrix, (3, 3)), lens.matrix)
            np.testing.assert_array_equal(d, SETTINGS["camera.distortion"])
            assert info.distortion_model == "plumb_bob"
        data = pictures[1][1].data
        if layer == "rgb":
            np.testing.assert_array_equal(data.reshape(48, 64, 3), shots[1].rgb)
        elif layer == "depth":
            depth_m = data.view(np.float32).reshape(48, 64)
            np.testing.assert_array_equal(np.nan_to_num(depth_m), shots[1].depth_m)
        elif layer == "instance":
            np.testing.assert_array_equal(data.view(np.uint32).reshape(48, 64), shots[1].instance)
        else:
            np.testing.assert_array_equal(data.reshape(48, 64), getattr(shots[1], layer))


def test_the_frame_of_the_camera_is_in_tf(bench):
    """From the world by odometry and /tf_static, the camera's pose is that of the folder, optical axis
    ahead and 5 degrees down."""
    emulator, place = bench
    emulator.record(place / "tf.mcap", duration_s=0.25)
    found = messages(place / "tf.mcap")
    (_, static), *others = found["/tf_static"]
    assert others == []
    (link,) = [one for one in static.transforms if one.child_frame_id == "camera_optical_frame"]
    assert link.header.frame_id == "base_link"
    odometry = found["/ground_truth/odom"][0][1].pose.pose

    def matrix(place_m, turn):
        T = np.eye(4)
        T[:3, :3] = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
        T[:3, 3] = [place_m.x, place_m.y, place_m.z]
        return T

    pose = matrix(odometry.position, odometry.orientation)
    pose = pose @ matrix(link.transform.translation, link.transform.rotation)
    _, _, shots = read_images(place / "images")
    np.testing.assert_allclose(pose, next(shots).world_T_camera, atol=1e-9)
    np.testing.assert_allclose(pose[:3, 2], [np.cos(np.radians(5)), 0, -np.sin(np.radians(5))], atol=1e-9)


def test_images_need_the_truth_of_their_run(bench):
    """A capture with images but without truth is refused, and no bag is made."""
    _, place = bench
    with pytest.raises(
        InputError, match="--images: found without --truth; expected --truth DIR of the same run"
    ):
        write_bag(place / "x.pcap", place / "none.mcap", images=place / "images")
    assert not (place / "none.mcap").exists()


def test_a_stopped_recording_waits_for_no_image(bench):
    """A stop while an image is taken ends the recording with a valid bag, which lacks that image."""
    emulator, place = bench
    stop = Event()

    def stop_in_image(self, t_ns):  # a camera that takes for ever, until the run ends
        stop.set()
        self.windows.wait(Future())

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Photographer, "take", stop_in_image)
        recording = emulator.record(place / "stopped.mcap", duration_s=0.25, stop=stop)
    assert recording.interrupted
    found = messages(place / "stopped.mcap")
    assert not any(topic.startswith("/camera") for topic in found)
    assert found["/ground_truth/odom"]
