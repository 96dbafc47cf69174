"""Datagrams in columns are those of Python."""

import numpy as np
import pytest

from vlp16emu.captures.datagrams import Datagram, OtherBatch, PacketBuffer, PacketRows, PlainBatch
from vlp16emu.captures.runs import Run, plain_datagrams
from vlp16emu.captures.units import CapturedUnit, owners_in
from vlp16emu.packets import DATA_BYTES, POSITION_BYTES
from vlp16emu.packets.frames import FACTORY_LINK, data_header, position_frame

PLACES = [b"\x0a\0\0\1", b"\x0a\0\0\2"]
PORTS = [2368, 2369, 8308]
MACS = [b"\x60\x76\x88\x38\0\1", b"\x60\x76\x88\x38\0\2"]


def frame_of(random, number):
    """A data or position frame, or another one, of one of some senders to one of some ports."""
    kind = random.integers(3)
    if kind == 0:
        frame = data_header(FACTORY_LINK) + b"\xff\xee" + bytes(1200) + number.to_bytes(4, "little")
    elif kind == 1:
        frame = position_frame(FACTORY_LINK, bytes(POSITION_BYTES), number)
    else:
        frame = position_frame(FACTORY_LINK, bytes(int(random.integers(1, 500))), number)
    mac, place = MACS[random.integers(2)], PLACES[random.integers(2)]
    port = PORTS[random.integers(3)].to_bytes(2)
    return frame[:6] + mac + frame[12:26] + place + frame[30:36] + port + frame[38:]


@pytest.fixture(scope="module")
def frames():
    random = np.random.default_rng(17)
    return [frame_of(random, number) for number in range(400)]


@pytest.fixture(scope="module")
def batch(frames):
    length = np.array([len(frame) for frame in frames])
    begin = 5 + np.cumsum(length) - length
    run = Run(1, b"other" + b"".join(frames), begin, length, length + 4, 10**9 + np.arange(len(frames)))
    return PlainBatch(run, plain_datagrams(run), 11)


def by_hand(frames):
    """Datagrams of frames, cut in Python."""
    return [
        Datagram(
            *(11 + i, 10**9 + i, len(frame), len(frame) + 4, 14),
            *(int.from_bytes(frame[34:36]), int.from_bytes(frame[36:38])),
            *(frame[:42], frame[42:], 1),
        )
        for i, frame in enumerate(frames)
    ]


def test_a_batch_makes_the_datagrams_of_its_frames(batch, frames):
    """All datagrams of a batch, and those of a part of it, are those that Python cuts from the frames."""
    expected = by_hand(frames)
    assert batch.datagrams() == expected
    assert batch.datagrams(30, 77) == expected[30:77]
    assert [batch.payload(row) for row in range(400)] == [each.payload for each in expected]
    assert batch.payload_bytes.tolist() == [len(each.payload) for each in expected]


@pytest.mark.parametrize("mac", [b"", MACS[1]])
def test_owners_in_columns_are_those_of_datagrams(batch, frames, mac):
    """The first unit that has sent a datagram is the same for a column as for one datagram, with and without
    MAC addresses, beside a unit with an address of IPv6."""
    units = [
        CapturedUnit(b"\0" * 16, 2368, (8308,)),
        CapturedUnit(PLACES[0], 2369, (8308,), mac),
        CapturedUnit(PLACES[1], 2368, ()),
        CapturedUnit(PLACES[0], 2369, (2368,)),
    ]
    expected = [owner_by_hand(datagram, units) for datagram in by_hand(frames)]
    assert owners_in(batch, units).tolist() == expected
    assert owners_in(OtherBatch(by_hand(frames)), units).tolist() == expected
    assert {-1, 1, 2, 3} == set(expected)
    assert set(owners_in(batch, [None]).tolist()) == {0}


def owner_by_hand(datagram, units):
    """The index of the first unit whose address, port and MAC address a datagram has; -1 if there is none."""
    for i, unit in enumerate(units):
        ports = {unit.data_port, *unit.position_ports}
        is_sender = datagram.source == unit.source and unit.mac in (b"", datagram.mac)
        if is_sender and datagram.destination_port in ports:
            return i
    return -1


def test_both_kinds_of_batches_are_alike(batch, frames):
    """Frames in columns and the same frames one by one have equal numbers, stamps, flows and payloads."""
    other = OtherBatch(by_hand(frames))
    assert other.number.tolist() == batch.number.tolist()
    assert other.stamp_ns.tolist() == batch.stamp_ns.tolist()
    assert other.payload_bytes.tolist() == batch.payload_bytes.tolist()
    assert [other.payload(row) for row in range(400)] == [batch.payload(row) for row in range(400)]
    data = np.flatnonzero(batch.payload_bytes == DATA_BYTES)
    assert np.array_equal(other.payloads(data, DATA_BYTES), batch.payloads(data, DATA_BYTES))
    assert other.datagrams(30, 77) == batch.datagrams(30, 77)
    flows_of_each = []
    for each in (batch, other):
        flows, flow = each.flows()
        flows_of_each.append([flows[i] for i in flow.tolist()])
    assert flows_of_each[0] == flows_of_each[1] == [datagram.flow for datagram in by_hand(frames)]


def test_chunks_do_not_depend_on_how_packets_come():
    """Packets that come in batches of any size leave a buffer in order, in chunks of its number and a
    rest."""
    random = np.random.default_rng(19)
    packets = [
        Datagram(i, 7 * i, 1248, 1248, 14, 2368, 2368, bytes(42), random.bytes(DATA_BYTES), 1)
        for i in range(1000)
    ]
    every = OtherBatch(packets)
    buffer = PacketBuffer(64)
    chunks = []
    at = 0
    while at < len(packets):
        end = min(at + int(random.integers(1, 150)), len(packets))
        buffer.take(PacketRows.of(every, np.arange(at, end)))
        at = end
        chunks += buffer.chunks()
    chunks += buffer.rest()
    assert [len(chunk.number) for chunk in chunks] == [64] * 15 + [40]
    whole = PacketRows.joined(chunks)
    assert whole.number.tolist() == list(range(1000))
    assert whole.arrival_ns.tolist() == [7 * i for i in range(1000)]
    assert whole.payloads.tobytes() == b"".join(packet.payload for packet in packets)
    assert not list(buffer.rest())
