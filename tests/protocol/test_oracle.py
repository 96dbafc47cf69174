"""The decoder made of the byte tables alone, held against golden packets and against packets/."""

import struct
import tomllib
from pathlib import Path

import numpy as np
import pytest
from kit import real_capture

from vlp16emu.packets.decode import decode_data, decode_position

GOLDEN = Path(__file__).parents[2] / "protocol" / "golden"
NAMES = sorted(path.stem for path in GOLDEN.glob("*.hex"))
DATA_NAMES = [name for name in NAMES if not name.startswith(("imu", "pose", "position"))]
POSITION_NAMES = [name for name in NAMES if name.startswith("position")]


def golden(name):
    """Read a golden packet: its bytes and their meaning."""
    payload = bytes.fromhex((GOLDEN / f"{name}.hex").read_text(encoding="ascii"))
    return payload, tomllib.loads((GOLDEN / f"{name}.toml").read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", DATA_NAMES)
def test_golden_data(oracle, name):
    """Read by the tables alone, a golden data packet holds what its meaning says, and no other return."""
    payload, meaning = golden(name)
    assert oracle.field("payload", "return_mode", payload) == oracle.code(
        "return_mode", meaning["return_mode"]
    )
    assert oracle.field("payload", "factory", payload) == oracle.code("factory", meaning["model"])
    assert oracle.field("payload", "timestamp", payload) == meaning["wire"]["timestamp_us"]
    records = oracle.records(payload)
    twins = 2 if meaning["return_mode"] == "dual" else 1
    stated_deg = np.repeat(meaning["wire"]["azimuth_deg"], twins)
    np.testing.assert_allclose([record["azimuth_deg"] for record in records[::32]], stated_deg, atol=1e-9)
    found = {
        (twins * (pulse["sequence"] // 2) + twin, pulse["sequence"] % 2, pulse["laser"]): wire
        for pulse in meaning["pulse"]
        for twin, wire in enumerate(pulse["wire"])
    }
    for i, record in enumerate(records):
        key = record["block"], i % 32 // 16, record["laser"]
        distance_m, reflectivity = found.get(key, (0.0, 0))
        assert record["distance_m"] == pytest.approx(distance_m, abs=1e-9), key
        assert record["reflectivity"] == reflectivity, key


@pytest.mark.parametrize("name", POSITION_NAMES)
def test_golden_position(position_packet, name):
    """Read by the table alone, a golden position packet holds what its meaning says, and zeros elsewhere."""
    payload, meaning = golden(name)
    rows = {row["name"]: row for row in position_packet["payload"]}
    (timestamp_us,) = struct.unpack_from("<I", payload, rows["timestamp"]["offset"])
    assert timestamp_us == meaning["wire"]["timestamp_us"]
    pps = payload[rows["pps"]["offset"]]
    assert pps == rows["pps"]["values"][meaning["pps"]]
    start = rows["sentence"]["offset"]
    sentence = meaning["wire"]["sentence"].encode("ascii")
    assert payload[start:] == sentence.ljust(position_packet["size_bytes"] - start, b"\0")
    assert not any(payload[: rows["timestamp"]["offset"]])
    fields = decode_position(payload)
    assert (fields.time_ns, fields.pps, fields.sentence) == (timestamp_us * 1000, pps, sentence)


def in_order_of_pulses(records):
    """Put the records of a dual pair side by side, as `decode_data` gives them."""
    dual = records[32]["time_ns"] == records[0]["time_ns"]
    if not dual:
        return records
    pairs = [records[first : first + 64] for first in range(0, 384, 64)]
    return [record for pair in pairs for twins in zip(pair[:32], pair[32:], strict=True) for record in twins]


def assert_same(oracle, payloads):
    points = decode_data(np.array([list(payload) for payload in payloads], np.uint8), keep_no_returns=True)
    records = [record for payload in payloads for record in in_order_of_pulses(oracle.records(payload))]
    for column, name in (("time_ns", "time_ns"), ("laser", "laser"), ("reflectivity", "reflectivity")):
        np.testing.assert_array_equal(getattr(points, column), [record[name] for record in records])
    np.testing.assert_allclose(points.distance_m, [record["distance_m"] for record in records], rtol=1e-6)
    np.testing.assert_array_equal(points.is_last, [record["return"] == "last" for record in records])
    twins = 2 if records[0]["time_ns"] == records[1]["time_ns"] else 1
    firsts = np.flatnonzero(points.laser == 0).reshape(-1, 2, twins)[:, 0]  # of a block's first sequence
    stated_deg = [[records[i]["azimuth_deg"] for i in pulse] for pulse in firsts]
    np.testing.assert_allclose(points.azimuth_deg[firsts], stated_deg, atol=1e-9)
    elevation_rad = np.radians([record["elevation_deg"] for record in records])
    hit = points.distance_m > 0
    across_m = np.hypot(points.xyz_m[:, 0], points.xyz_m[:, 1])[hit]
    np.testing.assert_allclose(across_m, (points.distance_m * np.cos(elevation_rad))[hit], rtol=1e-5)


@pytest.mark.parametrize("name", DATA_NAMES)
def test_two_decoders_agree_on_golden_packets(oracle, name):
    """packets/ and the byte tables give the same times, lasers, azimuths, distances and kinds of return."""
    assert_same(oracle, [golden(name)[0]])


def test_two_decoders_agree_on_a_real_sensor(oracle):
    """They agree on dual-return packets of a real sensor as well."""
    raw = real_capture("nebula_vlp16_dual.bin").read_bytes()
    assert_same(oracle, [raw[start : start + 1206] for start in range(0, 12 * 1206, 1206)])
