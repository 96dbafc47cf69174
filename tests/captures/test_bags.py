"""Bags with the packets of the driver as captures, against rosbags."""

from pathlib import Path

import pytest

from vlp16emu import Emulator
from vlp16emu.captures.capture import Capture
from vlp16emu.errors import CaptureError
from vlp16emu.extras.bag.write import write_bag
from vlp16emu.extras.replay import write_pcap

rosbags = pytest.importorskip("rosbags.highlevel")
CASE = Path(__file__).resolve().parents[1] / "cases" / "b07-packets-only.bag"
S_NS = 1_000_000_000


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """Ten turns of the hall."""
    path = tmp_path_factory.mktemp("bags") / "bench.pcap"
    Emulator("static_bench", {"sensor.rpm": 1200}).record(path, duration_s=0.5)
    return path


def by_rosbags(path):
    """Stamps and payloads of packets, as rosbags reads them."""
    with rosbags.AnyReader([path]) as reader:
        own = [each for each in reader.connections if each.topic.endswith("velodyne_packets")]
        scans = [reader.deserialize(raw, each.msgtype) for each, _, raw in reader.messages(own)]
    packets = [packet for scan in scans for packet in scan.packets]
    return [(p.stamp.sec * S_NS + p.stamp.nanosec, bytes(p.data)) for p in packets]


def by_us(path):
    return [(each.stamp_ns, each.payload) for each in Capture(path, repeats=True)]


@pytest.mark.parametrize("name", ["o.bag", "o.mcap", "folder"])
def test_packets_of_our_bags_are_read_as_rosbags_reads_them(bench, tmp_path, name):
    """ROS 1, MCAP, and a folder with SQLite give the payloads and stamps of all packets."""
    path = tmp_path / name
    write_bag(bench, path)
    found = by_us(path)
    assert found == by_rosbags(path)
    assert len(found) > 100


def test_a_bag_of_another_writer_is_read_as_rosbags_reads_it():
    """A bag that holds nothing but packets has those that rosbags finds."""
    assert by_us(CASE) == by_rosbags(CASE)


@pytest.mark.parametrize("compression", ["BZ2", "LZ4"])
def test_packed_chunks_are_read(bench, tmp_path, compression):
    """Chunks as `rosbag compress` and `rosbag record --lz4` pack them hold the same packets."""
    from rosbags.rosbag1 import Writer

    path = tmp_path / "packed.bag"
    writer = Writer(path)
    writer.set_compression(Writer.CompressionFormat[compression])
    with rosbags.AnyReader([CASE]) as reader, writer:
        (known,) = reader.connections
        to = writer.add_connection(known.topic, known.msgtype, msgdef=known.msgdef.data, md5sum=known.digest)
        for _, t_ns, raw in reader.messages():
            writer.write(to, t_ns, raw)
    assert by_us(path) == by_us(CASE)


@pytest.mark.parametrize("name", ["o.bag", "o.mcap"])
def test_a_bag_without_an_index_is_read_as_far_as_it_goes(bench, tmp_path, name):
    """A bag of a recorder that was killed has the messages before the cut, and is called cut."""
    path = tmp_path / name
    write_bag(bench, path)
    content = path.read_bytes()
    whole = by_us(path)
    cut = tmp_path / f"cut_{name}"
    end = content.rindex(whole[-1][1]) + 1206 + 3  # in the last packet's message, before any index
    cut.write_bytes(content[:end])
    capture = Capture(cut)
    found = [(each.stamp_ns, each.payload) for each in capture]
    assert found == whole[: len(found)]
    assert capture.cut


