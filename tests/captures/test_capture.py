"""Reading captures."""

import bz2
import gzip
import lzma
import os
import shutil
import struct
import subprocess
import sys
from functools import partial

import numpy as np
import pytest

from vlp16emu.captures import units_in
from vlp16emu.captures.capture import Capture, is_capture_name
from vlp16emu.errors import CaptureError
from vlp16emu.packets.frames import FACTORY_LINK, data_header, position_frame

MICROSECONDS, NANOSECONDS = 0xA1B2C3D4, 0xA1B23C4D
PAYLOAD = b"\xff\xee" + bytes(range(200)) * 6 + bytes(4)
DATA = data_header(FACTORY_LINK) + PAYLOAD
POSITION = position_frame(FACTORY_LINK, bytes(512), 77)
IP = DATA[14:]
UDP = DATA[34:]
IP6 = (
    bytes.fromhex("60000000") + struct.pack(">HBB", len(UDP), 17, 64) + bytes(15) + b"\1" + bytes(15) + b"\2"
)
TSHARK = pytest.mark.skipif(shutil.which("tshark") is None, reason="no tshark, which is the authority here")


def pcap(*frames, order="<", magic=MICROSECONDS, link_type=1, fraction=123_456, cut=0, seconds=1_700_000_000):
    """Write a capture by hand; stamps are 1 700 000 000 s and a fraction, `cut` drops bytes at the end."""
    out = struct.pack(f"{order}IHHIIII", magic, 2, 4, 0, 0, 65_535, link_type)
    for frame in frames:
        out += struct.pack(f"{order}IIII", seconds, fraction, len(frame), len(frame)) + frame
    return out[: len(out) - cut]


def block(order, kind, body):
    """Write a block of pcapng."""
    body += bytes(-len(body) % 4)
    length = struct.pack(f"{order}I", len(body) + 12)
    return struct.pack(f"{order}I", kind) + length + body + length


def pcapng(*frames, order="<", options=b"", link_types=(1,), stamp=1_700_000_000_123_456, kind=6):
    """Write a capture of pcapng by hand, with an interface for each link type and each frame as
    (interface, bytes)."""
    out = block(order, 0x0A0D0D0A, struct.pack(f"{order}IHHq", 0x1A2B3C4D, 1, 0, -1))
    for link_type in link_types:
        out += block(order, 1, struct.pack(f"{order}HHI", link_type, 0, 0) + options)
    for interface, frame in frames:
        stamps = struct.pack(f"{order}IIII", stamp >> 32, stamp & 0xFFFFFFFF, len(frame), len(frame))
        before = {
            6: struct.pack(f"{order}I", interface) + stamps,
            2: struct.pack(f"{order}HH", interface, 0) + stamps,
        }
        out += block(order, kind, before.get(kind, struct.pack(f"{order}I", len(frame))) + frame)
    return out


def tunnel(protocol, content):
    """Put an Ethernet frame of IPv4 around what a tunnel carries; the protocol 17 is UDP, with its ports
    in the content."""
    length = struct.pack(">H", 20 + len(content))
    return DATA[:16] + length + DATA[18:23] + bytes([protocol]) + DATA[24:34] + content


def gre(kind, flags, content):
    return tunnel(47, struct.pack(">BBH", flags, 0, kind) + content)


def modified(*frames):
    """Write a capture as routers do that run an old patched tcpdump: 8 more bytes in the header of each
    record."""
    out = struct.pack("<IHHIIII", 0xA1B2CD34, 2, 4, 0, 0, 65_535, 1)
    for frame in frames:
        out += struct.pack("<6I", 1_700_000_000, 123_456, len(frame), len(frame), 1, 0x800) + frame
    return out


