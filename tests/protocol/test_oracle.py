"""The decoder made of the byte tables alone, held against golden packets and against packets/."""

import struct
import tomllib
from pathlib import Path

import numpy as np
import pytest
from kit import real_capture

from vlp16emu.packets.decode import data_fields, decode_data, decode_position, layouts_of

GOLDEN = Path(__file__).parents[2] / "protocol" / "golden"
NAMES = sorted(path.stem for path in GOLDEN.glob("*.hex"))
DATA_NAMES = [name for name in NAMES if not name.startswith(("imu", "pose", "position"))]
POSITION_NAMES = [name for name in NAMES if name.startswith("position")]


def golden(name):
    """Read a golden packet: its bytes and their meaning."""
    payload = bytes.fromhex((GOLDEN / f"{name}.hex").read_text(encoding="ascii"))
    return payload, tomllib.loads((GOLDEN / f"{name}.toml").read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", DATA_NAMES)
def test_golden_data(oracle, models, name):
    """Read by the tables alone, a golden data packet holds what its meaning says, and no other return."""
    payload, meaning = golden(name)
    assert oracle.field("payload", "return_mode", payload) == oracle.code(
        "return_mode", meaning["return_mode"]
    )
    assert oracle.field("payload", "factory", payload) == oracle.code("factory", meaning["model"])
    assert oracle.field("payload", "timestamp", payload) == meaning["wire"]["timestamp_us"]
    packet = models[meaning["model"]]["packet"]
    banks = len(packet["flags"])
    records = oracle.records(payload)
    twins = 2 if meaning["return_mode"] == "dual" else 1
    stated_deg = np.repeat(meaning["wire"]["azimuth_deg"], twins * banks)
    np.testing.assert_allclose([record["azimuth_deg"] for record in records[::32]], stated_deg, atol=1e-9)
    assert all(record["flag"] == packet["flags"][record["bank"]] for record in records)
    found = {
        (pulse["sequence"], pulse["laser"], twin): wire
        for pulse in meaning["pulse"]
        for twin, wire in enumerate(pulse["wire"])
    }
    for record in records:
        key = record["sequence"], record["laser"], record["block"] % twins
        distance_m, reflectivity = found.pop(key, (0.0, 0))
        assert record["distance_m"] == pytest.approx(distance_m, abs=1e-9), key
        assert record["reflectivity"] == reflectivity, key
    assert not found


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
    """Put records in the order of `decode_data`: by pulse, and in a pair the last return first."""
    return sorted(records, key=lambda record: (record["sequence"], record["laser"], record["block"]))


def assert_same(oracle, payloads):
    points = decode_data(np.array([list(payload) for payload in payloads], np.uint8), keep_no_returns=True)
    records = [record for payload in payloads for record in in_order_of_pulses(oracle.records(payload))]
    for column, name in (("time_ns", "time_ns"), ("laser", "laser"), ("reflectivity", "reflectivity")):
        np.testing.assert_array_equal(getattr(points, column), [record[name] for record in records])
    np.testing.assert_allclose(points.distance_m, [record["distance_m"] for record in records], rtol=1e-6)
    np.testing.assert_array_equal(points.is_last, [record["return"] == "last" for record in records])
    beams = layouts_of(data_fields(np.array([list(payloads[0])], np.uint8)))[0].model.beams
    firsts = [
        place
        for place, record in enumerate(records)
        if record["laser"] == 0 and record["sequence"] % beams.per_reading == 0
    ]
    stated_deg = np.array([records[place]["azimuth_deg"] for place in firsts]) + beams.azimuth_offset_deg[0]
    np.testing.assert_allclose(points.azimuth_deg[firsts], stated_deg % 360.0, atol=1e-9)
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
