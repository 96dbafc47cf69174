"""The closed loop: a scripted drone flies a streamed scene, and what was flown repeats the run byte for
byte."""

import logging
import socket
import threading
import time
from functools import partial

import numpy as np
import pytest
from listening import Listener

from vlp16emu import Emulator
from vlp16emu.errors import OutputError, TrajectoryError
from vlp16emu.extras.live.flight import PoseReceiver
from vlp16emu.extras.truth.truth import write_truth
from vlp16emu.packets import DATA_BYTES, decode_data
from vlp16emu.run.options import PosesIn
from vlp16emu.run.part import StreamPart
from vlp16emu.types import PacketKind
from vlp16emu.units import HOUR_NS, S_NS, US_NS

pytestmark = pytest.mark.usefixtures("kept_woods")

LIVE = 'motion={kind="live"}'
BARE = ["world.length_m=11", "world.width_m=8", "world.boxes=[]", "world.spheres=[]", "world.poles=[]"]
EXACT = [
    "beam.model=none",
    "noise.preset=ideal",
    "sensor.eccentricity_deg=0.0",
    "sensor.azimuth_noise_deg=0.0",
]
RUN_S = 6.0  # a busy machine may report the pause late
PAUSE_AFTER_S = 0.4


class Told(StreamPart):
    """Calls a function with each line of a stream."""

    def __init__(self, news):
        self.news = news


class Flown:
    """A flight through a bare hall, streamed and then repeated."""

    def __init__(self, scene, folder, drone):
        self.lines, self.drone, self.over, self.lost, flight = (
            [],
            drone,
            threading.Event(),
            threading.Event(),
            [],
        )
        data, position, path = Listener(), Listener(), folder / "flown.csv"
        ports = [f"sensor.data_port={data.port}", f"sensor.position_port={position.port}"]
        settings = [*BARE, *EXACT, LIVE, *ports]

        def news(line):
            if "poses" not in line:
                return  # a busy machine is behind
            self.lines.append(line)
            if len(self.lines) == 1:  # it waits for poses
                flight.append(
                    threading.Thread(target=self._fly, args=(int(line.rpartition(":")[2]), data.came))
                )
                flight[0].start()
            elif line.startswith("poses lost"):
                self.lost.set()

        poses = PosesIn("udp://127.0.0.1:0", path)
        emulator = Emulator(scene, settings)
        self.streamed = emulator.stream(duration_s=RUN_S, poses=poses, parts=[Told(news)])
        self.over.set()
        flight[0].join()
        self.sent = {PacketKind.DATA: data.end(), PacketKind.POSITION: position.end()}
        self.again = Emulator(scene, [*settings, f"motion.flown={path}"])
        packets = list(self.again.packets(0.0, RUN_S))
        self.repeated = {kind: [p.payload for p in packets if p.kind is kind] for kind in self.sent}

    def _fly(self, port, begun):
        """Send a figure of eight, 100 poses a second, in place until the first packet comes; later pause
        until that is reported."""
        begun_s = None
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while not self.over.wait(0.01):
                begun_s = begun_s or (time.monotonic() if begun.is_set() else None)
                since_s = time.monotonic() - begun_s if begun_s else 0.0
                if since_s < PAUSE_AFTER_S or self.lost.is_set():
                    numbers = self.drone.pose(1.2 * max(0.0, since_s - 0.1), 1.2, [0.0, 0.0, 1.5], [2.0, 1.0])
                    sender.sendto(self.drone.datagram(numbers, time.monotonic_ns()), ("127.0.0.1", port))


@pytest.fixture(scope="module")
def flown(default_unit, tmp_path_factory, tool_named):
    return Flown(default_unit, tmp_path_factory.mktemp("flown"), tool_named("drone"))


def test_what_was_flown_repeats_the_run_byte_for_byte(flown):
    """Every data and position packet that was sent is in the recording of the flight, in order; the others
    were skipped."""
    for kind, sent in flown.sent.items():
        repeated = iter(flown.repeated[kind])
        assert all(payload in repeated for payload in sent), kind  # `in` goes on from where it was
        assert sent
    streamed = flown.streamed
    skipped, left_out = streamed.sent.skipped["data"], 2 * round(streamed.live.left_out_s / 0.002654208)
    missing = len(flown.repeated[PacketKind.DATA]) - len(flown.sent[PacketKind.DATA])
    # The last step has up to three packets less, and a stream that skips may skip packets of steps that were
    # left out before.
    assert skipped - 4 < missing <= skipped + left_out