WIFI = b"\x08\2\0\0" + bytes(20) + b"\xaa\xaa\3\0\0\0\x08\0" + IP
WIFI_QOS = b"\x88\2\0\0" + bytes(22) + b"\xaa\xaa\3\0\0\0\x08\0" + IP
GENEVE = struct.pack(">HHHHBBH4xI", 4660, 6081, 20 + len(DATA), 0, 1, 0, 0x6558, 0x01020300) + DATA


def read(tmp_path, content, name="some.pcap", **options):
    """Read a capture from its bytes."""
    path = tmp_path / name
    path.write_bytes(content)
    capture = Capture(path, **options)
    return list(capture), capture


def fragments(ip, size=776, number=9):
    """Cut an IPv4 packet without options up, with a sum of the header that nobody looks at."""
    for begin in range(0, len(ip) - 20, size):
        part, more = ip[20 + begin : 20 + begin + size], begin + size < len(ip) - 20
        words = begin // 8 | 0x2000 * more
        yield ip[:2] + struct.pack(">HHH", 20 + len(part), number, words) + ip[8:20] + part


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("magic", "unit_ns"), [(MICROSECONDS, 1000), (NANOSECONDS, 1)])
def test_all_four_kinds_of_pcap_give_exact_stamps(tmp_path, order, magic, unit_ns):
    """Either byte order and either unit of the stamps give the same datagrams with stamps exact to the
    unit."""
    datagrams, capture = read(tmp_path, pcap(DATA, POSITION, order=order, magic=magic))
    assert [d.stamp_ns for d in datagrams] == [1_700_000_000_000_000_000 + 123_456 * unit_ns] * 2
    assert [d.payload for d in datagrams] == [PAYLOAD, bytes(512)]
    assert not capture.cut


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(
    ("options", "stamp"),
    [
        (b"", 1_700_000_000_123_456),
        (struct.pack("<HHBxxx", 9, 1, 9), 1_700_000_000_123_456_000),
        (struct.pack("<HHBxxx", 9, 1, 0x80 | 20), (1_700_000_000_123_456 << 20) // 10**6 + 1),
        (struct.pack("<HHq", 14, 8, 1_700_000_000), 123_456),
    ],
)
def test_pcapng_gives_exact_stamps(tmp_path, order, options, stamp):
    """Resolution in powers of ten and of two, and an offset in seconds, are honoured (options 9 and 14 of
    pcapng)."""
    if order == ">" and options:
        code, size = struct.unpack_from("<HH", options)
        options = struct.pack(">HH", code, size) + (options[4:][::-1] if size == 8 else options[4:])
    datagrams, _ = read(tmp_path, pcapng((0, DATA), (0, POSITION), order=order, options=options, stamp=stamp))
    assert {abs(d.stamp_ns - 1_700_000_000_123_456_000) < 1000 for d in datagrams} == {True}
    assert [d.payload for d in datagrams] == [PAYLOAD, bytes(512)]


FRAMES = {
    "cooked": (113, bytes(2) + b"\0\1\0\6`v\x888\0\1\0\0\x08\0" + IP),
    "cooked 2": (276, b"\x08\0\0\0\0\0\0\1\0\1\0\6`v\x888\0\1\0\0" + IP),
    "raw": (101, IP, IP6 + UDP[:20] + bytes(1194)),
    "raw IPv4": (228, IP),
    "null": (0, b"\2\0\0\0" + IP),
    "loop": (108, b"\0\0\0\2" + IP),
    "PPP": (9, b"\x00\x21" + IP, b"\xff\x03\x00\x21" + IP6 + UDP),
    "PPPoE link": (51, b"\x11\0\0\1" + struct.pack(">H", len(IP) + 2) + b"\0\x21" + IP),
    "HDLC": (104, b"\x0f\0\x08\0" + IP),
    "VLAN": (1, DATA[:12] + b"\x81\0\0\5" + DATA[12:]),
    "QinQ": (1, DATA[:12] + b"\x88\xa8\0\5\x81\0\0\6" + DATA[12:]),
    "MPLS": (1, DATA[:12] + b"\x88\x47\0\0\x50\x40\0\0\x61\x40" + IP),
    "PPPoE": (1, DATA[:12] + b"\x88\x64\x11\0\0\1" + struct.pack(">H", len(IP) + 2) + b"\0\x21" + IP),
    "LLC": (1, DATA[:12] + struct.pack(">H", len(IP) + 8) + b"\xaa\xaa\3\0\0\0\x08\0" + IP),
    "IPv6": (1, DATA[:12] + b"\x86\xdd" + IP6 + UDP),
    "fragments": (101, *fragments(IP)),
    "fragments the last first": (101, *[*fragments(IP, 400, 10)][::-1]),
    "802.11: captcp#16": (105, WIFI, WIFI_QOS),
    "radiotap": (127, b"\0\0\x08\0\0\0\0\0" + WIFI),
    "AVS": (163, struct.pack(">II56x", 0x80211001, 64) + WIFI),
    "PPI": (192, struct.pack("<HHI", 0, 8, 105) + WIFI),
    "PKTAP of macOS: tcpdump#1330": (258, struct.pack("<III96x", 108, 1, 1) + DATA),
    "netfilter log of Linux": (239, struct.pack("<I2HI2H", 2, 8, 1, 0, 4 + len(IP), 9) + IP),
    "ERSPAN I: beats#34977": (1, gre(0x88BE, 0, DATA)),
    "ERSPAN II: captagent#59": (1, gre(0x88BE, 0x10, bytes(4) + b"\x10" + bytes(7) + DATA)),
    "ERSPAN III: heplify#121": (1, gre(0x22EB, 0x10, bytes(4) + b"\x20" + bytes(11) + DATA)),
}
"""Link type and frames of datagrams that are whole with the last of them, by what is around them."""


def shown_by_tshark(path):
    """Frame number and payload of each datagram."""
    fields = ("-T", "fields", "-e", "frame.number", "-e", "udp.payload")
    command = ["tshark", "-n", "-r", path, "-d", "udp.port==2368,data", "-Y", "udp", *fields]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()


@TSHARK
def test_frames_that_tshark_reads_are_read(tmp_path):
    """In a capture with an interface for each link, number and payload of each datagram are those that
    tshark shows."""
    rows = [(name, link, frame) for name, (link, *frames) in FRAMES.items() for frame in frames]
    content = pcapng(
        *((i, frame) for i, (_, _, frame) in enumerate(rows)), link_types=[link for _, link, _ in rows]
    )
    datagrams, _ = read(tmp_path, content, repeats=True)
    shown = dict(line.split("\t") for line in shown_by_tshark(tmp_path / "some.pcap"))
    found = {str(d.number): d.payload.hex() for d in datagrams}
    for number, (name, _, _) in enumerate(rows, 1):
        assert found.get(str(number)) == shown.get(str(number)), name
    assert {rows[d.number - 1][0] for d in datagrams} == FRAMES.keys()


@TSHARK
@pytest.mark.parametrize(
    "content",
    [
        pytest.param(pcap(IP, link_type=101), id="raw pcap"),
        pytest.param(
            pcapng((0, DATA), (1, IP), (0, POSITION), link_types=(1, 101))
            + pcapng((0, DATA), kind=3)
            + pcapng((0, DATA), kind=2)
            + pcapng((0, POSITION), order=">"),
            id="sections with all kinds of blocks",
        ),
        pytest.param(modified(DATA, POSITION), id="modified pcap: dpkt#632, ntopng#2443"),
        pytest.param(
            pcap(DATA, POSITION) + bytes(4096), id="zeros behind the end, by a loss of power: tcpreplay#405"
        ),
    ],
)
def test_containers_that_tshark_reads_are_read(tmp_path, content):
    """Frame number and payload of each datagram are those that tshark shows, whatever the container."""
    datagrams, _ = read(tmp_path, content, repeats=True)
    assert [f"{d.number}\t{d.payload.hex()}" for d in datagrams] == shown_by_tshark(tmp_path / "some.pcap")
    assert datagrams


@pytest.mark.parametrize(
    "frame",
    [
        pytest.param(DATA[:23] + b"\x04" + DATA[24:34] + IP, id="IP in IP"),
        pytest.param(DATA[:23] + b"\x2f" + DATA[24:34] + b"\0\0\x08\0" + IP, id="GRE"),
        pytest.param(
            DATA[:23] + b"\x2f" + DATA[24:34] + b"\x20\0\x65\x58\0\0\0\7" + DATA,
            id="Ethernet in GRE with a key",
        ),
        pytest.param(DATA[:36] + b"\x12\xb5" + DATA[38:42] + b"\x08" + bytes(7) + DATA, id="VXLAN"),
        pytest.param(tunnel(17, GENEVE), id="Geneve with an option"),
        pytest.param(DATA[:14] + b"\x46" + DATA[15:34] + bytes(4) + DATA[34:], id="IP options"),
        pytest.param(DATA + b"\xde\xad\xbe\xef", id="padding"),
    ],
)
def test_tunnels_options_and_padding(tmp_path, frame):
    """The payload is found in tunnels (RFC 2003, 2890, 7348) and behind IP options, and ends where UDP
    says."""
    ((datagram,), _) = read(tmp_path, pcap(frame))
    assert datagram.payload == PAYLOAD
    assert datagram.source == bytes([192, 168, 1, 201])


@pytest.mark.parametrize(
    "pack",
    [gzip.compress, partial(bz2.compress, compresslevel=1), lzma.compress, "zstandard", "backports.zstd"],
)
def test_archives_are_read_also_when_cut(tmp_path, pack, monkeypatch):
    """A compressed capture gives the same datagrams; one that ends early those before, and says so.

    Either library for zstd is enough.
    """
    if isinstance(pack, str):
        library = pytest.importorskip(pack)
        for name in {"zstandard", "backports.zstd"} - {pack}:
            monkeypatch.setitem(sys.modules, name, None)
        pack = library.compress
    random = np.random.default_rng(1)
    frames = [DATA[:60] + random.bytes(1188) for _ in range(300)]
    whole, packed = pcap(*frames), pack(pcap(*frames))
    datagrams, capture = read(tmp_path, packed, "x.pcap.packed")
    assert (datagrams, capture.cut) == (read(tmp_path, whole)[0], False)
    datagrams, capture = read(tmp_path, packed[: len(packed) * 3 // 4], "cut")
    assert 0 < len(datagrams) < 300
    assert capture.cut


def test_datagram_tells_its_header_fields(tmp_path):
    """Number, lengths, ports and identification are those of the frame."""
    _, position = read(tmp_path, pcap(DATA, POSITION))[0]
    assert (position.number, position.captured_bytes, position.wire_bytes) == (2, 554, 554)
    assert (position.source_port, position.destination_port, position.identification) == (8308, 8308, 77)
    assert (position.header, position.ip, position.mac) == (POSITION[:42], POSITION[14:34], POSITION[6:12])


NO_UDP = {
    "nothing": b"",
    "less than an Ethernet header": DATA[:13],
    "ARP": DATA[:12] + b"\x08\x06" + bytes(28),
    "IPv6 without UDP": DATA[:12] + b"\x86\xdd\x60" + bytes(60),
    "half an IP header": DATA[:30],
    "half a UDP header": DATA[:40],
    "IP header shorter than allowed": DATA[:14] + b"\x44" + DATA[15:],
    "TCP": DATA[:23] + b"\x06" + DATA[24:],
    "later fragment": DATA[:20] + b"\x00\x10" + DATA[22:],
    "VLAN tag at the end": DATA[:12] + bytes.fromhex("81000005"),
    "MPLS at the end": DATA[:12] + b"\x88\x47",
    "IPv6 extension at the end": DATA[:12] + b"\x86\xdd" + IP6[:6] + b"\0" + IP6[7:],
}


def test_other_frames_are_counted_and_passed_over(tmp_path):
    """Frames that are no UDP over IP keep their numbers, so the next one has the number after theirs."""
    datagrams, capture = read(tmp_path, pcap(*NO_UDP.values(), DATA))
    assert [d.number for d in datagrams] == [len(NO_UDP) + 1]
    assert capture.frames == len(NO_UDP) + 1


@pytest.mark.parametrize("cut", [1, 1247, 1248, 1250, 1263])
@pytest.mark.parametrize("whole", [pcap(DATA, POSITION, DATA), pcapng((0, DATA), (0, POSITION), (0, DATA))])
def test_cut_last_packet_is_reported_and_left_out(tmp_path, cut, whole):
    """A file that ends within a record's data or header gives all whole packets before it, and says so."""
    datagrams, capture = read(tmp_path, whole[:-cut])
    assert [d.number for d in datagrams] == [1, 2]
    assert capture.cut


@pytest.mark.parametrize("empty", [pcap(), pcapng(), gzip.compress(pcap(), mtime=0)])
def test_empty_capture_is_a_capture(tmp_path, empty):
    """A file with a header alone holds no packets and is not cut."""
    datagrams, capture = read(tmp_path, empty)
    assert (datagrams, capture.cut, capture.frames) == ([], False, 0)


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (b"", "some.pcap: an empty file: copy or download it again; expected a pcap or pcapng file"),
        (b"\xd4\xc3\xb2\xa1\x02", "some.pcap: no capture, it begins with d4 c3 b2 a1; expected a pcap or"),
        (b"PK\x03\x04" + bytes(40), "some.pcap: a zip archive; expected .* `unzip -p some.pcap > some.pcap`"),
        (
            gzip.compress(bytes(257) + b"ustar" + bytes(300), mtime=0),
            "some.pcap: a tar archive; expected .* `tar xOf some.pcap > some.pcap`",
        ),
        (
            pcapng((0, DATA), options=struct.pack("<HHBxxx", 9, 1, 0)),
            "block 3: a stamp of 1700000000123456 s since 1970; expected 0 to 4294967296, from 1970 to 2106",
        ),
        (
            pcap(DATA, DATA, fraction=123_456_789),
            "packet 1: a fraction of 123456789 us of a second, which are nanoseconds",
        ),
        (b"\x1f\x8b\x08\0" + bytes(40), r"some\.pcap: "),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "a pointer of Git LFS"),
        (b"\n<!DOCTYPE html><html>", "a page of HTML"),
        (lzma.compress(pcap(DATA))[:40] + bytes(400), r"some\.pcap: "),
    ],
)
def test_other_files_are_refused_in_one_line(tmp_path, content, line):
    """Whatever is no sound capture is an error that names file, finding and expectation."""
    with pytest.raises(CaptureError, match=line) as caught:
        read(tmp_path, content)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("order", ["<", ">"])
