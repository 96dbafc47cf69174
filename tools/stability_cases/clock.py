"""Instants at which a count rolls over: hours, days, leap days, GPS weeks, 2038, 2105, the ends of int64."""

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import chdir
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import dpkt
import numpy as np

from stability_cases.case import Row, case, refusal
from vlp16emu import Emulator
from vlp16emu.extras.recorded.files import read_tum
from vlp16emu.packets import STAMP_LEAD_NS, data_fields, decode_position
from vlp16emu.scenario import load
from vlp16emu.types import Packet, PacketKind
from vlp16emu.units import HOUR_NS, S_NS, US_NS

_SPAN_NS = 8_000_000  # of each look: six data packets, and a position packet at least
_PERIOD_NS = 24 * 55_296  # of data packets in single return (63-9243 Rev D, section 8.1)
_BLOCK_NS = 2 * 55_296
_ODD_NS = 10_007 * S_NS + 77  # no multiple of it is near anything round
_CENTURY = 100


def _emulator(start_utc: str) -> Emulator:
    settings = "gps.connected=true", "sensor.start_azimuth_deg=0", f"start_utc={start_utc}"
    return Emulator(load("static_bench", settings))


def _second_of(sentence: bytes) -> datetime:
    """Return the second that an RMC sentence names, in a year of this century."""
    words = sentence.decode("ascii").split(",")
    day, month, year = (int(words[9][n : n + 2]) for n in (0, 2, 4))
    hour, minute, second = (int(words[1][n : n + 2]) for n in (0, 2, 4))
    return datetime(2000 + year, month, day, hour, minute, second, tzinfo=UTC)