def test_packed_chunks_of_mcap_are_read(bench, tmp_path):
    """Chunks that are packed by zstd, as `ros2 bag record` does, hold the same packets."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    path = tmp_path / "packed"
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    write_bag(bench, tmp_path / "o.mcap")
    with rosbags.AnyReader([tmp_path / "o.mcap"]) as reader, writer:
        known = next(each for each in reader.connections if each.topic == "/velodyne_packets")
        to = writer.add_connection(known.topic, known.msgtype, typestore=reader.typestore)
        for _, t_ns, raw in reader.messages([known]):
            writer.write(to, t_ns, raw)
    (inside,) = path.glob("*.mcap")
    assert b"\x04\0\0\0zstd" in inside.read_bytes()  # of a chunk, by MCAP's specification
    assert by_us(path) == by_us(tmp_path / "o.mcap")


def test_a_pcap_of_a_bag_has_its_packets(tmp_path):
    """Payloads are unchanged and in order, and stamps are theirs to the microsecond."""
    from threading import Event

    out = tmp_path / "o.pcap"
    written = write_pcap(CASE, out, stop=Event())
    bag, pcap = by_us(CASE), by_us(out)
    assert [payload for _, payload in pcap] == [payload for _, payload in bag]
    assert [t_ns for t_ns, _ in pcap] == [t_ns // 1000 * 1000 for t_ns, _ in bag]
    assert written["packets"] == len(bag)


def test_a_bag_without_packets_says_so(bench, tmp_path):
    """A bag of other messages names what a capture needs."""
    from rosbags.rosbag1 import Writer

    path = tmp_path / "none.bag"
    with Writer(path):
        pass
    with pytest.raises(CaptureError, match="a bag without packets; expected messages of velodyne_msgs"):
        list(Capture(path))


def lost(content, at, header):
    """Without 37 bytes in a packet."""
    return content[: at + 500] + content[at + 537 :]


def overwritten(content, at, header):
    """With 37 other bytes in the header of a record before a packet."""
    begin = content.rindex(header, 0, at) - 40
    return content[:begin] + bytes(range(200, 237)) + content[begin + 37 :]


@pytest.mark.parametrize(("name", "header"), [("o.bag", b"op="), ("o.mcap", b"velodyne")])
@pytest.mark.parametrize("damaged", [lost, overwritten])
def test_a_damaged_record_of_a_bag_costs_its_message(bench, tmp_path, name, header, damaged):
    """Packets of all other messages are those that rosbags finds in the bag before; the place is reported
    once by a warning."""
    whole_path = tmp_path / f"whole_{name}"
    write_bag(bench, whole_path)
    whole = by_rosbags(whole_path)
    content = whole_path.read_bytes()
    path = tmp_path / name
    path.write_bytes(damaged(content, content.index(whole[50][1]), header))
    capture = Capture(path)
    found = [(each.stamp_ns, each.payload) for each in capture]
    per_message = 38  # at 1200 rpm, a turn of 0.05 s of 1.327 ms per packet
    assert found == [each for each in whole if each in found]
    assert len(whole) - 2 * per_message <= len(found) < len(whole)
    assert found[-1] == whole[-1]
    assert capture.damage
    assert not capture.cut


def test_a_packed_chunk_that_is_damaged_costs_the_chunk(bench, tmp_path):
    """Without the chunk's bytes the rest of the bag is read."""
    from rosbags.rosbag1 import Writer

    path = tmp_path / "packed.bag"
    writer = Writer(path)
    writer.set_compression(Writer.CompressionFormat.LZ4)
    writer.chunk_threshold = 1 << 14
    write_bag(bench, tmp_path / "o.bag")
    with rosbags.AnyReader([tmp_path / "o.bag"]) as reader, writer:
        known = next(each for each in reader.connections if each.topic == "/velodyne_packets")
        to = writer.add_connection(known.topic, known.msgtype, msgdef=known.msgdef.data, md5sum=known.digest)
        for _, t_ns, raw in reader.messages([known]):
            writer.write(to, t_ns, raw)
    whole = by_us(path)
    content = bytearray(path.read_bytes())
    second = content.index(b"\x04\x22\x4d\x18", content.index(b"\x04\x22\x4d\x18") + 4)
    content[second : second + 64] = bytes(64)
    path.write_bytes(content)
    capture = Capture(path)
    found = [(each.stamp_ns, each.payload) for each in capture]
    assert 0 < len(found) < len(whole)
    assert found == [each for each in whole if each in found]
    assert len(capture.damage) == 1