def test_the_command_for_nanoseconds_mends_the_file(tmp_path, order):
    """The command that the line names, run by the shell, leaves the same fractions, in nanoseconds."""
    path = tmp_path / "some.pcap"
    with pytest.raises(CaptureError) as caught:
        read(tmp_path, pcap(DATA, DATA, order=order, fraction=123_456_789))
    _, command, _ = str(caught.value).split("`")
    subprocess.run(
        ["sh", "-c", command.replace("COPY", "some.pcap")], cwd=tmp_path, check=True, capture_output=True
    )
    assert [each.stamp_ns for each in Capture(path, repeats=True)] == [1_700_000_000_123_456_789] * 2


@pytest.mark.parametrize(
    ("content", "cause"),
    [
        (pcap(DATA, DATA, link_type=147), "2 frames of link type 147, which is not read"),
        (pcap(next(fragments(IP)), link_type=101), r"1 datagrams whose other IP fragments .* 0x1fff != 0"),
        (
            pcap(DATA[:68]).replace(struct.pack("<II", 68, 68), struct.pack("<II", 68, 1248)),
            r"1 frames .*tcpdump -s 0",
        ),
    ],
)
def test_what_cannot_be_had_is_said_with_the_remedy(tmp_path, content, cause):
    """Without a data packet the error names the link type, the missing fragments, or the snapshot length."""
    read(tmp_path, content)
    with pytest.raises(CaptureError, match=f"no data packet, but {cause}"):
        units_in(tmp_path / "some.pcap", required=True)


