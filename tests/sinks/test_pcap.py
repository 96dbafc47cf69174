"""The capture file."""

import hashlib
import os
import resource
import signal
import subprocess
import sys
import threading

import pytest
from sinks.kit import make_packets

from vlp16emu.captures.capture import Capture
from vlp16emu.errors import OutputError, RunError
from vlp16emu.packets.frames import FACTORY_LINK, data_header, position_frame
from vlp16emu.sinks import PcapSink
from vlp16emu.types import Packet, PacketKind

RECORD_BYTES = 16 + 42 + 1206


def read(path):
    """Read datagrams and whether the file is cut."""
    capture = Capture(path)
    return list(capture), capture.cut


def test_file_holds_the_frames_in_sending_order(tmp_path):
    """Each packet is one record with its frame and its due time cut to microseconds."""
    packets = make_packets(20)
    with PcapSink(tmp_path / "out.pcap") as sink:
        for packet in packets:
            sink.send(packet)
    content = (tmp_path / "out.pcap").read_bytes()
    assert content[:24] == bytes.fromhex("d4c3b2a1 0200 0400 00000000 00000000 ffff0000 01000000")
    at, number = 24, 0
    for packet in packets:
        if packet.kind is PacketKind.DATA:
            frame = data_header(FACTORY_LINK) + packet.payload
        else:
            frame = position_frame(FACTORY_LINK, packet.payload, number)
            number += 1
        words = [int.from_bytes(content[at + i : at + i + 4], "little") for i in range(0, 16, 4)]
        assert words[0] * 1_000_000 + words[1] == packet.due_ns // 1000
        assert words[2:] == [len(frame)] * 2
        assert content[at + 16 : at + 16 + len(frame)] == frame
        at += 16 + len(frame)
    assert at == len(content)


def test_result_has_size_and_hash_of_the_file(tmp_path):
    """They are those of the file, also when read after closing; two pieces hold the records of one file,
    whose identifications count on over 65535."""
    path = tmp_path / "out.pcap"
    with PcapSink(path) as sink:
        for packet in make_packets(10):
            sink.send(packet)
    assert sink.result.bytes == path.stat().st_size
    assert sink.result.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    packets = make_packets(30, first_number=65_535)
    for name, piece in (("all", packets), ("a", packets[:15]), ("b", packets[15:])):
        with PcapSink(tmp_path / name) as sink:
            for packet in piece:
                sink.send(packet)
    whole, a, b = ((tmp_path / name).read_bytes() for name in ("all", "a", "b"))
    assert whole == a + b[24:]


def test_pipe_is_written_like_a_file(tmp_path):
    """A named pipe receives the bytes whose hash is in the result."""
    path = tmp_path / "pipe"
    os.mkfifo(path)
    received = []
    reader = threading.Thread(target=lambda: received.append(path.read_bytes()))
    reader.start()
    with PcapSink(path) as sink:
        for packet in make_packets(200):
            sink.send(packet)
    reader.join()
    assert hashlib.sha256(received[0]).hexdigest() == sink.result.sha256


KILLED = """
import itertools, sys
from pathlib import Path
from vlp16emu.sinks import PcapSink
from vlp16emu.types import Packet, PacketKind

sink = PcapSink(Path(sys.argv[1]))
for i in itertools.count():
    sink.send(Packet(PacketKind.DATA, i * 1_327_104, (i % 65536).to_bytes(2) * 603))
    if i == 999:
        print("sent", flush=True)
"""


def test_killed_program_leaves_all_packets_it_had_sent(tmp_path):
    """After SIGKILL in the middle of writing, every packet sent before is whole and in order in the file."""
    path = tmp_path / "out.pcap"
    with subprocess.Popen([sys.executable, "-c", KILLED, path], stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"sent\n"
        process.send_signal(signal.SIGKILL)
    assert process.returncode == -signal.SIGKILL
    assert not path.exists()
    (part,) = tmp_path.glob("out.pcap.*.part")
    datagrams, _ = read(part)
    assert len(datagrams) >= 1000
    assert all(d.payload == (i % 65_536).to_bytes(2) * 603 for i, d in enumerate(datagrams))


def test_an_interrupt_ends_a_valid_capture(tmp_path):
    """Ctrl-C that arrives as an exception keeps the packets before it, NMEA is a programming error, and
    nothing is left of a longer earlier file."""
    with pytest.raises(KeyboardInterrupt), PcapSink(tmp_path / "out.pcap") as sink:  # noqa: PT012
        sink.send(make_packets(1)[0])
        raise KeyboardInterrupt
    assert len(read(tmp_path / "out.pcap")[0]) == 1
    with PcapSink(tmp_path / "out.pcap") as sink, pytest.raises(ValueError, match="nmea"):
        sink.send(Packet(PacketKind.NMEA, 0, b"$GPRMC"))
    path = tmp_path / "out.pcap"
    path.write_bytes(bytes(100_000))
    with PcapSink(path):
        pass
    assert read(path) == ([], False)


def test_full_disk_keeps_whole_packets_and_says_how_many(tmp_path):
    """If only part of a record has room, the error names the file that ends with the packet before it; the
    earlier stays."""
    path = tmp_path / "out.pcap"
    path.write_bytes(b"earlier")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (24 + 10 * RECORD_BYTES + 700, before[1]))
    try:
        with PcapSink(path) as sink, pytest.raises(RunError) as caught:  # noqa: PT012
            for i in range(100):
                sink.send(Packet(PacketKind.DATA, i, bytes(1206)))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    (part,) = tmp_path.glob("out.pcap.*.part")
    assert str(caught.value) == f"{path}: File too large at packet 11; the 10 packets before it are in {part}"
    assert sink.result.sha256 == hashlib.sha256(part.read_bytes()).hexdigest()
    assert path.read_bytes() == b"earlier"
    datagrams, cut = read(part)
    assert (len(datagrams), cut) == (10, False)


@pytest.mark.parametrize("where", ["", "missing/out.pcap"])
def test_path_that_cannot_be_opened_is_bad_input(tmp_path, where):
    """A folder, or a file in a folder that is not there, is refused when the sink is made, with exit code
    2."""
    with pytest.raises(OutputError, match=r"directory; expected a file that can be written") as caught:
        PcapSink(tmp_path / where)
    assert caught.value.exit_code == 2