def _data_rows(data: Sequence[Packet], start_ns: int) -> Iterator[Row]:
    """Rows of data packets, by whole numbers: at 600 rpm the head turns by 0.36 degrees in 100 us."""
    due_ns = np.array([packet.due_ns for packet in data])
    fields = data_fields(np.frombuffer(b"".join(p.payload for p in data), np.uint8).reshape(len(data), -1))
    fired_ns = due_ns - start_ns - _PERIOD_NS
    yield Row("data: nanoseconds off the period", int((fired_ns % _PERIOD_NS).max()), 0)
    stamp_us = [(due - _PERIOD_NS) % HOUR_NS // US_NS for due in due_ns.tolist()]
    yield Row("data: stamp, us", int(np.abs(fields["timestamp_us"].astype(np.int64) - stamp_us).max()), 0)
    azimuth = (fired_ns[:, None] + _BLOCK_NS * np.arange(12)) * 36 // 100_000 % 36_000
    off = np.abs(fields["blocks"]["azimuth_cdeg"].astype(np.int64) - azimuth).max()
    yield Row("data: azimuth, hundredths of a degree", int(off), 0)


def _position_rows(position: Sequence[Packet], delay_ns: int) -> Iterator[Row]:
    for packet in position:
        reported = decode_position(packet.payload)
        stamp_ns = packet.due_ns - STAMP_LEAD_NS
        off_ns = abs(reported.time_ns - stamp_ns % HOUR_NS // US_NS * US_NS)
        yield Row("position: stamp, ns", off_ns, 0)
        named = datetime.fromtimestamp((stamp_ns - delay_ns) // S_NS, UTC)
        wanted = named.replace(year=2000 + named.year % _CENTURY)
        off_s = abs((_second_of(reported.sentence) - wanted).total_seconds())
        yield Row("position: $GPRMC, s", off_s, 0)


def _looks(start_utc: str, looks_ns: Sequence[int]) -> Iterator[Row]:
    """Rows of short looks into a run, each from a time since its start."""
    emulator = _emulator(start_utc)
    spans_s = [(since_ns / S_NS, (since_ns + _SPAN_NS) / S_NS) for since_ns in looks_ns]
    packets = [packet for span_s in spans_s for packet in emulator.packets(*span_s)]
    scenario = emulator.scenario
    yield from _data_rows([p for p in packets if p.kind is PacketKind.DATA], scenario.start_ns)
    position = [p for p in packets if p.kind is PacketKind.POSITION]
    yield from _position_rows(position, round(scenario.gps.sentence_delay_s * S_NS))


@case("exact integers")
def a_day() -> Iterator[Row]:
    """24 hours from 31 December 2027, looked into where each hour and the year roll over, and in between."""
    start = "2027-12-31T11:59:59.123457Z"
    start_ns = round(datetime.fromisoformat(start).timestamp() * 1e6) * US_NS
    first_ns = -start_ns % HOUR_NS - _SPAN_NS // 2
    hours_ns = [first_ns + hour * HOUR_NS for hour in range(24)]
    yield from _looks(start, sorted([0, *hours_ns, *(n * _ODD_NS for n in range(1, 9))]))


_INSTANTS = (
    "1970-01-01T00:00:00",
    "1999-12-31T23:59:59.999",
    "2000-02-29T23:59:59.999",
    "2028-02-28T23:59:59.999",
    "2028-02-29T23:59:59.999",
    "2038-01-19T03:14:07.999",  # 2^31 s since 1970
    "2038-11-20T23:59:59.999",  # GPS week 3072: ten bits roll over for the third time
    "2069-12-31T23:59:59.999",  # two digits of the year: 69 is 1969 in POSIX
    "2100-02-28T23:59:59.999",  # no leap year
    "2104-02-29T23:59:59.999",
    "2105-12-31T23:59:59.990",  # the last second with which a run may begin
)


@case("exact integers")
def rare_instants() -> Iterator[Row]:
    """The first and last instant of a run, leap days, none in 2100, 2^31 s, a GPS week rollover."""
    for instant in _INSTANTS:
        yield from _looks(f"{instant}Z", [0])
    for late in ("2106-01-01T00:00:00Z", "1969-12-31T23:59:59Z"):
        yield refusal(f"a start at {late}", partial(_emulator, late), "from 1970 to 2105")


@case("exact integers")
def the_seventh_day() -> Iterator[Row]:
    """The latest run of all: seven days in, from the end of 2105 on, a month before 2^32 s."""
    yield from _looks("2105-12-31T23:59:59.990Z", [7 * 86_400 * S_NS - _SPAN_NS])


@case("another program: dpkt reads the capture")
def stamps_of_captures() -> Iterator[Row]:
    """Captures around 2^31 s and a month before 2^32 s; bags, whose seconds have 31 bits."""
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        for name, start in (("2038", "2038-01-19T03:14:07.999Z"), ("2105", "2105-12-31T23:59:59.999Z")):
            emulator = _emulator(start)
            path = Path(f"{name}.pcap")
            emulator.record(path, duration_s=0.02)
            with path.open("rb") as file:
                stamps_us = [round(stamp * 1_000_000) for stamp, _ in dpkt.pcap.Reader(file)]
            due_us = [packet.due_ns // US_NS for packet in emulator.packets(0.0, 0.02)]
            off = max(abs(a - b) for a, b in zip(stamps_us, due_us, strict=True))
            yield Row("pcap: stamp, us", off, 1)
        late = _emulator("2038-01-19T03:14:07.9Z")
        bag = Path("late.mcap")
        yield refusal("a bag over 2^31 s", partial(late.record, bag, duration_s=0.3), "fits no bag")
        yield Row("files left of the refused bag", int(bag.exists()), 0)


@case("refusal; exact integers")
def ends_of_int64() -> Iterator[Row]:
    """Times beyond 9.2e9 s, at which nanoseconds in int64 end, in spans of a run and in stamps of poses."""
    emulator = Emulator("static_bench")
    for span_s in ((9.2e9, 9.2e9 + 0.01), (0.0, 1e10), (1e300, 1.7e308), (-1e300, 0.0), (0.0, 2e6)):
        name = f"a span from {span_s[0]:g} to {span_s[1]:g} s"
        yield refusal(name, partial(emulator.packets, *span_s), "at most")
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        path = Path("poses.tum")
        rest = "0 0 0 0 0 0 1\n"
        for stamp in ("9.2e9", "-9.3e9", "1.78e18", "1e300"):
            path.write_text(f"{stamp} {rest}" * 2, encoding="utf-8")
            yield refusal(f"a pose at {stamp} s", partial(read_tum, path), "expected at most")
        path.write_text(f"4294967295.999999998 {rest}4294967295.999999999 {rest}", encoding="utf-8")
        step_ns = np.diff(read_tum(path).t_ns) - 1
        yield Row("two stamps of 2106, 1 ns apart: their gap, ns", abs(int(step_ns[0])), 0)