def test_missing_file_and_folder_are_refused(tmp_path):
    """A path that cannot be opened for reading is a CaptureError with the system's reason."""
    with pytest.raises(CaptureError, match="no such file"):
        Capture(tmp_path / "none.pcap")
    with pytest.raises(CaptureError, match="is a directory"):
        Capture(tmp_path)


def test_a_pipe_among_the_files_of_a_pattern_is_refused(tmp_path):
    """A FIFO that nobody writes does not hold up the files beside it: it is named."""
    (tmp_path / "a.pcap").write_bytes(pcap(DATA))
    os.mkfifo(tmp_path / "b.pcap")
    with pytest.raises(CaptureError, match=r"b\.pcap: is a FIFO; expected a pcap"):
        Capture(tmp_path / "*.pcap")


def test_what_comes_twice_is_read_once(tmp_path):
    """Each packet that a bridge or `-i any` shows again is left out and counted; other datagrams are not
    looked at."""
    other = DATA[:42] + bytes(1206)
    datagrams, capture = read(tmp_path, pcap(DATA, DATA, POSITION, DATA, POSITION, other, other))
    assert [d.number for d in datagrams] == [1, 3, 6, 7]
    assert capture.repeated == 3
    assert len(read(tmp_path, pcap(DATA, DATA), repeats=True)[0]) == 2


