"""A run into a capture file."""

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass
from ipaddress import IPv4Address
from pathlib import Path
from threading import Event
from typing import Protocol

from vlp16emu.doors import door
from vlp16emu.engine import Unit
from vlp16emu.errors import OutputError
from vlp16emu.output import STDOUT, spare
from vlp16emu.packets import Capture, returns_in
from vlp16emu.packets.frames import Link
from vlp16emu.run.host_clock import HostClock
from vlp16emu.run.options import TruthTo
from vlp16emu.run.report import AuditFinding
from vlp16emu.run.run import Run, TruthPlace
from vlp16emu.scenario.capture import CaptureClock
from vlp16emu.sensor.head import Turn, turn_of
from vlp16emu.sensor.settings import on_the_wire
from vlp16emu.sinks import PacketSink, PcapResult, PcapSink, check_ending
from vlp16emu.types import Packet, PacketKind
from vlp16emu.units import S_NS, seconds_to_ns


@dataclass(frozen=True, slots=True)
class UnitRecording:
    """What one sensor sent, and how far it turned."""

    unit: int
    """From 1."""
    name: str
    address: str
    data_port: int
    position_port: int
    packets: int
    """Data packets."""
    position_packets: int
    returns: int
    turn: Turn


@dataclass(frozen=True, slots=True)
class Recording:
    """What a recording holds, and what it took."""

    file: str
    scene: str
    """Name, path or title."""
    seed: int
    beam: str
    """The active model in words, as the next two; None for clear air."""
    noise: str
    weather: str | None
    packets: int
    """Data packets of all units."""
    position_packets: int
    returns: int
    units: tuple[UnitRecording, ...]
    bytes: int
    sha256: str
    """Of the whole file; of several in their order."""
    simulated_s: float
    walk_share: float | None
    """Of the whole motion, in time; None of one without end."""
    wall_s: float
    real_time_factor: float
    """Simulated seconds per second."""
    audit: AuditFinding | None = None
    """None without an audit."""
    interrupted: bool = False
    """Ended by its stop event."""
    messages: Mapping[str, int] | None = None
    """Of a bag, by topic."""


class FileSink(PacketSink, Protocol):
    """A sink that writes a file, and says what is in it."""

    @property
    def result(self) -> PcapResult:
        """What has been written, once it is closed."""


def record(
    run: Run,
    path: str | Path,
    *,
    start_s: float = 0.0,
    duration_s: float | None = None,
    split: bool = False,
    truth: TruthPlace | None = None,
    as_due: bool = False,
    progress: Callable[[float], None] = lambda _: None,
    stop: Event | None = None,
) -> Recording:
    """Write data and position packets into a pcap file; parameters and errors as of `Emulator.record`."""
    paths = _paths_of_units(Path(path), len(run.engine.parts.units)) if split else [Path(path)]
    for one in paths:
        spare(run.files, one)
    files = _files(run, path, paths, truth, split=split)
    run, scenario, stop = run.with_truth_in(truth), run.scenario, stop or Event()
    span_s = scenario.span_s(start_s, duration_s)
    clock = CaptureClock(preset="ideal") if as_due else scenario.capture
    host = HostClock(clock, scenario.seed, scenario.start_ns)
    packets = run.engine.packets(*span_s)  # checks the span before a file is touched
    began_s, sent, simulated_s = time.perf_counter(), Counter[tuple[int, str]](), 0.0
    begin_ns = scenario.start_ns + seconds_to_ns(span_s[0])
    with (
        run.engine.windows.stopped_by(stop),
        files as sinks,
        run.truth(truth, span_s, of=run) as writer,
        suppress(CancelledError),
    ):
        for packet in writer.beside(packets) if writer else packets:
            if stop.is_set():
                break
            sinks[min(packet.unit, len(sinks) - 1)].send(host.stamped(packet))
            sent[packet.unit, packet.kind] += 1
            sent[packet.unit, "returns"] += returns_in(packet)
            simulated_s = (packet.due_ns - begin_ns) / S_NS
            progress(simulated_s)
    wall_s, interrupted = time.perf_counter() - began_s, stop.is_set()
    simulated_s = simulated_s if interrupted else span_s[1] - span_s[0]
    return _recording(run, paths, sinks, sent, simulated_s, wall_s, interrupted=interrupted)