def test_points_lie_on_the_surfaces(flown):
    """Put into the world with what was flown, points are on the walls, but for the steps of the wire, half
    of 2 mm, and the encoder: 0.03 deg."""
    data = np.frombuffer(b"".join(flown.repeated[PacketKind.DATA]), np.uint8).reshape(-1, DATA_BYTES)
    points = decode_data(data, keep_no_returns=False)
    hall, motion = flown.again.scenario.world, flown.again.parts.motion
    t_ns = flown.again.scenario.start_ns // HOUR_NS * HOUR_NS + points.time_ns
    poses = motion.poses_at(t_ns)
    x_m, y_m, z_m = (np.einsum("nij,nj->ni", poses.world_R_body, points.xyz_m) + poses.world_p_body_m).T
    walls_m = (hall.length_m / 2 - np.abs(x_m), hall.width_m / 2 - np.abs(y_m), z_m, hall.height_m - z_m)
    turned_deg = (
        np.degrees(np.linalg.norm(motion.kinematics_at(t_ns[::500]).body_w_rad_s, axis=1).max()) * 1e-6
    )
    across_m = np.radians(0.03 + turned_deg) * np.hypot(*points.xyz_m[:, :2].T)
    assert len(x_m) > 300_000
    assert (np.abs(walls_m).min(axis=0) <= np.hypot(0.001, across_m) + 1e-4).all()
    assert np.linalg.norm(poses.world_p_body_m - poses.world_p_body_m[0], axis=1).max() > 0.3


def test_lost_poses_are_reported_and_survived(flown):
    """A pause of more than a second is reported when it comes and when it ends, and is in the report; the
    stream goes on."""
    live = flown.streamed.live
    assert flown.lines[0].startswith("waiting for poses on udp://127.0.0.1:")
    said = [line.split(":")[0].split(" after")[0] for line in flown.lines[1:]]
    assert said[:2] == ["poses lost", "poses are back"]  # a busy machine may lose them again
    assert max(lost.lasted_s for lost in live.lost) > 1.0
    assert 0 < flown.streamed.sent.simulated_s <= RUN_S


def test_a_flight_is_put_into_the_present(each_unit):
    """With `now` the stamp of a packet is the clock of the system when its first pulse was fired."""
    data = Listener()
    ports = [f"sensor.data_port={data.port}", "sensor.position_port=10", "gps.connected=true"]
    emulator = Emulator(each_unit, [LIVE, *ports])
    bring = partial(emulator.put_pose, (0.0, 0.0, 1.5), (0.0, 0.0, 0.0, 1.0))
    streamed = emulator.stream(duration_s=3600.0, parts=[Told(lambda _: bring())], now=True, stop=data.came)
    data.end()
    first = streamed.sent.first
    assert streamed.sent.moved_s > 0
    assert abs(first.sensor_ns - first.truth_ns - streamed.sent.moved_s * S_NS) < US_NS  # stamps are whole us
    age_us = (time.time_ns() // US_NS - int.from_bytes(data.payloads[0][1200:1204], "little")) % 3_600_000_000
    assert 0 <= age_us < 60_000_000


class Opened(logging.Handler):
    """Calls a function at each window of the world that is opened."""

    def __init__(self, act):
        super().__init__(logging.DEBUG)
        self.act = act

    def emit(self, record):
        if record.getMessage().startswith("opens a window"):
            self.act()


def test_poses_that_jump_while_the_world_is_opened_do_not_hold_up_the_run(tmp_path):
    """A body that is 100 m further at each window that is opened, which would ask for windows without end:
    the run begins after a few, and ends with its packets and ground truth."""
    ports = ["sensor.data_port=9", "sensor.position_port=10"]
    emulator = Emulator("static_bench", [*BARE, *EXACT, LIVE, *ports])
    places = []

    def jump():
        assert len(places) < 30
        places.append(100.0 * len(places))
        emulator.put_pose((places[-1], 0.0, 1.5), (0.0, 0.0, 0.0, 1.0))

    log = logging.getLogger("vlp16emu.engine.windows")
    level = log.level
    handler = Opened(jump)
    log.addHandler(handler)
    log.setLevel(logging.DEBUG)
    jumping = Told(lambda line: jump() if line.startswith("waiting") else None)
    try:
        streamed = emulator.stream(duration_s=0.1, parts=[jumping], truth=tmp_path / "truth")
    finally:
        log.removeHandler(handler)
        log.setLevel(level)
    assert streamed.live.poses > 2
    assert not streamed.interrupted
    assert (tmp_path / "truth" / "trajectory.tum").exists()


def test_a_live_scene_is_not_recorded(tmp_path):
    """Recordings, truth and scans of a live scene are refused before a file is touched, and the way is
    named."""
    emulator = Emulator("static_bench", [LIVE])
    for run in (
        lambda: emulator.record(tmp_path / "x.pcap"),
        lambda: write_truth(emulator, tmp_path / "truth"),
        lambda: list(emulator.scans()),
    ):
        with pytest.raises(TrajectoryError, match=r"motion\.flown = .*--flown"):
            run()
    assert list(tmp_path.iterdir()) == []


def test_poses_of_another_scene_are_refused():
    """A pose that a program puts is for live scenes."""
    with pytest.raises(TrajectoryError, match=r'motion\.kind: found "static"; expected "live"'):
        Emulator("static_bench").put_pose((0, 0, 0), (0, 0, 0, 1))


def test_a_port_in_use_is_reported():
    """Two receivers on one port, or one on an address of another machine, are refused."""
    taken = "expected an IPv4 address of this machine and a free port"
    with PoseReceiver("udp://127.0.0.1:0", lambda *_: None) as first, pytest.raises(OutputError, match=taken):
        PoseReceiver(first.where, lambda *_: None)
    with pytest.raises(OutputError):
        PoseReceiver("udp://192.0.2.1:7000", lambda *_: None)
