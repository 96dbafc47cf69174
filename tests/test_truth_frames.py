"""Poses that are written beside a run take points of every reader into the world."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import velodyne_decoder
from scipy.spatial.transform import Rotation, Slerp

from vlp16emu.cli.app import run
from vlp16emu.emulator import Emulator
from vlp16emu.errors import InputError
from vlp16emu.run.options import TruthTo
from vlp16emu.scan import decode
from vlp16emu.scenario import load
from vlp16emu.units import HOUR_NS

OUTPUTS = (Path(__file__).resolve().parents[1] / "scenes" / "OUTPUTS.md").read_text(encoding="utf-8")
EXACT = ("sensor.eccentricity_deg=0.0", "sensor.azimuth_noise_deg=0.0")


def tum(path):
    """Times in whole nanoseconds and the other seven columns."""
    rows = [line.split() for line in path.read_text().splitlines() if not line.startswith("#")]
    t_ns = [int(row[0].replace(".", "")) for row in rows]
    return np.array(t_ns), np.array([[float(word) for word in row[1:]] for row in rows])


def command_points(capture, *options):
    """Times since the start of the hour and points, as `vlp16emu decode` writes them."""
    out = capture.with_suffix(".npz")
    assert run(["decode", str(capture), "--out", str(out), *options]) == 0
    points = np.load(out)
    return points["clock_ns"], points["xyz_m"]


def python_points(capture, frame):
    """Times UTC and points of all whole scans."""
    scans = list(decode(capture, frame=frame))
    return np.concatenate([s.t_ns for s in scans]), np.concatenate([s.xyz_m for s in scans])


def velodyne_decoder_points(capture):
    """Times past the full hour and points of all scans of velodyne-decoder."""
    scans = list(velodyne_decoder.read_pcap(str(capture), as_pcl_structs=True))
    t_ns = [np.round(stamp.device % 3600 * 1e6) * 1e3 + np.rint(p["time"] * 1e9) for stamp, p in scans]
    xyz_m = [np.stack([p[axis] for axis in "xyz"], axis=1) for _, p in scans]
    return np.concatenate(t_ns).astype(np.int64), np.concatenate(xyz_m)


READERS = {
    "`vlp16emu decode`": command_points,
    "`vlp16emu decode --frame manual`": lambda capture: command_points(capture, "--frame", "manual"),
    "`decode(path)` in Python": lambda capture: python_points(capture, "sensor"),
    '`decode(path, frame="manual")` in Python': lambda capture: python_points(capture, "manual"),
    "velodyne-decoder 3.1": velodyne_decoder_points,
}


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """A walk in the hall without errors of the sensor: its capture, times and places of all echoes, and its trajectory."""
    folder = tmp_path_factory.mktemp("seen")
    motion = '{kind="walk", way_points_m=[[-4, -1], [-1, 0], [3, 4]]}'
    settings = [f"motion={motion}", "noise.preset=ideal", "beam.model=none", *EXACT]
    walk = Emulator(load("static_bench", [*settings, "gps.connected=true"]))
    walk.record(folder / "walk.pcap", duration_s=0.5, truth=TruthTo(folder / "truth", 2000))
    blocks = list(walk.returns(0.0, 0.5))
    origin_m, along, t_ns = (
        np.concatenate([getattr(r.firings, name).reshape(-1, *shape) for r in blocks])
        for name, shape in (("origin_m", (3,)), ("direction", (3,)), ("t_ns", ()))
    )
    distance_m = np.concatenate([r.distance_m[..., 0].ravel() for r in blocks])
    met = distance_m > 0
    return folder, t_ns[met], (origin_m + along * distance_m[:, None])[met]


@pytest.mark.parametrize("reader", READERS)
def test_poses_take_points_of_each_reader_into_the_world_as_documented(seen, reader):
    """By the formula of `scenes/OUTPUTS.md` with the pose of `trajectory.tum` points are where light met something, to the error there."""
    folder, true_ns, true_m = seen
    row = next(line.split(" | ") for line in OUTPUTS.splitlines() if line.startswith(f"| {reader} | "))
    formula, most_mm = row[2].strip("`"), float(row[3].removesuffix(" mm |"))
    past_ns, xyz_m = READERS[reader](folder / "walk.pcap")
    pulse_ns = true_ns[0] // HOUR_NS * HOUR_NS + past_ns % HOUR_NS
    t_ns, poses = tum(folder / "truth" / "trajectory.tum")
    at_s, of_s = (pulse_ns - t_ns[0]) / 1e9, (t_ns - t_ns[0]) / 1e9
    turns = Slerp(of_s, Rotation.from_quat(poses[:, 3:]))(at_s)
    places_m = np.column_stack([np.interp(at_s, of_s, poses[:, axis]) for axis in range(3)])
    x, y, z = xyz_m.T
    rotated = re.fullmatch(r"R @ \((-?[xyz]), (-?[xyz]), z\) \+ t", formula)
    axes = {"x": x, "y": y, "-x": -x, "-y": -y}
    world_m = turns.apply(np.column_stack([axes[rotated[1]], axes[rotated[2]], z])) + places_m
    # Stamps are cut off to whole microseconds; pulses are 2.304 us apart.
    pulse = np.searchsorted(true_ns, pulse_ns - 300)
    assert np.abs(true_ns[pulse] - pulse_ns).max() < 1_500
    gap_mm = 1000 * np.linalg.norm(world_m - true_m[pulse], axis=1)
    assert len(gap_mm) > 100_000
    assert 0.7 * most_mm < gap_mm.max() <= most_mm


def test_frames_turn_points_and_nothing_else(seen):
    """The manual's frame is the sensor's turned: x right for -y, y forward for x; and `rig.json` has that turn."""
    folder, _, _ = seen
    ours, manual = (next(decode(folder / "walk.pcap", frame=frame)) for frame in ("sensor", "manual"))
    x, y, z = ours.xyz_m.T
    np.testing.assert_array_equal(manual.xyz_m, np.column_stack([-y, x, z]))
    rig = json.loads((folder / "truth" / "rig.json").read_text())["manual"]["sensor_T_manual"]["matrix"]
    np.testing.assert_array_equal(manual.xyz_m @ np.array(rig)[:3, :3].T, ours.xyz_m)


def test_a_frame_that_there_is_not_is_refused(seen):
    """One line names the frames that there are."""
    with pytest.raises(InputError, match="frame: found ned; expected sensor or manual"):
        decode(seen[0] / "walk.pcap", frame="ned")
