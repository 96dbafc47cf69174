"""What leaves beside the packets of the sensors."""

from itertools import pairwise

import numpy as np
import pytest

from vlp16emu import Emulator
from vlp16emu.extras.bench.imu_frame import decode_imu
from vlp16emu.extras.bench.outlets import PULSE_NS, DevicePackets
from vlp16emu.packets import decode_position
from vlp16emu.types import PacketKind
from vlp16emu.units import MS_NS, S_NS

ALSO = (PacketKind.NMEA, PacketKind.PPS, PacketKind.IMU)
SETTINGS = ["gps.connected=true", "imu.preset=consumer", "start_utc=2026-06-12T08:59:59.3Z"]


@pytest.fixture(scope="module")
def hall(each_unit):
    """A sensor that stands, over a full hour."""
    return Emulator(each_unit, SETTINGS, threads=1)


@pytest.fixture(scope="module")
def packets(hall):
    """Two seconds and a bit with all that leaves beside."""
    return list(all_of(hall, 0.0, 2.1))


def beside(emulator, *kinds):
    return DevicePackets(emulator.engine, kinds)


def all_of(emulator, start_s, stop_s):
    span_ns = round(start_s * S_NS), round(stop_s * S_NS)
    return beside(emulator, *ALSO).merge_with(emulator.packets(start_s, stop_s), *span_ns)


def of(packets, kind):
    return [packet for packet in packets if packet.kind is kind]


def test_packets_of_the_sensors_stay_as_they_are(hall, packets):
    """All else joins them in order of sending, and takes none of them away."""
    wire = [packet for packet in packets if packet.kind in (PacketKind.DATA, PacketKind.POSITION)]
    assert wire == list(hall.packets(0.0, 2.1))
    assert [packet.due_ns for packet in packets] == sorted(packet.due_ns for packet in packets)


def test_sentences_are_those_that_position_packets_echo(hall, packets):
    """Each leaves 0.35 s after the second that it names, and position packets echo its bytes from then on."""
    sentences = of(packets, PacketKind.NMEA)
    assert [packet.due_ns % S_NS for packet in sentences] == [350 * MS_NS] * 3
    echoed = {decode_position(packet.payload).sentence for packet in of(packets, PacketKind.POSITION)}
    assert {packet.payload for packet in sentences} < echoed
    for packet in of(packets, PacketKind.POSITION):
        before = [each.payload for each in sentences if each.due_ns <= packet.due_ns - MS_NS]
        if before:
            assert decode_position(packet.payload).sentence == before[-1]


def test_pulses_are_at_the_seconds(hall, packets):
    """They rise at whole seconds and fall 100 ms later."""
    edges = [(packet.due_ns, packet.payload) for packet in of(packets, PacketKind.PPS)]
    first_ns = -(-hall.scenario.start_ns // S_NS) * S_NS
    assert edges == [
        (first_ns + second * S_NS + level * PULSE_NS, bytes([1 - level]))
        for second in (0, 1)
        for level in (0, 1)
    ]


def test_a_run_may_be_cut_anywhere(hall, packets):
    """Whatever the spans asked for, what leaves beside is the same, and is counted right."""
    edges_s = [0.0, 0.05, 0.7, 0.8, 1.05, 1.050_000_001, 1.7123, 2.1]
    parts = []
    for start_s, stop_s in pairwise(edges_s):
        part = [p for p in all_of(hall, start_s, stop_s) if p.kind in ALSO]
        counts = beside(hall, *ALSO).count(round(start_s * S_NS), round(stop_s * S_NS))
        assert counts == {kind: len(of(part, kind)) for kind in ALSO}
        parts += part
    assert parts == [packet for packet in packets if packet.kind in ALSO]


def test_nothing_is_made_before_its_time(hall, packets, monkeypatch):
    """When a packet is taken, no sentence of a later one has been made, and no sample more than 20 ms
    ahead."""
    asked_ns = [0]
    fix, read = hall.engine.receiver.fix, hall.parts.imu.read
    monkeypatch.setattr(hall.engine.receiver, "fix", lambda t_ns: asked_ns.append(t_ns) or fix(t_ns))
    looked = np.zeros(1, np.int64)

    def noting(first, count):
        made = read(first, count)
        looked[0] = made.t_ns[-1]
        return made

    monkeypatch.setattr(hall.parts.imu, "read", noting)
    for packet in all_of(hall, 0.0, 2.0):
        assert asked_ns[-1] <= packet.due_ns
        assert looked[0] <= packet.due_ns + 20 * MS_NS


def test_samples_of_a_clock_that_drifts_leave_when_they_are_taken(each_unit, hall, packets):
    """Their stamps gain 1 % of the time of the run, and they leave at the same instants as without it."""
    settings = [*SETTINGS, "imu.clock_ppm=10000"]
    samples = of(all_of(Emulator(each_unit, settings, threads=1), 0.0, 2.1), PacketKind.IMU)
    due_ns = np.array([packet.due_ns for packet in samples])
    assert due_ns.tolist() == [packet.due_ns for packet in of(packets, PacketKind.IMU)]
    stamps_ns = np.array([decode_imu(packet.payload)["t_ns"] for packet in samples])
    np.testing.assert_allclose(stamps_ns - due_ns, 0.01 * (due_ns - hall.scenario.start_ns), atol=1000)
