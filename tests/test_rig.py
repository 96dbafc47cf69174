"""Several sensors on one carrier."""

from dataclasses import replace
from ipaddress import IPv4Address
from pathlib import Path

import numpy as np
import pytest
import velodyne_decoder

from vlp16emu import Emulator
from vlp16emu.captures import Capture
from vlp16emu.extras.replay import packets_of
from vlp16emu.scenario import load
from vlp16emu.types import PacketKind
from vlp16emu.units import S_NS

MOUNT = "{lever_arm_m=[-0.25, 0.0, -0.15], pitch_deg=-35.0}"
WALK = 'motion={kind="walk", way_points_m=[[-10, 0], [0, 3], [10, 0]], gait={preset="none"}, harness={}}'
SPAN_S = 0.5


def made(*settings):
    """Packets of half a second."""
    emulator = Emulator(load("static_bench", [WALK, "gps.connected=true", *settings]))
    return emulator, list(emulator.packets(0.0, SPAN_S))


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """A level sensor and a tilted one in dual return, their packets, and the report of a recording of
    them."""
    emulator, packets = made(
        f"rig=[{{name='tilted', return_mode='dual', phase_lock_deg=90.0, mount={MOUNT}, seed=9}}]"
    )
    return emulator, packets, emulator.record(tmp_path_factory.mktemp("rig") / "rig.pcap", duration_s=SPAN_S)


def of_unit(packets, number):
    """Kind, time and payload of the packets of a unit."""
    return [(packet.kind, packet.due_ns, packet.payload) for packet in packets if packet.unit == number]


def data_of(packets, number):
    """Time and payload of the data packets of a unit."""
    return [row[1:] for row in of_unit(packets, number) if row[0] is PacketKind.DATA]


def test_a_unit_sends_what_it_would_send_alone(rig):
    """Each unit's packets are those of a scene with that sensor only: the others change nothing."""
    _, packets, _ = rig
    assert of_unit(packets, 0) == of_unit(made()[1], 0)
    alone = [f"motion.mount={MOUNT}", "sensor.return_mode=dual", "sensor.phase_lock_deg=90.0", "seed=9"]
    assert data_of(packets, 1) == data_of(made(*alone)[1], 0)  # the GPS receiver rides on the first unit


def test_a_prepared_rig_sends_what_it_sends_alive(rig):
    """What is read back from a recording are the packets of both units in their order, with times in whole
    microseconds."""
    emulator, packets, recorded = rig
    read = list(packets_of([unit.link for unit in emulator.parts.units], Path(recorded.file)))
    times = [
        replace(packet, due_ns=packet.due_ns // 1000 * 1000, fired_ns=None, number=0) for packet in packets
    ]
    assert read == times


def test_each_unit_has_a_capture_of_its_own(rig, tmp_path):
    """Split, a recording is a file for each unit, with that unit's records as they are in the file of
    both, byte for byte."""
    emulator, _, whole = rig
    split = emulator.record(tmp_path / "own.pcap", duration_s=SPAN_S, split=True)
    all_of = [datagram._replace(number=0) for datagram in Capture(Path(whole.file))]
    for number, unit in enumerate(emulator.parts.units, start=1):
        own = [datagram._replace(number=0) for datagram in Capture(tmp_path / f"own_{number}.pcap")]
        address = IPv4Address(unit.link.source).packed
        assert own == [datagram for datagram in all_of if datagram.source == address]
    assert (split.packets, split.position_packets) == (whole.packets, whole.position_packets)
    assert split.bytes == whole.bytes + 24  # a second head
    assert split.file == f"{tmp_path / 'own_1.pcap'}, {tmp_path / 'own_2.pcap'}"


@pytest.mark.parametrize("phase_deg", [0.0, 90.0, 275.5])
def test_a_locked_phase_is_passed_at_each_second(phase_deg):
    """At every full second of UTC the rotor stands at the locked azimuth, wherever in a second the run
    begins."""
    start = "start_utc=2026-05-20T09:00:00.37Z"
    emulator, _ = made(start, f"sensor.phase_lock_deg={phase_deg}", "sensor.rpm=780")
    second_ns = (emulator.scenario.start_ns // S_NS + 1) * S_NS
    since_ns = np.array([second_ns, second_ns + 3 * S_NS]) - emulator.scenario.start_ns
    angle_deg = emulator.parts.head.rotor.angle_deg(since_ns)
    assert np.abs((angle_deg - phase_deg + 180) % 360 - 180).max() < 1e-6


def test_a_file_of_two_is_separated_by_others(rig):
    """Frames have each unit's address and port; a decoder that is not ours reads either unit's packets."""
    _, packets, recorded = rig
    datagrams = Capture(Path(recorded.file))
    seen = {(str(IPv4Address(row.source)), row.destination_port, len(row.payload)) for row in datagrams}
    ports = ((2368, 1206), (8308, 512))
    assert seen == {(f"192.168.1.20{1 + n}", port + n, size) for n in (0, 1) for port, size in ports}
    for number, per_scan in ((0, 28_928), (1, 2 * 28_928)):
        decoder = velodyne_decoder.StreamDecoder(velodyne_decoder.Config())
        scans = [
            scan
            for due_ns, payload in data_of(packets, number)
            if (scan := decoder.decode(due_ns * 1e-9, payload, True))
        ]
        assert len(scans) >= 3
        assert all(0.2 < len(points) / per_scan < 1.01 for _, points in scans[1:])
