"""A run into a capture file or a bag."""

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from ipaddress import IPv4Address
from pathlib import Path
from threading import Event
from typing import Protocol

from vlp16emu.doors import door
from vlp16emu.engine import Unit
from vlp16emu.errors import InputError, OutputError
from vlp16emu.output import STDOUT, spare
from vlp16emu.packets import Capture, returns_in
from vlp16emu.packets.frames import Link
from vlp16emu.run.host_clock import HostClock
from vlp16emu.run.options import RecordOptions, TruthTo
from vlp16emu.run.report import About, Recording, UnitSent
from vlp16emu.run.run import Run
from vlp16emu.scenario.capture import CaptureClock
from vlp16emu.sinks import PacketSink, PcapResult, PcapSink, check_ending
from vlp16emu.types import Packet, PacketKind
from vlp16emu.units import S_NS, seconds_to_ns


class FileSink(PacketSink, Protocol):
    """A sink that writes a file and reports its content."""

    @property
    def result(self) -> PcapResult:
        """Content of the file, once it is closed."""


def record(
    run: Run,
    path: str | Path,
    options: RecordOptions,
    *,
    as_due: bool = False,
    progress: Callable[[float], None] = lambda _: None,
    stop: Event | None = None,
) -> Recording:
    """Write the packets of a run into a file; parameters and errors as `Emulator.record`."""
    truth = TruthTo.of(options.truth)
    paths = _paths_of_units(Path(path), len(run.engine.parts.units)) if options.split else [Path(path)]
    for one in paths:
        spare(run.files, one)
    files = _files(run, path, paths, truth, options)
    run, scenario, stop = run.with_truth_in(truth), run.scenario, stop or Event()
    span_s = scenario.span_s(options.start_s, options.duration_s)
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
    interrupted = stop.is_set()
    simulated_s = simulated_s if interrupted else span_s[1] - span_s[0]
    written, run_s = [sink.result for sink in sinks], run.engine.parts.motion.run_time_s
    return Recording(
        file=", ".join(map(str, paths)),
        about=About.of(run.name, scenario),
        units=tuple(_sent(unit, sent, simulated_s) for unit in run.engine.parts.units),
        bytes=sum(file.bytes for file in written),
        sha256=", ".join(file.sha256 for file in written),
        simulated_s=simulated_s,
        walk_share=None if math.isinf(run_s) else simulated_s / run_s,
        wall_s=time.perf_counter() - began_s,
        audit=run.finding,
        interrupted=interrupted,
        messages=written[0].messages,
    )


def _sent(unit: Unit, sent: Counter[tuple[int, str]], simulated_s: float) -> UnitSent:
    data, position, returns = (sent[unit.number, kind] for kind in (PacketKind.DATA, PacketKind.POSITION, "returns"))
    return UnitSent.of(unit, data, position, simulated_s, returns)


def _paths_of_units(path: Path, units: int) -> list[Path]:
    """Return a name for the capture of each unit: `walk_1.pcap` and so on after `walk.pcap`."""
    if path == STDOUT:
        raise OutputError("-", "one standard output for the captures of all units", "the name of a file")
    return [path.with_stem(f"{path.stem}_{number + 1}") for number in range(units)]


def _is_bag(name: str | Path) -> bool:
    """Return whether a name is that of a bag: by its ending, of a folder a slash."""
    return Path(name).suffix.lower() in (".mcap", ".bag") or str(name).endswith("/")


def _files(
    run: Run, name: str | Path, paths: Sequence[Path], truth: TruthTo | None, options: RecordOptions
) -> AbstractContextManager[Sequence[FileSink]]:
    """Return the files of a run, which are opened when they are entered: captures, or a bag."""
    links = [unit.link for unit in run.engine.parts.units]
    if not _is_bag(name):
        check_ending(paths[0])
        if options.bag is not None:
            raise InputError(
                "--for and --tf", f"found the capture {paths[0]}", "a bag: .mcap, .bag or a slash at the end"
            )
        return _captures(paths, links)
    if options.split:
        raise OutputError(str(paths[0]), "found a bag to be split", "one bag for all sensors, or .pcap")
    rate_hz = (truth or TruthTo(paths[0])).rate_hz
    bag: AbstractContextManager[Sequence[FileSink]] = door("bag")(paths[0], run.engine, rate_hz, options.bag)
    return bag


@contextmanager
def _captures(paths: Sequence[Path], links: Sequence[Link]) -> Iterator[list[PcapSink]]:
    with ExitStack() as stack:
        yield [stack.enter_context(PcapSink(path, links)) for path in paths]


def prepared(links: Sequence[Link], path: Path, record: Callable[[Path], object]) -> Iterator[Packet]:
    """Record a whole run, and yield its packets as `packets_of` does.

    Parameters
    ----------
    record : writes the capture

    Raises
    ------
    OutputError
        If the place cannot be read again, or has the ending of another format
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
        If the file is damaged
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
