"""The lint names what the events of a scene do to a capture."""

from functools import lru_cache

import pytest

from vlp16emu.emulator import Emulator
from vlp16emu.extras.bench.faults import arriving
from vlp16emu.extras.verify import Rule, verify
from vlp16emu.scenario import load
from vlp16emu.sinks import PcapSink
from vlp16emu.units import seconds_to_ns

TABLES = {
    "schema": 1,
    "seed": 5,
    "duration_s": 1.5,
    "beam": {"model": "none"},
    "motion": {"kind": "static"},
    "world": {"kind": "hall", "length_m": 20.0, "width_m": 16.0, "height_m": 5.0},
}
DARK = {"kind": "setting", "at_s": 0.0, "laser": False}
"""Position packets alone, which cost nothing."""


def emulator(*events, duration_s=1.5, **tables):
    """A sensor on a tripod in a hall."""
    return Emulator(load({**TABLES, "duration_s": duration_s, "events": list(events), **tables}), threads=1)


@lru_cache
def clean():
    """Packets of a run to which nothing happens."""
    return tuple(emulator().packets())


def faulty(*events):
    """Packets of the run to which faults of packets happen."""
    run = emulator(*events)
    spans = 0, seconds_to_ns(1.5)
    return arriving(run.scenario, run.parts.units, lambda *_: iter(clean()), *spans)


@pytest.fixture
def verified(tmp_path):
    """Findings on packets by their rule, all of them, and the whole result."""

    def check(packets):
        with PcapSink(tmp_path / "made.pcap") as sink:
            for packet in packets:
                sink.send(packet)
        result = verify(tmp_path / "made.pcap", limit_per_rule=10**6)
        return {rule: [f.found for f in result.findings if f.rule is rule] for rule in result.counts}, result

    return check


def test_the_run_itself_is_clean(verified):
    """Without events there is nothing to find."""
    assert verified(clean())[0] == {}


def test_drop(verified):
    """Each run of missing packets is one finding, of both kinds."""
    found, result = verified(faulty({"kind": "drop", "at_s": 0.5, "count": 12, "packets": "both"}))
    assert found == {Rule.LOST_PACKETS: ["12 data packets missing before it", "12 position packets missing before it"]}
    assert result.lost_packets == 24


@pytest.mark.parametrize("after_s", [0.0, 0.004])
def test_duplicate(verified, after_s):
    """Every packet that comes twice is named, and nothing else is."""
    event = {"kind": "duplicate", "at_s": 0.2, "share": 0.1, "packets": "both", "after_s": after_s}
    packets = list(faulty(event))
    found, _ = verified(packets)
    assert set(found) == {Rule.DUPLICATE}
    assert len(found[Rule.DUPLICATE]) == len(packets) - len(clean()) > 50
    assert all(text.startswith("packet ") and text.endswith(" again") for text in found[Rule.DUPLICATE])


@pytest.mark.parametrize("by", [1, 2])
def test_reorder(verified, by):
    """Packets behind later ones are named, by how many; none counts as missing."""
    found, result = verified(faulty({"kind": "reorder", "at_s": 0.2, "count": 1, "by": by, "packets": "both"}))
    assert found[Rule.PACKET_ORDER] == [f"a data packet overtaken by {by}", f"a position packet overtaken by {by}"]
    assert set(found) - {Rule.CLOCK_DRIFT} == {Rule.PACKET_ORDER}  # position packets are 7 ms apart
    assert result.lost_packets == 0


def test_delay_of_some(verified):
    """Of packets that are 50 ms late each is named: it is late, and behind those that have overtaken it."""
    packets = list(faulty({"kind": "delay", "at_s": 0.2, "duration_s": 1.2, "share": 0.05, "by_s": 0.05}))
    found, result = verified(packets)
    assert set(found) == {Rule.PACKET_ORDER, Rule.LATENESS}
    late = [text for text in found[Rule.LATENESS] if text == "50.0 ms later than others"]
    assert 30 < len(late) <= len(found[Rule.PACKET_ORDER])
    assert result.lost_packets == 0


def test_delay_of_all(verified):
    """A delay that stays is a jump of the time stamps against those of the capture, in both streams."""
    found, _ = verified(faulty({"kind": "delay", "at_s": 0.5, "packets": "both"}))
    assert set(found) == {Rule.CLOCK_DRIFT}
    assert found[Rule.CLOCK_DRIFT] == ["time stamps -50.0 ms off the capture stamps"] * 2


def test_jitter(verified):
    """Packets that are late by more than 5 ms are named; where most are, time stamps are off as a whole."""
    found, _ = verified(faulty({"kind": "jitter", "at_s": 0.2, "duration_s": 1.0}))
    assert set(found) == {Rule.LATENESS, Rule.CLOCK_DRIFT}
    assert len(found[Rule.LATENESS]) > 300


def test_corrupt(verified):
    """Flipped bits are seen where they break flags, azimuths or time stamps; of 8 bits in 225 packets some do."""
    found, _ = verified(faulty({"kind": "corrupt", "at_s": 0.0, "share": 0.2}))
    assert {Rule.FLAG, Rule.AZIMUTH_STEP} <= set(found)
    assert len(found[Rule.FLAG]) > 10


