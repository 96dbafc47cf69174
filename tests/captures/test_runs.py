"""The kernels that read runs of records, against plain Python and dpkt."""

import struct
from collections import deque

import dpkt
import numpy as np
import pytest

from vlp16emu.captures.capture import Capture
from vlp16emu.captures.runs import (
    DAY_S,
    LONGEST_FRAME_BYTES,
    RecordForm,
    Run,
    plain_datagrams,
    run_of,
    sound_heads,
)
from vlp16emu.packets.frames import FACTORY_LINK, data_header, position_frame
from vlp16emu.packets.layout import DATA_BYTES, POSITION_BYTES

BEGIN_S = 1_700_000_000
FILE_HEADER = b"\xd4\xc3\xb2\xa1\2\0\4\0"
AGAIN_AT = 25


def records(random, form, faults):
    """Random records in memory; some have one of the faults, and at `AGAIN_AT` a file header may stand."""
    order = ">" if form.is_big_endian else "<"
    out = b""
    seconds = BEGIN_S
    for number in range(60):
        if number == AGAIN_AT and "again" in faults:
            out += FILE_HEADER
        seconds += int(random.integers(0, 3))
        content = random.bytes(int(random.integers(0, 90)))
        head = [seconds, int(random.integers(0, 1_000_000)), len(content), len(content) + number % 3]
        if faults and random.random() < 0.1:
            match random.choice(faults):
                case "day":
                    head[0] += int(random.choice([-1, 1])) * int(random.choice([DAY_S, DAY_S + 60]))
                case "fraction":
                    head[1] = int(random.choice([999_999_999, 1_000_000_000, 2**32 - 1]))
                case "length":
                    head[2] = LONGEST_FRAME_BYTES + 1
        out += struct.pack(f"{order}4I", *head) + bytes(form.header_bytes - 16) + content
    return out


def slow_run(held, begin, again, form, near_s):
    """Walk over records as `run_of` does, with `struct`."""
    order = ">" if form.is_big_endian else "<"
    most = 10**9 // form.unit_ns
    rows = []
    while not held.startswith(again, begin):
        heads = held[begin : begin + form.header_bytes]
        if len(heads) < form.header_bytes:
            break
        seconds, fraction, captured, wire = struct.unpack_from(f"{order}4I", heads)
        following = begin + form.header_bytes + captured
        next_head = held[following : following + form.header_bytes]
        if captured > LONGEST_FRAME_BYTES or len(next_head) < form.header_bytes:
            break
        next_s, next_fraction, next_captured, _ = struct.unpack_from(f"{order}4I", next_head)
        days = abs(seconds - near_s) > DAY_S or abs(next_s - seconds) > DAY_S
        if days or max(fraction, next_fraction) >= most or next_captured > LONGEST_FRAME_BYTES:
            break
        wire = max(wire - form.check_bytes, 0)
        stamp_ns = seconds * 10**9 + fraction * form.unit_ns
        rows.append((begin + form.header_bytes, min(captured, wire), wire, stamp_ns))
        near_s = seconds
        begin = following
    return rows, begin, near_s


@pytest.mark.parametrize("is_big_endian", [False, True])
@pytest.mark.parametrize(("header_bytes", "unit_ns", "check_bytes"), [(16, 1000, 0), (24, 1, 4)])
@pytest.mark.parametrize("faults", [(), ("again",), ("day", "fraction", "length"), ("day", "again")])
def test_runs_are_those_of_plain_python(is_big_endian, header_bytes, unit_ns, check_bytes, faults):
    """A run ends before the same record, and has the same frames, whatever the records are."""
    random = np.random.default_rng(7)
    form = RecordForm(header_bytes, is_big_endian, unit_ns, 1, check_bytes)
    begin = 3
    longest = 0
    for _ in range(30):
        held = bytes(begin) + records(random, form, faults)
        held = held[: len(held) - int(random.integers(0, 40))]
        run, end, last_s = run_of(held, begin, FILE_HEADER, form, BEGIN_S)
        rows, slow_end, slow_s = slow_run(held, begin, FILE_HEADER, form, BEGIN_S)
        columns = run.begin, run.length, run.wire_bytes, run.stamp_ns
        assert list(zip(*(column.tolist() for column in columns), strict=True)) == rows
        assert (end, last_s) == (slow_end, slow_s)
        longest = max(longest, len(rows))
    assert longest > (AGAIN_AT - 2 if faults else 57)


@pytest.mark.parametrize("is_big_endian", [False, True])
@pytest.mark.parametrize("unit_ns", [1000, 1])
@pytest.mark.parametrize("near_s", [None, 0, BEGIN_S])
def test_heads_in_damaged_bytes_are_those_of_plain_python(is_big_endian, unit_ns, near_s):
    """The search for the next record stops at each place with a possible stamp and length, at no other."""
    random = np.random.default_rng(8)
    form = RecordForm(16, is_big_endian, unit_ns, 1, 0)
    order = ">" if is_big_endian else "<"
    found = 0
    for _ in range(20):
        held = records(random, form, ("day", "fraction", "length"))[int(random.integers(0, 40)) :]
        begin = int(random.integers(0, 40))
        expected = []
        for at in range(begin, len(held) - 11):
            seconds, fraction, captured = struct.unpack_from(f"{order}3I", held, at)
            is_near = near_s is None or abs(seconds - near_s) <= DAY_S
            fits = fraction < 10**9 // unit_ns and captured <= LONGEST_FRAME_BYTES
            if is_near and fits and any((seconds, fraction, captured)):
                expected.append(at)
        assert list(sound_heads(held, begin, is_big_endian, unit_ns, near_s)) == expected
        found += len(expected)
    assert found > 100


