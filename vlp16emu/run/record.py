"""Recording of a run into a capture file or a bag, stamped by the clock of the recording host."""

import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Protocol

from vlp16emu.doors import Part
from vlp16emu.elementary import exp, log
from vlp16emu.engine import Engine
from vlp16emu.errors import InputError, OutputError
from vlp16emu.kernels.compiler import kernel
from vlp16emu.output import STDOUT, spare
from vlp16emu.packets import Link, returns_in
from vlp16emu.random import Purpose, normal, normal_pair, uniform_pair
from vlp16emu.run.options import BagOptions, RecordOptions, TruthTo
from vlp16emu.run.report import About, Recording, UnitSent
from vlp16emu.scenario.model import CaptureClock
from vlp16emu.sinks import PcapResult, PcapSink, check_ending
from vlp16emu.types import Packet, PacketKind
from vlp16emu.units import S_NS, US_NS, seconds_to_ns

if TYPE_CHECKING:
    from vlp16emu.run.emulator import Emulator


class RunFile(Protocol):
    """A file of the packets of a run."""

    def send(self, packet: Packet) -> None:
        """Write a packet."""

    @property
    def result(self) -> PcapResult:
        """Size and digest of the closed file."""


BAG = Part[Callable[[Path, Engine, int, BagOptions | None], AbstractContextManager[Sequence[RunFile]]]](
    "vlp16emu.extras.bag.write:bag_of_run"
)
"""Function that opens a bag for a run, with poses at a rate in Hz."""
_LONGEST_US = 4_500.0  # limit of a host's delay: `verify` treats 5 ms as a network delay
_LANES_PER_UNIT = 8
_LANE = {kind: place for place, kind in enumerate(PacketKind)}
_MIDDLE_PPM = 3.0
_SPREAD_PPM = 10.0
_AHEAD_MS = 3.0


def record(
    emulator: "Emulator",
    path: str | Path,
    options: RecordOptions,
    *,
    progress: Callable[[float], None] = lambda _: None,
    stop: Event | None = None,
) -> Recording:
    """Write the packets of a run into a file; parameters and errors as in `Emulator.record`."""
    units = emulator.parts.units
    truth = TruthTo.of(options.truth)
    stop = stop or Event()
    emulator = emulator.with_truth_in(truth).stopped_by(stop)
    paths = _paths(emulator, Path(path), split=options.split)
    files = _files(emulator, path, paths, truth, options)
    scenario = emulator.scenario
    span_s = scenario.span_s(options.start_s, options.duration_s)
    host = HostClock(scenario.capture, scenario.seed, scenario.start_ns)
    packets = emulator.engine.packets(*span_s)  # checks the span before a file is opened
    began_s = time.perf_counter()
    simulated_s = 0.0
    sent = [Counter[PacketKind]() for _ in units]
    returns = [0] * len(units)
    begin_ns = scenario.start_ns + seconds_to_ns(span_s[0])
    with files as sinks, emulator.truth(truth, span_s) as writer:
        with suppress(CancelledError):
            for packet in _written(writer.beside(packets) if writer else packets, sinks, host, stop):
                sent[packet.unit][packet.kind] += 1
                returns[packet.unit] += returns_in(packet)
                simulated_s = (packet.due_ns - begin_ns) / S_NS
                progress(simulated_s)
        if stop.is_set() and not any(sent):
            raise CancelledError  # earlier files stay
    interrupted = stop.is_set()
    simulated_s = simulated_s if interrupted else span_s[1] - span_s[0]
    ran_s = span_s[0], span_s[0] + simulated_s
    written = [sink.result for sink in sinks]
    run_s = emulator.parts.motion.run_time_s
    counts = zip(units, sent, returns, strict=True)
    return Recording(
        file=", ".join(map(str, paths)),
        about=About.of(emulator.name, scenario),
        units=tuple(UnitSent.of(unit, of, ran_s, echoes) for unit, of, echoes in counts),
        bytes=sum(file.bytes for file in written),
        sha256=", ".join(file.sha256 for file in written),
        simulated_s=simulated_s,
        walk_share=None if math.isinf(run_s) else simulated_s / run_s,
        wall_s=time.perf_counter() - began_s,
        audit=emulator.finding,
        interrupted=interrupted,
        messages=written[0].messages,
    )


def _paths(emulator: "Emulator", path: Path, *, split: bool) -> list[Path]:
    """Return the files to write.

    With `split` there is one for each unit: `walk_1.pcap` and so on after `walk.pcap`.
    """
    if split and path == STDOUT:
        raise OutputError("-", "one standard output for the captures of all units", "the name of a file")
    units = range(1, len(emulator.parts.units) + 1)
    paths = [path.with_stem(f"{path.stem}_{unit}") for unit in units] if split else [path]
    for one in paths:
        spare(emulator.files, one)  # an input of the scene is never overwritten
    return paths


