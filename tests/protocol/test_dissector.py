"""velodyne.lua in tshark: what it shows equals what stands in the bytes, and damage is named."""

import os
import random
import shutil
import struct
import subprocess
from itertools import islice
from pathlib import Path

import dpkt
import pytest
from kit import real_capture

GOLDEN = Path(__file__).parents[2] / "protocol" / "golden"
AZIMUTHS = [35_900 + 40 * i if i < 3 else 40 * i - 100 for i in range(12)]
PAIRED_AZIMUTHS = [100 + 40 * (i // 2) for i in range(12)]
SENTENCE = b"$GPRMC,081802.00,A,3649.7478558,N,00224.4542928,W,0.034,212.5,210116,0.0,E,A*2E\r\n"
PER_RECORD = ("laser", "elevation", "time", "distance", "reflectivity")
FIELDS = ("flag", "azimuth", "return", *PER_RECORD, "timestamp", "return_mode", "factory", "pps", "sentence")

pytestmark = pytest.mark.skipif(shutil.which("tshark") is None, reason="tshark is not installed")


def data_payload(
    seed, mode=0x37, factory=0x22, azimuths=AZIMUTHS, timestamp=1_082_340_595, code=None, flag=0xEEFF
):
    """Build 1206 bytes; one laser in four has no return, and `code` replaces the first distance."""
    draw = random.Random(seed)
    codes = [0 if draw.random() < 0.25 else draw.randint(250, 65_535) for _ in range(384)]
    if code is not None:
        codes[0] = code
    payload = b""
    for block in range(12):
        payload += struct.pack("<HH", flag, azimuths[block])
        for record in range(32):
            payload += struct.pack("<HB", codes[32 * block + record], draw.randint(0, 255))
    return payload + struct.pack("<IBB", timestamp, mode, factory)


def position_payload(sentence=SENTENCE, pps=2, timestamp=1_082_342_001):
    return struct.pack("<198xIB3x306s", timestamp, pps, sentence)


def noise(seed, size):
    return random.Random(seed).randbytes(size)


GOOD = {
    "strongest": data_payload(1),
    "last": data_payload(2, mode=0x38),
    "hi-res": data_payload(3, factory=0x24),
    "dual": data_payload(4, mode=0x39, azimuths=PAIRED_AZIMUTHS, timestamp=3_599_999_999),
    **{
        name: bytes.fromhex((GOLDEN / f"{name}.hex").read_text())
        for name in ("hdl_32e", "vlp_32c", "vls_128", "vls_128_dual")
    },
    "gps": position_payload(),
    "no gps": position_payload(b"", pps=0),
}
BAD = {
    "flag": (data_payload(5, flag=0xDDFF), "Block does not start with FF EE"),
    "azimuth": (data_payload(6, azimuths=[36_000] * 12), "Azimuth is not below 360 degrees"),
    "code 1": (data_payload(7, code=1), "Laser 0: distance code 1, the least is 250"),
    "code 249": (data_payload(8, code=249), "Laser 0: distance code 249, the least is 250"),
    "timestamp": (data_payload(9, timestamp=3_600_000_000), "Time stamp is not below one hour"),
    "mode": (data_payload(10, mode=0x3A), "Unknown return mode"),
    "product": (data_payload(11, factory=0x23), "Unknown product"),
    "pair": (data_payload(12, mode=0x39), "Blocks of a dual pair differ in azimuth"),
    "short": (data_payload(13)[:-1], "Neither a data packet (1206 bytes) nor a position packet (512 bytes)"),
    "long": (
        data_payload(14) + b"\0",
        "Neither a data packet (1206 bytes) nor a position packet (512 bytes)",
    ),
    "one byte": (b"\xff", "Neither a data packet (1206 bytes) nor a position packet (512 bytes)"),
    "pps": (position_payload(pps=4), "Unknown state of the pulse per second"),
    "position time": (position_payload(timestamp=2**32 - 1), "Time stamp is not below one hour"),
    "sentence": (position_payload(SENTENCE[:-2]), "NMEA sentence does not end with CR LF"),
    "endless sentence": (position_payload(b"$" * 306), "NMEA sentence does not end with CR LF"),
    "binary sentence": (position_payload(b"\xff\xfe\x01"), "NMEA sentence does not end with CR LF"),
    "noise": (noise(15, 1206), "Block does not start with FF EE"),
    "position noise": (noise(16, 512), "NMEA sentence does not end with CR LF"),
}
CUT_MESSAGE = "Packet cut short by the capture"


def frame(payload, port):
    udp = dpkt.udp.UDP(sport=port, dport=port, ulen=8 + len(payload), data=payload)
    ip = dpkt.ip.IP(src=bytes([192, 168, 1, 201]), dst=b"\xff" * 4, p=dpkt.ip.IP_PROTO_UDP, data=udp)
    return bytes(dpkt.ethernet.Ethernet(src=b"\x60\x76\x88\0\0\1", dst=b"\xff" * 6, data=ip))


def port_of(payload):
    return 8308 if len(payload) == 512 else 2368


def tshark(folder, protocol, path, *arguments):
    """Run tshark with the dissector and nobody's settings; one list of columns per packet."""
    script = f"lua_script:{protocol / 'velodyne.lua'}"
    done = subprocess.run(
        ["tshark", "-X", script, "-r", str(path), "-T", "fields", "-E", "aggregator=;", *arguments],
        env={**os.environ, "WIRESHARK_CONFIG_DIR": str(folder)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "Lua" not in done.stdout + done.stderr
    return [line.split("\t") for line in done.stdout.splitlines()]


@pytest.fixture(scope="module")
def seen(tmp_path_factory, protocol):
    """Show all packets above to tshark once: fields by name, info column and expert messages."""
    folder = tmp_path_factory.mktemp("dissector")
    payloads = GOOD | {name: payload for name, (payload, _) in BAD.items()}
    with (folder / "made.pcap").open("wb") as file:
        writer = dpkt.pcap.Writer(file, linktype=dpkt.pcap.DLT_EN10MB)
        for payload in payloads.values():
            writer.writepkt(frame(payload, port_of(payload)), ts=0)
        whole = frame(payloads["strongest"], 2368)
        file.write(struct.pack("<IIII", 0, 0, 200, len(whole)) + whole[:200])
        writer.writepkt(frame(b"", 2368), ts=0)
    columns = [argument for name in FIELDS for argument in ("-e", f"velodyne.{name}")]
    rows = tshark(
        folder, protocol, folder / "made.pcap", *columns, "-e", "_ws.col.Info", "-e", "_ws.expert.message"
    )
    names = [*payloads, "cut", "empty"]
    assert len(rows) == len(names)
    return {
        name: dict(zip((*FIELDS, "info", "expert"), row, strict=True))
        for name, row in zip(names, rows, strict=True)
    }


def numbers(text):
    return [float(part) for part in text.split(";")]


@pytest.mark.parametrize("name", [name for name, payload in GOOD.items() if len(payload) == 1206])
def test_records(seen, oracle, name):
    """Laser, elevation, firing time, distance and reflectivity of all records, and flag, azimuth and kind of
    all blocks that are used, are those in the bytes."""
    records, shown = oracle.records(GOOD[name]), seen[name]
    assert numbers(shown["laser"]) == [record["laser"] for record in records]
    assert numbers(shown["elevation"]) == [record["elevation_deg"] for record in records]
    assert numbers(shown["time"]) == [record["time_ns"] / 1000 for record in records]
    assert numbers(shown["distance"]) == pytest.approx(
        [record["distance_m"] for record in records], rel=1e-12
    )
    assert numbers(shown["reflectivity"]) == [record["reflectivity"] for record in records]
    assert shown["flag"] == ";".join(f"{record['flag']:#x}" for record in records[::32])
    assert numbers(shown["azimuth"]) == pytest.approx(
        [record["azimuth_deg"] for record in records[::32]], rel=1e-12
    )
    assert shown["return"].split(";") == [record["return"] for record in records[::32]]


def test_tail(seen):
    """Time stamp and factory bytes are those in the bytes."""
    assert [seen["dual"][name] for name in ("timestamp", "return_mode", "factory")] == [
        "3599999999",
        "0x39",
        "0x22",
    ]
    assert [seen["hi-res"][name] for name in ("return_mode", "factory")] == ["0x37", "0x24"]


def test_info_column(seen):
    """The list of packets shows product, return mode, azimuths and time, or the state of GPS."""
    assert seen["strongest"]["info"] == "VLP-16 strongest az 359.00..3.40 t=1082340595 us"
    assert seen["dual"]["info"] == "VLP-16 dual az 1.00..3.00 t=3599999999 us"
    assert seen["hi-res"]["info"].startswith("Puck Hi-Res strongest")
    assert seen["gps"]["info"] == f"position, PPS locked t=1082342001 us {SENTENCE.decode().strip()}"
    assert seen["no gps"]["info"].strip() == "position, PPS absent t=1082342001 us"


def test_position(seen):
    """State of the pulse per second, time stamp and sentence are those in the bytes."""
    shown = [seen["gps"][name] for name in ("pps", "timestamp", "sentence")]
    assert shown == ["2", "1082342001", SENTENCE.decode().strip()]
    assert [seen["no gps"][name] for name in ("pps", "sentence")] == ["0", ""]


def test_good_packets_raise_no_alarm(seen):
    """A packet without fault carries no expert message."""
    for name in GOOD:
        assert seen[name]["expert"] == "", name


def test_damage_is_named(seen):
    """Every kind of damage is reported by an expert message of its own."""
    for name, (_, message) in BAD.items():
        assert message in seen[name]["expert"].split(";"), name


def test_cut_packets(seen):
    """A packet that the capture has cut short is called so, and an empty one breaks nothing."""
    assert seen["cut"]["expert"] == CUT_MESSAGE
    assert seen["cut"]["laser"] == ""
    assert seen["empty"]["laser"] == ""


def test_ports_are_preferences(tmp_path, protocol):
    """Packets on other ports are dissected once the preferences say so, and no longer on the factory's."""
    with (tmp_path / "ports.pcap").open("wb") as file:
        writer = dpkt.pcap.Writer(file, linktype=dpkt.pcap.DLT_EN10MB)
        for name, port in (("strongest", 2369), ("gps", 8309), ("last", 2368)):
            writer.writepkt(frame(GOOD[name], port), ts=0)
    preferences = ("-o", "velodyne.data_port:2369", "-o", "velodyne.position_port:8309")
    rows = tshark(
        tmp_path, protocol, tmp_path / "ports.pcap", *preferences, "-Y", "velodyne", "-e", "udp.dstport"
    )
    assert rows == [["2369"], ["8309"]]


def test_against_a_real_capture(tmp_path, protocol, oracle):
    """The first 100 packets of a real sensor show the distances in their bytes, and none raises an alarm."""
    path = real_capture("mrpt_vlp16_gps.pcap")
    columns = (
        "-e",
        "velodyne.distance",
        "-e",
        "velodyne.timestamp",
        "-e",
        "velodyne.pps",
        "-e",
        "_ws.expert.message",
    )
    rows = tshark(tmp_path, protocol, path, "-c", "100", *columns)
    with path.open("rb") as file:
        payloads = [real[42:] for _, real in islice(dpkt.pcap.Reader(file), 100)]
    assert len(rows) == len(payloads)
    assert {row[3] for row in rows} == {""}
    assert {row[2] for row, payload in zip(rows, payloads, strict=True) if len(payload) == 512} == {"2"}
    for row, payload in list(zip(rows, payloads, strict=True))[::20]:
        if len(payload) == 1206:
            assert row[1] == str(oracle.field("payload", "timestamp", payload))
            distances_m = [record["distance_m"] for record in oracle.records(payload)]
            assert numbers(row[0]) == pytest.approx(distances_m, rel=1e-12)
