"""Reading classic pcap files."""

import struct
from pathlib import Path

import pytest

from vlp16emu.errors import CaptureError
from vlp16emu.packets.capture import Capture
from vlp16emu.packets.frames import FACTORY_LINK, data_header, position_frame

CAPTURE = Path(__file__).parents[2] / ".." / "shared" / "captures" / "mrpt_vlp16_gps.pcap"
MICROSECONDS, NANOSECONDS = 0xA1B2C3D4, 0xA1B23C4D
DATA = data_header(FACTORY_LINK) + bytes(range(201)) * 6
POSITION = position_frame(FACTORY_LINK, bytes(512), 77)


def pcap(*frames, order="<", magic=MICROSECONDS, link_type=1, fraction=123_456, cut=0):
    """Write a capture by hand; stamps are 1 700 000 000 s and a fraction, `cut` drops bytes at the end."""
    out = struct.pack(f"{order}IHHIIII", magic, 2, 4, 0, 0, 65_535, link_type)
    for frame in frames:
        out += struct.pack(f"{order}IIII", 1_700_000_000, fraction, len(frame), len(frame)) + frame
    return out[: len(out) - cut]


def read(tmp_path, content):
    """Read a capture from its bytes."""
    path = tmp_path / "some.pcap"
    path.write_bytes(content)
    with Capture(path) as capture:
        return list(capture), capture


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("magic", "unit_ns"), [(MICROSECONDS, 1000), (NANOSECONDS, 1)])
def test_all_four_kinds_of_pcap_give_exact_stamps(tmp_path, order, magic, unit_ns):
    """Either byte order and either unit of the stamps give the same datagrams with stamps exact to the unit."""
    datagrams, capture = read(tmp_path, pcap(DATA, POSITION, order=order, magic=magic))
    assert [d.stamp_ns for d in datagrams] == [1_700_000_000_000_000_000 + 123_456 * unit_ns] * 2
    assert [d.payload for d in datagrams] == [DATA[42:], bytes(512)]
    assert not capture.cut


def test_datagram_tells_its_header_fields(tmp_path):
    """Number, lengths, ports, identification and checksum are those of the frame."""
    _, position = read(tmp_path, pcap(DATA, POSITION))[0]
    assert (position.number, position.captured_bytes, position.wire_bytes) == (2, 554, 554)
    assert (position.source_port, position.destination_port, position.identification) == (8308, 8308, 77)
    assert position.udp_checksum == int.from_bytes(POSITION[40:42])
    assert position.header == POSITION[:42]
    assert position.ip == POSITION[14:34]


def test_vlan_tag_and_ip_options_are_honoured(tmp_path):
    """The payload is found behind a VLAN tag and behind IP options."""
    tagged = DATA[:12] + bytes.fromhex("81000005") + DATA[12:]
    with_options = DATA[:14] + b"\x46" + DATA[15:34] + bytes(4) + DATA[34:]
    datagrams, _ = read(tmp_path, pcap(tagged, with_options))
    assert [d.payload for d in datagrams] == [DATA[42:]] * 2
    assert [(d.ip_offset, len(d.header)) for d in datagrams] == [(18, 46), (14, 46)]


def test_padding_behind_the_datagram_is_no_payload(tmp_path):
    """What follows the UDP length, such as Ethernet padding or a check sequence, is left out."""
    datagrams, _ = read(tmp_path, pcap(DATA + b"\xde\xad\xbe\xef"))
    assert datagrams[0].payload == DATA[42:]
    assert datagrams[0].captured_bytes == 1252


@pytest.mark.parametrize(
    "other",
    [
        pytest.param(b"", id="nothing"),
        pytest.param(DATA[:13], id="less than an Ethernet header"),
        pytest.param(DATA[:12] + b"\x08\x06" + bytes(28), id="ARP"),
        pytest.param(DATA[:12] + b"\x86\xdd\x60" + bytes(60), id="IPv6"),
        pytest.param(DATA[:30], id="half an IP header"),
        pytest.param(DATA[:40], id="half a UDP header"),
        pytest.param(DATA[:14] + b"\x44" + DATA[15:], id="IP header shorter than allowed"),
        pytest.param(DATA[:23] + b"\x06" + DATA[24:], id="TCP"),
        pytest.param(DATA[:20] + b"\x00\x10" + DATA[22:], id="later fragment"),
        pytest.param(DATA[:12] + bytes.fromhex("81000005"), id="VLAN tag at the end"),
    ],
)
def test_other_frames_are_counted_and_passed_over(tmp_path, other):
    """A frame that is no UDP over IPv4 keeps its number, so the next one is number 2."""
    datagrams, capture = read(tmp_path, pcap(other, DATA))
    assert [d.number for d in datagrams] == [2]
    assert capture.frames == 2


@pytest.mark.parametrize("cut", [1, 1247, 1248, 1250, 1263])
def test_cut_last_packet_is_reported_and_left_out(tmp_path, cut):
    """A file that ends within a record's data or header gives all whole packets before it, and says so."""
    datagrams, capture = read(tmp_path, pcap(DATA, POSITION, DATA, cut=cut))
    assert [d.number for d in datagrams] == [1, 2]
    assert capture.cut


def test_empty_capture_is_a_capture(tmp_path):
    """A file with a header alone holds no packets and is not cut."""
    datagrams, capture = read(tmp_path, pcap())
    assert (datagrams, capture.cut, capture.frames) == ([], False, 0)


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (b"", "some.pcap: no pcap file, it begins with nothing; expected a classic pcap file of Ethernet frames"),
        (b"\xd4\xc3\xb2\xa1\x02", "some.pcap: no pcap file, it begins with d4 c3 b2 a1; expected a classic pcap"),
        (b"PK\x03\x04" + bytes(40), "some.pcap: no pcap file, it begins with 50 4b 03 04; expected a classic"),
        (bytes.fromhex("0a0d0d0a") + bytes(40), "some.pcap: a pcapng file; expected a classic pcap file"),
        (pcap(link_type=113), "some.pcap: a pcap file of link type 113; expected .*, link type 1$"),
        (pcap() + struct.pack("<IIII", 0, 0, 2**31, 9), "packet 1: a length of 2147483648 bytes; expected at most"),
    ],
)
def test_other_files_are_refused_in_one_line(tmp_path, content, line):
    """Whatever is no sound classic pcap of Ethernet is an error that names file, finding and expectation."""
    with pytest.raises(CaptureError, match=line) as caught:
        read(tmp_path, content)
    assert "\n" not in str(caught.value)


def test_missing_file_and_folder_are_refused(tmp_path):
    """A path that cannot be opened for reading is a CaptureError with the system's reason."""
    with pytest.raises(CaptureError, match="No such file"):
        Capture(tmp_path / "none.pcap")
    with pytest.raises(CaptureError, match="Is a directory"):
        Capture(tmp_path)


@pytest.mark.skipif(not CAPTURE.exists(), reason="no real captures beside the repository")
def test_real_capture_is_read():
    """The real capture holds 293 data and 57 position packets with the stamps that Wireshark shows."""
    with Capture(CAPTURE) as capture:
        datagrams = list(capture)
    assert [len(d.payload) for d in datagrams].count(1206) == 293
    assert [len(d.payload) for d in datagrams].count(512) == 57
    assert datagrams[0].stamp_ns == 1_453_364_282_708_714_000
    assert datagrams[1].identification == 0x8537
