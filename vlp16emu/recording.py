"""A run into a capture file, and what it made."""

import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass
from ipaddress import IPv4Address
from pathlib import Path
from threading import Event
from typing import Protocol

from vlp16emu.accuracy import AuditFinding
from vlp16emu.chain import Unit
from vlp16emu.chain.chain import Chain
from vlp16emu.device.host_clock import HostClock
from vlp16emu.errors import OutputError
from vlp16emu.output import STDOUT
from vlp16emu.packets import Capture, returns_in
from vlp16emu.packets.frames import Link
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


def paths_of_units(path: Path, units: int) -> list[Path]:
    """Name a capture for each unit after one for all: `walk_1.pcap` and so on after `walk.pcap`.

    Raises
    ------
    OutputError
        where that is standard output
    """
    if path == STDOUT:
        raise OutputError("-", "one standard output for the captures of all units", "the name of a file")
    return [path.with_stem(f"{path.stem}_{number + 1}") for number in range(units)]


class FileSink(PacketSink, Protocol):
    """A sink that writes a file, and says what is in it."""

    @property
    def result(self) -> PcapResult:
        """What has been written, once it is closed."""


FileSinks = AbstractContextManager[Sequence[FileSink]]


def record_packets(
    chain: Chain,
    packets: AbstractContextManager[Iterable[Packet]],
    files: FileSinks,
    span_s: tuple[float, float],
    *,
    name: str,
    scene: str,
    host: HostClock,
    progress: Callable[[float], None],
    stop: Event,
) -> Recording:
    """Write packets into a file, or those of each unit into one of its own, until they end or are to stop.

    Parameters
    ----------
    packets : of the chain, over the span; entered when the files are open
    files : one for all units, or one for each
    span_s : of the run, since the first pulse
    name : of the files in the recording
    scene : its name in the recording
    host : whose stamps the files have
    progress : called with the simulated seconds so far, packet by packet
    stop : ends the recording between two packets

    Raises
    ------
    OutputError, RunError
        as of the files
    """
    began_s, scenario, units = time.perf_counter(), chain.scenario, chain.parts.units
    begin_ns, simulated_s = scenario.start_ns + seconds_to_ns(span_s[0]), 0.0
    sent = Counter[tuple[int, str]]()
    with files as sinks, packets as taken, suppress(CancelledError):
        for packet in taken:
            if stop.is_set():
                break
            sinks[min(packet.unit, len(sinks) - 1)].send(host.stamped(packet))
            sent[packet.unit, packet.kind] += 1
            sent[packet.unit, "returns"] += returns_in(packet)
            simulated_s = (packet.due_ns - begin_ns) / S_NS
            progress(simulated_s)
    interrupted, wall_s = stop.is_set(), time.perf_counter() - began_s
    simulated_s = simulated_s if interrupted else span_s[1] - span_s[0]
    written, parts = [sink.result for sink in sinks], tuple(_unit(unit, sent, simulated_s) for unit in units)
    return Recording(
        file=name,
        scene=scene,
        seed=scenario.seed,
        beam=scenario.beam.summary,
        noise=scenario.noise.summary,
        weather=scenario.weather.summary,
        packets=sum(file.data_packets for file in written),
        position_packets=sum(file.position_packets for file in written),
        returns=sum(unit.returns for unit in parts),
        units=parts,
        bytes=sum(file.bytes for file in written),
        sha256=", ".join(file.sha256 for file in written),
        simulated_s=simulated_s,
        walk_share=None if math.isinf(run_s := chain.parts.motion.run_time_s) else simulated_s / run_s,
        wall_s=wall_s,
        real_time_factor=simulated_s / wall_s,
        interrupted=interrupted,
        messages=written[0].messages,
    )


@contextmanager
def pcap_files(paths: Sequence[Path], links: Sequence[Link]) -> Iterator[list[PcapSink]]:
    """Open captures, for `record_packets`."""
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
    with Capture(path) as capture:
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