def test_files_behind_each_other_are_one_capture(tmp_path):
    """What `cat` makes of captures is read as tenzir#3513 asks, each with its own link type; tshark stops
    at the second header."""
    datagrams, capture = read(
        tmp_path, pcap(DATA) + pcap(IP, link_type=101) + pcap() + pcap(POSITION), repeats=True
    )
    assert [(d.number, d.link_type, len(d.payload)) for d in datagrams] == [
        (1, 1, 1206),
        (2, 101, 1206),
        (3, 1, 512),
    ]
    assert not capture.cut


def test_data_packets_that_the_host_has_merged_are_taken_apart(tmp_path):
    """One datagram of three data packets, as UDP GRO of Linux hands it on (slimcap#99), is these three, of
    one frame number."""
    payloads = [b"\xff\xee" + bytes([i]) * 1204 for i in range(3)]
    whole = tunnel(17, DATA[34:38] + struct.pack(">HH", 8 + 3 * 1206, 0) + b"".join(payloads))
    datagrams, capture = read(tmp_path, pcap(whole))
    assert ([d.payload for d in datagrams], {d.number for d in datagrams}, capture.frames) == (
        payloads,
        {1},
        1,
    )
    assert {d.captured_bytes for d in datagrams} == {1248}


def test_files_of_one_walk_are_one_capture(tmp_path):
    """Files that a pattern names are read in order of time, and their frames are counted through."""
    for name, seconds in (("walk.pcap", 5), ("walk.pcap10", 15), ("walk.pcap2", 7)):
        (tmp_path / name).write_bytes(pcap(DATA[:50] + bytes([seconds]) * 1198, seconds=seconds))
    capture = Capture(tmp_path / "walk.pcap*")
    assert [(d.number, d.stamp_ns // 10**9) for d in capture] == [(1, 5), (2, 7), (3, 15)]


def test_units_of_one_address_differ_by_mac(tmp_path):
    """Two sensors as delivered on two network cards are two units; one whose way changes is one, and
    foreign traffic none."""
    other = DATA[:10] + b"\x99\x11" + DATA[12:]
    (unit,) = [datagram.mac for datagram in read(tmp_path, pcap(other))[0]]

    def payload(i):
        return (b"\xff\xee" + bytes([i]) * 98) * 12 + bytes(6)

    streams = [DATA[:42] + payload(i) for i in range(5)], [other[:42] + payload(9 + i) for i in range(5)]
    read(tmp_path, pcap(*(frame for pair in zip(*streams, strict=True) for frame in pair)), repeats=True)
    assert [str(one) for one in units_in(tmp_path / "some.pcap")] == [
        "192.168.1.201:2368@60:76:88:38:00:01",
        f"192.168.1.201:2368@{unit.hex(':')}",
    ]
    read(tmp_path, pcap(*streams[0], *streams[1], DATA[:26] + b"\1\2\3\4" + DATA[30:42] + bytes(1206)))
    assert [str(one) for one in units_in(tmp_path / "some.pcap")] == ["192.168.1.201:2368"]
    rare = [mac[:26] + b"\1\2\3\4" + mac[30:42] + payload(i) for mac, i in ((DATA, 100), (other, 101))]
    read(tmp_path, pcap(*(DATA[:42] + payload(i) for i in range(100)), *rare))
    assert [str(one) for one in units_in(tmp_path / "some.pcap")] == ["1.2.3.4:2368", "192.168.1.201:2368"]


def test_names_of_captures():
    """Rotated and compressed captures are known by their names; scenes are no captures."""
    assert all(
        map(is_capture_name, ("a.pcap", "a.PCAPNG", "a.pcap12", "a.cap.gz", "a.pcap.zst", "walk*.pcap"))
    )
    assert not any(map(is_capture_name, ("a.toml", "birch_walk", "a.pcap.toml", "pcap")))


_BLOCK = b"\xff\xee" + bytes(range(98))
NUMBERED = [DATA[:42] + 12 * _BLOCK + struct.pack("<IH", number, 0x2237) for number in range(12)]
"""Frames of twelve data packets that differ in their stamps."""
_RECORD = 16 + len(DATA)


def numbers(datagrams):
    return [int.from_bytes(each.payload[1200:1204], "little") for each in datagrams]


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(
    ("begin", "size", "filler", "left"),
    [
        (24 + 3 * _RECORD + 500, 37, b"", {3}),  # lost within a packet
        (24 + 3 * _RECORD + 4, 37, b"", {3}),  # lost within the header of a record
        (24 + 4 * _RECORD - 10, 20, b"", {3, 4}),  # over the border of two records
        (24 + 3 * _RECORD, 2 * _RECORD + 100, b"", {3, 4, 5}),  # two records and more
        (24 + 3 * _RECORD, 16, bytes(16), {3}),  # a header of zeros
        (24 + 3 * _RECORD, 4 * _RECORD, bytes(4 * _RECORD), {3, 4, 5, 6}),  # blocks that were never written
        (24 + 3 * _RECORD - 100, 4096, bytes(4096), {2, 3, 4, 5, 6}),
        (24 + 12 * _RECORD, 0, bytes(4096), set()),
        (24 + 3 * _RECORD, 0, b"\xa5" * 4096, set()),  # something put between two records
        (24 + 2 * _RECORD, 0, bytes(range(256)) * 5000, set()),  # more than is searched at once
        (24, 16, b"\xff" * 16, {0}),  # the first header
        (24 + 11 * _RECORD, 16, b"\xff" * 16, {11}),  # the last header
    ],
)
def test_a_damaged_record_costs_a_record(tmp_path, order, begin, size, filler, left):
    """All frames but those that lost bytes are read, and the place of the damage is named; the right ones are
    known because the file was whole before."""
    whole = pcap(*NUMBERED, order=order)
    damaged = whole[:begin] + filler + whole[begin + size :]
    datagrams, capture = read(tmp_path, damaged)
    assert numbers(datagrams) == [number for number in range(12) if number not in left]
    assert len(capture.damage) == 1
    assert "damaged and left out" in capture.damage[0]
    assert not capture.cut


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("at", "size", "left"), [(3, 37, {3}), (3, 3000, {3, 4, 5}), (0, 5, {0})])
def test_a_damaged_block_of_pcapng_costs_a_block(tmp_path, order, at, size, left):
    """Blocks with a length that stands before and after them are found again after lost bytes."""
    whole = pcapng(*((0, frame) for frame in NUMBERED), order=order)
    begin = whole.index(NUMBERED[at]) + 100
    datagrams, capture = read(tmp_path, whole[:begin] + whole[begin + size :])
    assert numbers(datagrams) == [number for number in range(12) if number not in left]
    assert len(capture.damage) == 1


def mixed_pcapng(random, order):
    """Write frames of several link types, resolutions of stamps, check sequences and kinds of blocks."""
    content = block(order, 0x0A0D0D0A, struct.pack(f"{order}IHHq", 0x1A2B3C4D, 1, 0, -1))
    for link_type, resolution, check_bytes in (
        (1, 6, 0),
        (1, 9, 0),
        (1, 0x80 | 20, 0),
        (113, 6, 0),
        (1, 6, 4),
    ):
        options = struct.pack(f"{order}HHBxxxHHBxxx", 9, 1, resolution, 13, 1, check_bytes)
        content += block(order, 1, struct.pack(f"{order}HHI", link_type, 0, 0) + options)
    for number in range(300):
        frame = NUMBERED[number % len(NUMBERED)]
        stamp = 1_700_000_000_000_000 + number
        wire_bytes = len(frame) + int(random.choice([0, 0, 4, -6]))
        numbers = random.integers(6), stamp >> 32, stamp & 0xFFFFFFFF, len(frame), wire_bytes
        kind = random.choice([6, 6, 6, 6, 6, 6, 3, 5])
        content += block(order, kind, struct.pack(f"{order}5I", *numbers) + frame)
    return bytearray(content)


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("damaged", range(6))
def test_blocks_of_pcapng_in_runs_are_those_that_are_read_one_by_one(tmp_path, monkeypatch, order, damaged):
    """Mixed frames, some of them damaged, are the same whether a kernel walks over their blocks or Python
    reads each."""
    random = np.random.default_rng(damaged)
    content = mixed_pcapng(random, order)
    for at in random.integers(2000, len(content), damaged).tolist():
        del content[at : at + 40]
    datagrams, capture = read(tmp_path, content, repeats=True)
    monkeypatch.setattr("vlp16emu.extras.captures.containers.packet_runs", lambda *_: iter(()))
    one_by_one, other = read(tmp_path, content, repeats=True)
    assert datagrams == one_by_one
    assert len(datagrams) > 100
    assert (capture.frames, capture.damage, capture.cut) == (other.frames, other.damage, other.cut)


def test_a_clock_that_is_set_is_no_damage(tmp_path):
    """Records years apart, as of a host that gets the time from the network, are all read."""
    early = pcap(*NUMBERED[:4], seconds=12)
    datagrams, capture = read(tmp_path, early + pcap(*NUMBERED[4:])[24:])
    assert numbers(datagrams) == list(range(12))
    assert capture.damage == []


def test_a_damaged_archive_of_zstd_is_one_line(tmp_path):
    """What the library raises for damaged bytes is an error with the name of the file."""
    zstandard = pytest.importorskip("zstandard")
    packed = bytearray(zstandard.compress(pcap(*NUMBERED)))
    packed[9:16] = bytes([255] * 7)
    with pytest.raises(CaptureError, match=r"some\.pcap: "):
        read(tmp_path, bytes(packed))