def _files(
    emulator: "Emulator",
    name: str | Path,
    paths: Sequence[Path],
    truth: TruthTo | None,
    options: RecordOptions,
) -> AbstractContextManager[Sequence[RunFile]]:
    """Return the files of a run, captures or a bag, as a context manager that opens them."""
    is_bag = paths[0].suffix.lower() in (".mcap", ".bag") or str(name).endswith("/")
    if not is_bag:
        check_ending(paths[0])
        if options.bag is not None:
            expected = "a bag: .mcap, .bag or a slash at the end"
            raise InputError("--for and --tf", f"found the capture {paths[0]}", expected)
        return _captures(paths, [unit.link for unit in emulator.parts.units])
    if options.split:
        raise OutputError(str(paths[0]), "found a bag to be split", "one bag for all sensors, or .pcap")
    rate_hz = (truth or TruthTo(paths[0])).rate_hz
    return BAG.load()(paths[0], emulator.engine, rate_hz, options.bag)


def _written(
    packets: Iterable[Packet], sinks: Sequence[RunFile], host: "HostClock", stop: Event
) -> Iterator[Packet]:
    """Write packets to the file of their unit, and yield each after it is written."""
    for packet in packets:
        if stop.is_set():  # between packets, so that the file ends with a whole one
            return
        sinks[min(packet.unit, len(sinks) - 1)].send(host.stamped(packet))
        yield packet


@contextmanager
def _captures(paths: Sequence[Path], links: Sequence[Link]) -> Iterator[list[PcapSink]]:
    with ExitStack() as stack:
        yield [stack.enter_context(PcapSink(path, links)) for path in paths]


class HostClock:
    """Clock of the recording host, which stamps the packets of a capture in order.

    A stamp depends on the seed and the packet alone, unless it would precede the stamp before it.

    Parameters
    ----------
    section : of the scene
    seed : of the scene
    start_ns : UTC of the first pulse
    """

    def __init__(self, section: CaptureClock, seed: int, start_ns: int) -> None:
        self._seed = seed
        self._start_ns = start_ns
        self._latest_ns = 0
        names = ("jitter_us", "late_share", "late_us")
        is_real = section.preset != "ideal"
        *drawn, rate, offset = normal(seed, Purpose.CAPTURE_HOST, 0, len(names) + 2).tolist()
        own = {
            name: getattr(section, name) * exp(section.host_spread * z)
            for name, z in zip(names, drawn, strict=True)
        }
        self._section = section = section.model_copy(update=own)
        self._ppm = section.ppm if section.ppm is not None else is_real * (_MIDDLE_PPM + _SPREAD_PPM * rate)
        self._ahead_ms = section.ahead_ms if section.ahead_ms is not None else is_real * _AHEAD_MS * offset
        self._is_ideal = not (self._ppm or self._ahead_ms or section.jitter_us or section.late_share)

    def stamped(self, packet: Packet) -> Packet:
        """Return a packet whose due time is its capture time."""
        if self._is_ideal:
            return packet
        since_ns = packet.due_ns - self._start_ns
        off_ns = since_ns * 1e-6 * self._ppm + 1e6 * self._ahead_ms
        moved_ns = round(off_ns + self._delay_us(packet) * US_NS)
        self._latest_ns = max(self._latest_ns, packet.due_ns + moved_ns)
        return packet.at(self._latest_ns)

    def _delay_us(self, packet: Packet) -> float:
        section = self._section
        number = packet.due_ns // US_NS
        lane = packet.unit * _LANES_PER_UNIT + _LANE[packet.kind]
        law = section.jitter_us, section.late_share, section.late_us
        return _draw_delay_us(self._seed, number, lane, *law)


@kernel
def _draw_delay_us(
    seed: int, number: int, lane: int, jitter_us: float, late_share: float, late_us: float
) -> float:
    """Draw the time that a host takes to stamp a packet: half of a normal law, rarely an exponential one."""
    delay_us = jitter_us * abs(normal_pair(seed, Purpose.CAPTURE_STAMP, number, lane)[0])
    is_late = uniform_pair(seed, Purpose.CAPTURE_LATE, 2 * number, lane)[0]
    if is_late < late_share:
        delay_us += -late_us * log(1.0 - uniform_pair(seed, Purpose.CAPTURE_LATE, 2 * number + 1, lane)[0])
    return min(delay_us, _LONGEST_US)
