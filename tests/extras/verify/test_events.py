"""The lint names what the events of a scene do to a capture."""

from functools import lru_cache

import pytest

from vlp16emu import Emulator
from vlp16emu.extras.bench.faults import arriving_packets
from vlp16emu.extras.verify.frames import Rule
from vlp16emu.extras.verify.run import verify
from vlp16emu.scenario import load
from vlp16emu.sinks import PcapSink
from vlp16emu.units import S_NS, seconds_to_ns

TABLES = {
    "schema": 1,
    "seed": 5,
    "beam": {"model": "none"},
    "motion": {"kind": "static"},
    "world": {"kind": "hall", "length_m": 20.0, "width_m": 16.0, "height_m": 5.0},
}
DARK = {"kind": "setting", "at_s": 0.0, "laser": False}  # position packets alone, which cost nothing


def emulator(*events, duration_s=1.5, **tables):
    return Emulator(load({**TABLES, "duration_s": duration_s, "events": list(events), **tables}), threads=1)


@lru_cache
def clean():
    return tuple(emulator().packets())


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


def event(kind, at_s=0.2, **fields):
    return {"kind": kind, "at_s": at_s, **fields}


BOTH = {"packets": "both"}
FAULTS = {
    "nothing": ([], {}),
    "drop": (
        [event("drop", 0.5, count=12, **BOTH)],
        {Rule.LOST_PACKETS: (2, "12 position packets missing before it")},
    ),
    "duplicate": ([event("duplicate", share=0.1, after_s=0.0, **BOTH)], {Rule.DUPLICATE: (50, " again")}),
    "late duplicate": (
        [event("duplicate", share=0.1, after_s=0.004, **BOTH)],
        {Rule.DUPLICATE: (50, " again")},
    ),
    "reorder": (
        [event("reorder", count=1, by=1, **BOTH)],
        {Rule.PACKET_ORDER: (2, "a data packet overtaken by 1")},
    ),
    "reorder by two": (
        [event("reorder", count=1, by=2, **BOTH)],
        {Rule.PACKET_ORDER: (2, "a position packet overtaken by 2")},
    ),
    "delay of some": (
        [event("delay", duration_s=1.2, share=0.05, by_s=0.05)],
        {Rule.PACKET_ORDER: (30, "overtaken by"), Rule.LATENESS: (30, "50.0 ms later than others")},
    ),
    "delay of all": (
        [event("delay", 0.5, **BOTH)],
        {Rule.CLOCK_DRIFT: (2, "time stamps -50.0 ms off the capture stamps")},
    ),
    "jitter": (
        [event("jitter", duration_s=1.0)],
        {Rule.LATENESS: (300, "ms later than others"), Rule.CLOCK_DRIFT: (1, "ms off the capture stamps")},
    ),
    "truncate": (
        [
            event("truncate", share=0.1, to_bytes=300, **BOTH)
        ],  # a position packet that cannot be read is missing
        {
            Rule.FRAMING: (50, "a data payload of 300 bytes"),
            Rule.LOST_PACKETS: (1, "position packets missing"),
        },
    ),
    "freeze": (
        [event("freeze", 0.5, duration_s=0.3, **BOTH)],
        {
            Rule.FROZEN: (250, "again and again"),
            Rule.DUPLICATE: (1, "again"),
            Rule.LOST_PACKETS: (1, "missing before it"),
        },
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_faults_of_packets_are_named(verified, name):
    """Each fault breaks its rules and no others, at least so often, and one of the findings says what
    happened."""
    events, rules = FAULTS[name]
    run = emulator(*events)
    packets = list(
        arriving_packets(run.scenario, run.parts.units, lambda *_: iter(clean()), 0, seconds_to_ns(1.5))
    )
    found, result = verified(packets)
    moved = {Rule.CLOCK_DRIFT} if name.startswith("reorder") else set()  # position packets are 7 ms apart
    assert set(found) - moved == set(rules)
    for rule, (least, words) in rules.items():
        assert len(found[rule]) >= least
        assert any(words in text for text in found[rule])
    assert (result.lost_packets == 0) == (Rule.LOST_PACKETS not in rules)
    if name == "late duplicate":
        assert len(found[Rule.DUPLICATE]) == len(packets) - len(clean())
    if name == "truncate":
        cut = [packet for packet in packets if len(packet.payload) == 300]
        assert found[Rule.FRAMING] == [f"a {packet.kind} payload of 300 bytes" for packet in cut]


def test_corrupt(verified):
    """Flipped bits are seen where they break flags, azimuths or time stamps; of 8 bits in 225 packets some
    do."""
    run = emulator(event("corrupt", 0.0, share=0.2))
    packets = arriving_packets(run.scenario, run.parts.units, lambda *_: iter(clean()), 0, seconds_to_ns(1.5))
    found, _ = verified(packets)
    assert {Rule.FLAG, Rule.AZIMUTH_STEP} <= set(found)
    assert len(found[Rule.FLAG]) > 10


FREE = {"gps": {"connected": False}}
LOST_LOCK = "state 1, synchronizing, from here on"
RUNS = {
    "pps_loss": (
        [DARK, event("pps_loss", 3.0, duration_s=3.0)],
        12.0,
        {},
        {Rule.PPS: "state 0, absent, from here on"},
    ),
    "late_sentence": (
        [DARK, event("late_sentence", 3.0, duration_s=3.0)],
        12.0,
        {},
        {Rule.NMEA_TIME: "0.85 s after its second"},
    ),
    "missing_sentence": (
        [DARK, event("missing_sentence", 3.0, duration_s=3.0)],
        12.0,
        {},
        {Rule.NMEA_SECOND: "no sentence after second "},
    ),
    "void sentence": (
        [DARK, event("void_sentence", 3.0, duration_s=3.0)],
        8.0,
        {"gps": {"canopy_loss": False}},
        {},
    ),
    "void sentence without lock": (
        [DARK, event("void_sentence", 3.0, duration_s=3.0)],
        8.0,
        {"gps": {"canopy_loss": False, "requires_valid": True}},
        {Rule.PPS: LOST_LOCK},
    ),
    "power cycle": (
        [DARK, event("power_cycle", 2.0, off_s=3.0)],
        7.0,
        {},
        {
            Rule.SILENCE: "no packet for 3.0",
            Rule.PPS: LOST_LOCK,
            Rule.CLOCK_DRIFT: "off the capture stamps",
            Rule.TIME_STEP: " us",
        },
    ),
    "each packet twice": (
        [DARK, event("duplicate", 0.0, packets="position")],
        4.0,
        {},
        {Rule.DUPLICATE: " again"},
    ),
    "step of the clock": (
        [event("oscillator", 0.5, offset_us=500.0)],
        1.0,
        FREE,
        {Rule.TIME_STEP: "time stamp +1827 us"},
    ),
    "drift of the clock": (
        [DARK, event("oscillator", 0.5, drift_ppm=1000.0)],
        20.0,
        FREE,
        {Rule.CLOCK_DRIFT: "ms off"},
    ),
    "optics": (
        [
            event("dead_laser", 0.8, laser=7),
            event("dirty_window", 0.9, sector_deg=[90, 150], transmission=0.2),
        ],
        3.2,
        {},
        {Rule.LASER: "laser 7 without returns", Rule.WINDOW: "from 90 to 150 deg"},
    ),
}


@pytest.mark.parametrize("name", RUNS)
def test_what_happens_to_a_sensor_is_named(verified, name):
    """Each event breaks its rules and no others; sentences of status V, which trees cause too, are counted
    and break none."""
    events, duration_s, tables, rules = RUNS[name]
    run = emulator(*events, duration_s=duration_s, **tables)
    found, result = verified(run.packets())
    data = (
        {Rule.LOST_PACKETS, Rule.HEADER} if name == "power cycle" else set()
    )  # the count of packets begins anew
    assert set(found) - data == set(rules)
    assert all(any(words in text for text in found[rule]) for rule, words in rules.items())
    assert result.void_sentences == 3 or not name.startswith("void")
    if name == "power cycle":
        # Its clock begins at 0 whole seconds after the start; the next pulse resets its sub-seconds (63-9243,
        # app. G).
        step_us, since_second_us = (
            int(found[Rule.TIME_STEP][0].split()[2]),
            run.scenario.start_ns % S_NS / 1000,
        )
        assert (step_us - since_second_us) % 10**6 == pytest.approx(
            1327.1, abs=1.5
        )  # packets are so far apart


def test_garbled_sentences(verified):
    """A wrong sentence is named by its rule beside the pulse; its checksum alone, where what is garbled is
    a digit."""
    events = DARK, event("wrong_sentence", 3.0, duration_s=3.0)
    found, _ = verified(emulator(*events, duration_s=12.0).packets())
    assert set(found) - {Rule.NMEA_CHECKSUM} == {Rule.NMEA_FORMAT, Rule.PPS}
    assert "$GPRMC," in found[Rule.NMEA_FORMAT][0]


def test_rotor(verified):
    """A speed that is not held is named revolution by revolution, and so is a rotor that stands."""
    wobble, stop = event("rpm_wobble", duration_s=1.3, amplitude_rpm=8.0), event("motor_stop", 1.6)
    found, _ = verified(emulator(wobble, stop, duration_s=4.4).packets())
    assert any("at 60" in text for text in found[Rule.SPEED])
    assert any("azimuth frozen at" in text for text in found[Rule.AZIMUTH_STEP])
    assert Rule.SINGLE_AS_DUAL not in found or len(found[Rule.SINGLE_AS_DUAL]) < 100  # while it runs down