def random_frame(random):
    """A frame of a sensor, or one with something that plain frames lack."""
    payload = bytearray(random.bytes(int(random.choice([0, 100, DATA_BYTES, POSITION_BYTES, 1400]))))
    payload[:2] = b"\xff\xee"[: len(payload)]
    frame = bytearray(data_header(FACTORY_LINK, len(payload)) + payload)
    if random.random() < 0.6:
        position = position_frame(FACTORY_LINK, random.bytes(POSITION_BYTES), 3)
        data = data_header(FACTORY_LINK) + b"\xff\xee" + random.bytes(DATA_BYTES - 2)
        frame = bytearray(position if random.random() < 0.3 else data)
    match int(random.integers(0, 40)):
        case 0:
            frame[12:14] = b"\x81\x00"  # VLAN tag
        case 1:
            frame[14] = 0x46  # an IP option
        case 2:
            frame[23] = 1  # ICMP
        case 3:
            frame[20:22] = random.choice([b"\x20\0", b"\0\1", b"\x40\0", b"\0\0"])
        case 4:
            frame[36:38] = random.choice([4789, 6081]).item().to_bytes(2)  # tunnels
        case 5:
            frame[38:40] = int(random.integers(0, 1300)).to_bytes(2)
        case 6:
            frame = frame[: int(random.integers(0, len(frame) + 1))]
    return bytes(frame)


def slow_datagram(frame, wire_bytes):
    """Return the columns of a plain frame by dpkt's parsers, without its key; None if it is not plain."""
    if len(frame) < 42 or frame[12:14] != b"\x08\0":
        return None
    try:
        ip = dpkt.ip.IP(frame[14:34])
        udp = dpkt.udp.UDP(frame[34:42])
    except dpkt.UnpackError:
        return None
    if (ip.v, ip.hl, ip.p) != (4, 5, dpkt.ip.IP_PROTO_UDP) or ip.rf or ip.mf or ip.offset:
        return None
    end = 34 + udp.ulen if udp.ulen else len(frame)
    if udp.dport in (4789, 6081) or min(end, len(frame)) - 42 > DATA_BYTES:
        return None
    is_cut_short = end > len(frame) and len(frame) < wire_bytes
    return udp.sport, udp.dport, max(min(end, len(frame)), 42), int(is_cut_short)


def test_plain_datagrams_are_those_of_dpkt():
    """Ports and ends of payloads are those of dpkt's parsers, up to the first frame that is not plain."""
    random = np.random.default_rng(11)
    ends = set()
    for _ in range(60):
        frames = [random_frame(random) for _ in range(30)]
        wire_bytes = [len(frame) + int(random.integers(0, 2)) for frame in frames]
        length = np.array([len(frame) for frame in frames])
        begin = np.cumsum(length) - length
        run = Run(1, b"".join(frames), begin, length, np.array(wire_bytes), np.zeros(30, np.int64))
        found = plain_datagrams(run)
        expected = []
        for frame, size, at in zip(frames, wire_bytes, begin.tolist(), strict=True):
            if (row := slow_datagram(frame, size)) is None:
                break
            source, destination, end, is_cut_short = row
            expected.append((source, destination, at + end, is_cut_short))
        columns = found.source_port, found.destination_port, found.end, found.is_cut_short
        assert list(zip(*(column.tolist() for column in columns), strict=True)) == expected
        ends.add(len(expected))
    assert len(ends) > 10


def test_repeats_are_those_of_a_list(tmp_path):
    """A packet is left out if it is among the latest 512 packets, whether the packets come in runs or not."""
    random = np.random.default_rng(13)
    frames = list[bytes]()
    sent = deque[bytes](maxlen=512)
    expected = list[bytes]()
    while len(frames) < 20_000:
        number = len(frames)
        if 4_000 < number < 12_000 and random.random() < 0.02:
            frame = frames[-int(random.integers(1, 900))]
        else:
            payload = b"\xff\xee" + bytes(1198) + number.to_bytes(4, "little") + b"\x37\x22"
            frame = data_header(FACTORY_LINK) + payload
        frames.append(frame)
        if frame not in sent:
            sent.append(frame)
            expected.append(frame)
    path = tmp_path / "repeats.pcap"
    with path.open("wb") as file:
        writer = dpkt.pcap.Writer(file, snaplen=65_535)
        for number, frame in enumerate(frames):
            writer.writepkt_time(frame, BEGIN_S + number * 1e-3)
    capture = Capture(path)
    assert [datagram.header + datagram.payload for datagram in capture] == expected
    assert capture.repeated == len(frames) - len(expected) > 50