def test_truncate(verified):
    """Every cut payload is named with its length."""
    event = {"kind": "truncate", "at_s": 0.2, "share": 0.1, "to_bytes": 300, "packets": "both"}
    packets = list(faulty(event))
    found, _ = verified(packets)
    cut = [packet for packet in packets if len(packet.payload) == 300]
    assert set(found) <= {Rule.FRAMING, Rule.LOST_PACKETS}  # a position packet that cannot be read is missing
    assert found[Rule.FRAMING] == [f"a {packet.kind} payload of 300 bytes" for packet in cut]


def test_freeze(verified):
    """A payload that comes again and again is named, and the time that it took is missing afterwards."""
    found, _ = verified(faulty({"kind": "freeze", "at_s": 0.5, "duration_s": 0.3, "packets": "both"}))
    assert set(found) == {Rule.FROZEN, Rule.DUPLICATE, Rule.LOST_PACKETS}
    assert len(found[Rule.FROZEN]) > 250
    assert all("again and again" in text for text in found[Rule.FROZEN])
    assert len(found[Rule.DUPLICATE]) == 1


GPS = {
    "pps_loss": (Rule.PPS, "state 0, absent, from here on"),
    "wrong_sentence": (Rule.NMEA_FORMAT, "$GPRMC,"),
    "late_sentence": (Rule.NMEA_TIME, "0.85 s after its second"),
    "missing_sentence": (Rule.NMEA_SECOND, "no sentence after that of "),
}


@pytest.mark.parametrize("kind", GPS)
def test_gps(verified, kind):
    """Each fault of the receiver's line is named by its rule, beside the state of the pulse."""
    rule, words = GPS[kind]
    run = emulator(DARK, {"kind": kind, "at_s": 3.0, "duration_s": 3.0}, duration_s=12.0)
    found, _ = verified(run.packets())
    assert words in found[rule][0]
    states = {Rule.PPS} if kind in ("pps_loss", "wrong_sentence") else set()
    assert {rule} | states == set(found) - {Rule.NMEA_CHECKSUM}  # that alone, where what is garbled is a digit


def test_void_sentences(verified):
    """Sentences of status V are counted, which trees cause as well; where the sensor needs valid ones it falls out of lock."""
    event, gps = {"kind": "void_sentence", "at_s": 3.0, "duration_s": 3.0}, {"canopy_loss": False}
    run = emulator(DARK, event, duration_s=8.0, gps=gps)
    found, result = verified(run.packets())
    assert (found, result.void_sentences) == ({}, 3)
    run = emulator(DARK, event, duration_s=8.0, gps={**gps, "requires_valid": True})
    found, _ = verified(run.packets())
    assert found == {Rule.PPS: ["state 1, synchronizing, from here on"]}


def test_power_cycle(verified):
    """Silence of both streams is named with its length; then the sensor is not locked, and its clock begins anew."""
    run = emulator(DARK, {"kind": "power_cycle", "at_s": 2.0, "off_s": 3.0}, duration_s=7.0)
    packets = [packet for packet in run.packets() if packet.kind == "position"]
    found, _ = verified(packets)
    assert [text[:-10] for text in found[Rule.SILENCE]] in (["no packet for 3.00 s"], ["no packet for 3.01 s"])
    assert found[Rule.PPS] == ["state 1, synchronizing, from here on"]
    assert len(found[Rule.CLOCK_DRIFT]) == 1


def test_oscillator(verified):
    """Without GPS a step of the clock is named by its size, and a drift by what it comes to against the capture."""
    free = {"gps": {"connected": False}}
    step = {"kind": "oscillator", "at_s": 0.5, "offset_us": 500.0}
    found, _ = verified(emulator(step, duration_s=1.0, **free).packets())
    assert found == {Rule.TIME_STEP: ["time stamp +1827 us"]}
    drift = {"kind": "oscillator", "at_s": 0.5, "drift_ppm": 1000.0}
    found, _ = verified(emulator(DARK, drift, duration_s=20.0, **free).packets())
    assert set(found) == {Rule.CLOCK_DRIFT}


def test_rotor(verified):
    """A speed that is not held is named revolution by revolution, and so is a rotor that stands."""
    wobble = {"kind": "rpm_wobble", "at_s": 0.2, "duration_s": 1.3, "amplitude_rpm": 8.0}
    stop = {"kind": "motor_stop", "at_s": 1.6}
    found, _ = verified(emulator(wobble, stop, duration_s=4.4).packets())
    assert any("at 60" in text for text in found[Rule.SPEED])
    assert any("azimuth frozen at" in text for text in found[Rule.AZIMUTH_STEP])
    assert Rule.SINGLE_AS_DUAL not in found or len(found[Rule.SINGLE_AS_DUAL]) < 100  # while it runs down


def test_optics(verified):
    """A laser without returns among others is named, and a sector that turns dark, once each."""
    dead = {"kind": "dead_laser", "at_s": 0.8, "laser": 7}
    dirty = {"kind": "dirty_window", "at_s": 0.9, "sector_deg": [90, 150], "transmission": 0.2}
    found, _ = verified(emulator(dead, dirty, duration_s=3.2).packets())
    assert set(found) == {Rule.LASER, Rule.WINDOW}
    assert found[Rule.LASER] == ["laser 7 without returns"]
    assert any("from 90 to 150 deg" in text for text in found[Rule.WINDOW])