def _recording(
    run: Run,
    paths: Sequence[Path],
    sinks: Sequence[FileSink],
    sent: Counter[tuple[int, str]],
    simulated_s: float,
    wall_s: float,
    *,
    interrupted: bool,
) -> Recording:
    scenario, parts, written = run.scenario, run.engine.parts, [sink.result for sink in sinks]
    units = tuple(_unit(unit, sent, simulated_s) for unit in parts.units)
    return Recording(
        file=", ".join(map(str, paths)),
        scene=run.name,
        seed=scenario.seed,
        beam=scenario.beam.summary,
        noise=scenario.noise.summary,
        weather=scenario.weather.summary,
        packets=sum(file.data_packets for file in written),
        position_packets=sum(file.position_packets for file in written),
        returns=sum(unit.returns for unit in units),
        units=units,
        bytes=sum(file.bytes for file in written),
        sha256=", ".join(file.sha256 for file in written),
        simulated_s=simulated_s,
        walk_share=None if math.isinf(run_s := parts.motion.run_time_s) else simulated_s / run_s,
        wall_s=wall_s,
        real_time_factor=simulated_s / wall_s,
        audit=run.finding,
        interrupted=interrupted,
        messages=written[0].messages,
    )


def _paths_of_units(path: Path, units: int) -> list[Path]:
    """Name a capture for each unit after one for all: `walk_1.pcap` and so on after `walk.pcap`.

    Raises
    ------
    OutputError
        where that is standard output
    """
    if path == STDOUT:
        raise OutputError("-", "one standard output for the captures of all units", "the name of a file")
    return [path.with_stem(f"{path.stem}_{number + 1}") for number in range(units)]


def _is_bag(name: str | Path) -> bool:
    """Whether a name is that of a bag: by its ending, of a folder a slash."""
    return Path(name).suffix.lower() in (".mcap", ".bag") or str(name).endswith("/")


def _files(
    run: Run, name: str | Path, paths: Sequence[Path], truth: TruthPlace | None, *, split: bool
) -> AbstractContextManager[Sequence[FileSink]]:
    """Return the files of a run, which are opened when they are entered: captures, or a bag."""
    links = [unit.link for unit in run.engine.parts.units]
    if not _is_bag(name):
        check_ending(paths[0])
        return _captures(paths, links)
    if split:
        raise OutputError(str(paths[0]), "found a bag to be split", "one bag for all sensors, or .pcap")
    rate_hz = truth.rate_hz if isinstance(truth, TruthTo) else TruthTo(paths[0]).rate_hz
    bag: AbstractContextManager[Sequence[FileSink]] = door("bag")(paths[0], run.engine, rate_hz)
    return bag


@contextmanager
def _captures(paths: Sequence[Path], links: Sequence[Link]) -> Iterator[list[PcapSink]]:
    with ExitStack() as stack:
        yield [stack.enter_context(PcapSink(path, links)) for path in paths]


def prepared(links: Sequence[Link], path: Path, record: Callable[[Path], object]) -> Iterator[Packet]:
    """Record a whole run, and give its packets as `packets_of` does.

    Parameters
    ----------
    record : writes the capture

    Raises
    ------
    OutputError
        where the place cannot be read again, or has the ending of another format
    """
    if path == STDOUT or (path.exists() and not path.is_file()):
        raise OutputError(str(path), "no file that can be read again", "the name of a file")
    check_ending(path)
    record(path)
    return packets_of(links, path)


def packets_of(links: Sequence[Link], path: Path) -> Iterator[Packet]:
    """Yield all packets of a capture of our own, due at the stamps of their frames, which are in whole microseconds.

    Parameters
    ----------
    links : of the units that the packets are from

    Raises
    ------
    CaptureError
        where the file is damaged
    """
    ways = {
        (IPv4Address(link.source).packed, port): (kind, number)
        for number, link in enumerate(links)
        for kind, port in ((PacketKind.DATA, link.data_port), (PacketKind.POSITION, link.position_port))
    }
    with Capture(path, repeats=True) as capture:
        for datagram in capture:
            kind, number = ways[datagram.source, datagram.destination_port]
            yield Packet(kind, datagram.stamp_ns, datagram.payload, number)


def _unit(unit: Unit, sent: Counter[tuple[int, str]], simulated_s: float) -> UnitRecording:
    sensor = on_the_wire(unit.section)
    return UnitRecording(
        unit=unit.number + 1,
        name=sensor.name,
        address=sensor.address,
        data_port=sensor.data_port,
        position_port=sensor.position_port,
        packets=sent[unit.number, PacketKind.DATA],
        position_packets=sent[unit.number, PacketKind.POSITION],
        returns=sent[unit.number, "returns"],
        turn=turn_of(unit.head, simulated_s),
    )
