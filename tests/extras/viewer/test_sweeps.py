"""Sweeps of captures: with the truth of their run, and with packets that are broken."""

from contextlib import closing

import dpkt
import numpy as np
import pytest

from vlp16emu import Emulator
from vlp16emu.run.options import TruthTo

pytest.importorskip("viser", reason="the extra viewer is not installed")

from vlp16emu.extras.viewer.layers import LAYERS, coloured, layers_of_scan
from vlp16emu.extras.viewer.sweeps import CaptureSweeps

pytestmark = pytest.mark.usefixtures("kept_woods")

FLAG = 42 + 100  # of the second block, in a frame


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Folder with a capture of half a second of a walk, and its truth; and the emulator."""
    folder = tmp_path_factory.mktemp("capture")
    settings = {"world.stems_per_ha": 150, "seed": 5, "sensor.max_range_m": 12.0, "beam.model": "none"}
    emulator = Emulator("birch_walk", settings)
    truth = TruthTo(folder / "truth", per_return=True)
    emulator.record(folder / "walk.pcap", start_s=4.0, duration_s=0.5, truth=truth)
    return folder, emulator


def frames_of(path):
    with path.open("rb") as file:
        return list(dpkt.pcap.Reader(file))


def written(path, frames):
    with path.open("wb") as file:
        writer = dpkt.pcap.Writer(file, nano=True)
        for stamp, frame in frames:
            writer.writepkt(frame, stamp)
    return path


def test_points_of_a_capture_are_where_the_scene_has_them(run):
    """A sweep with ground truth is placed in the world to the steps of the wire, with the labels of the scene; ranges too near are blue, too far red."""
    folder, emulator = run
    with closing(CaptureSweeps(folder / "walk.pcap", folder / "truth")) as sweeps:
        sweep = sweeps.at(0.1)
    scans = emulator.scans(start_s=4.0, duration_s=0.5, truth=True)
    (scan,) = (one for one in scans if abs(one.start_ns - sweep.scan.start_ns) < 10**6)
    poses = emulator.world_T_sensor(scan.t_ns)
    world_m = np.einsum("nij,nj->ni", poses[:, :3, :3], scan.xyz_m) + poses[:, :3, 3]
    assert len(world_m) == len(sweep.world_m) > 3_000
    gap_m = np.linalg.norm(world_m - sweep.world_m, axis=1)
    assert np.quantile(gap_m, 0.99) < 0.01
    assert (sweep.scan.labels.semantic == scan.labels.semantic).all()
    assert layers_of_scan(sweep.scan) == LAYERS
    error_m = sweep.scan.distance_m - sweep.scan.labels.range_m
    assert 0.003 < np.median(np.abs(error_m)) < 0.02
    assert not sweep.faults
    red, _, blue = coloured(sweep.scan, "range error", {})[0].T.astype(int)
    assert (blue > red)[error_m < -0.01].all()
    assert (red > blue)[error_m > 0.01].all()


def test_broken_packets_are_named_and_the_rest_is_shown(run, tmp_path):
    """A packet with a broken flag and one that is lost are named with their sweep; no point of the others is missing."""
    folder, _ = run
    frames = frames_of(folder / "walk.pcap")
    data = [i for i, (_, frame) in enumerate(frames) if len(frame) == 1248]
    broken, lost = data[100], data[130]
    stamp, frame = frames[broken]
    frames[broken] = stamp, frame[:FLAG] + b"\xee\xff" + frame[FLAG + 2 :]
    bad = written(tmp_path / "bad.pcap", frames[:lost] + frames[lost + 1 :])
    with closing(CaptureSweeps(bad)) as sweeps, closing(CaptureSweeps(folder / "walk.pcap")) as whole:
        shown, all_shown = (
            {sweep.scan.start_ns: sweep for sweep in map(of.at, np.arange(0.0, 0.5, 0.04))} for of in (sweeps, whole)
        )
    faults = [(start_ns, fault) for start_ns, sweep in shown.items() for fault in sweep.faults]
    points, all_points = (sum(len(sweep.world_m) for sweep in of.values()) for of in (shown, all_shown))
    assert sorted(fault.split(": ")[1] for _, fault in faults) == ["flag", "lost-packets"]
    for start_ns, fault in faults:
        at = {"flag": broken, "lost-packets": lost}[fault.split(": ")[1]]
        assert 0 <= round(frames[at][0] * 1e9) - start_ns < 110_000_000
    assert 0 < all_points - points <= 2 * 384
