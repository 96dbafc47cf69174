"""Replay of captures at their own pace.

Runs are recorded before they are sent in the same way, so that the engine cannot be too slow.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from dataclasses import dataclass, replace
from ipaddress import IPv4Address, ip_address
from pathlib import Path
from threading import Event
from typing import Unpack

from vlp16emu.captures import Capture, Survey, arrivals_of, by_unit, chosen_unit
from vlp16emu.errors import CaptureError, InputError, OutputError
from vlp16emu.extras.bench.retime import age_ns, shift_packet, stamp_ns
from vlp16emu.extras.free_ports import free_ports
from vlp16emu.output import STDOUT, spare
from vlp16emu.packets import DATA_BYTES, FACTORY_LINK, POSITION_BYTES, Link, PacketClock
from vlp16emu.packets.frames import POSITION_PORT
from vlp16emu.run.emulator import Emulator
from vlp16emu.run.options import RecordOptions, ReplayKeys, ReplayOptions, StreamOptions
from vlp16emu.run.part import StreamPart
from vlp16emu.run.record import record
from vlp16emu.run.report import OfUnits, UnitSent
from vlp16emu.run.stream import Stream, StreamReport
from vlp16emu.scenario.model import CaptureClock
from vlp16emu.sinks import Late, Pacer, PcapSink, check_ending
from vlp16emu.trees import Tree
from vlp16emu.types import Packet, PacketKind
from vlp16emu.units import S_NS, US_NS

_KINDS = {DATA_BYTES: PacketKind.DATA, POSITION_BYTES: PacketKind.POSITION}
_LONGEST_GAP_NS = 60 * S_NS
"""Longest gap that is kept: a rotor takes some seconds to spin up; a longer gap is a suspended host or a
clock that was set."""

_LATE_NS = S_NS // 10  # packets that come later behind others show a clock that was set back


class Replay:
    """Data and position packets of a capture, due at the stamps of their frames; an iterable.

    Parameters
    ----------
    path : path of the capture
    loop : repeat the capture; each pass is later than the one before by a whole number of seconds, in stamps
        and sentences
    too, so that the sensor's time goes on
    keep_gaps : wait through gaps of more than a minute; otherwise they are shortened to one or two seconds,
        while the
    times in packets do not change
    stop : ends the search for units

    Raises CaptureError if the file is no capture or has no VLP-16 packets; CancelledError once `stop` is set.
    """

    def __init__(
        self, path: Path, *, loop: bool = False, keep_gaps: bool = False, stop: Event | None = None
    ) -> None:
        if path.is_fifo():
            raise CaptureError(str(path), "a pipe", "a file, which can be read twice")
        self.path = path
        self._loop = loop
        self._keeps_gaps = keep_gaps
        self.units = Survey(path, stop).required()  # sorted by address, then by port
        self.links = [
            replace(
                FACTORY_LINK,
                source=str(ip_address(unit.source)),
                data_port=unit.data_port,
                position_port=next(iter(unit.position_ports), POSITION_PORT),
            )
            for unit in self.units
        ]  # address and ports of the packets of each unit
        self.passes = 0  # passes begun so far
        self.left_out = 0  # datagrams of the first pass that are no complete packets of a unit
        self.gaps_s = list[float]()  # gaps of the first pass that were shortened
        faults = [record.stamps.fault for record in arrivals_of(path, self.units, stop)]
        self.paced_by = {number: fault for number, fault in enumerate(faults) if fault}
        """Why units, by their numbers from 0, are paced by their own clocks, not by the host's stamps."""

    def __iter__(self) -> Iterator[Packet]:
        later_ns = cut_ns = 0
        while True:
            self.passes += 1
            begin_ns = end_ns = last_ns = None
            back_ns = 0
            for packet in self._packets():
                captured = packet
                begin_ns = captured.due_ns if begin_ns is None else begin_ns
                if last_ns is not None and captured.due_ns < last_ns - _LATE_NS:  # a clock that was set back
                    back_ns += last_ns - captured.due_ns
                last_ns = captured.due_ns
                captured = replace(captured, due_ns=captured.due_ns + back_ns)
                gap_ns = captured.due_ns - (captured.due_ns if end_ns is None else end_ns)
                if gap_ns > _LONGEST_GAP_NS and not self._keeps_gaps:
                    self.gaps_s += [gap_ns / S_NS] * (self.passes == 1)
                    cut_ns += (gap_ns // S_NS - 1) * S_NS
                end_ns = captured.due_ns + max(-gap_ns, 0)  # stamps of some captures decrease
                due = replace(captured, due_ns=end_ns + later_ns - cut_ns)
                yield shift_packet(due, later_ns // S_NS) if later_ns else due
            if not self._loop or begin_ns is None or end_ns is None:
                return
            later_ns += ((end_ns - begin_ns) // S_NS + 1) * S_NS

    def _packets(self) -> Iterator[Packet]:
        """Yield the packets of a pass, due at their stamps, or at those of the sensor."""
        paces = {unit: _SensorPace() for unit in self.paced_by}
        last_ns = 0
        capture = Capture(self.path, is_quiet=self.passes > 1)
        for unit, datagram in by_unit(capture, self.units):
            kind = _KINDS.get(len(datagram.payload))
            if kind is None or unit is None:
                self.left_out += self.passes == 1
                continue
            packet = Packet(kind, datagram.stamp_ns, datagram.payload, unit)
            if unit in paces:
                packet = replace(packet, due_ns=paces[unit].due_ns(packet, last_ns))
            last_ns = packet.due_ns
            yield packet


class _SensorPace:
    """Due times of one unit's packets by the sensor's own stamps."""

    def __init__(self) -> None:
        self._clock = PacketClock()
        self._ahead_ns: int | None = None  # due times minus the sensor's clock
        self._sent_ns = 0

    def due_ns(self, packet: Packet, last_ns: int) -> int:
        """Return when a packet is due.

        Parameters
        ----------
        last_ns : when the packet before it is due, of any unit; 0 before the first
        """
        sensor_ns = self._clock.sensor_ns(packet.due_ns, stamp_ns(packet) // US_NS) + age_ns(packet)
        if self._ahead_ns is None:
            self._ahead_ns = (last_ns or packet.due_ns) - sensor_ns
        elif sensor_ns - self._sent_ns < -_LATE_NS:  # a sensor that starts again
            self._ahead_ns += self._sent_ns - sensor_ns
        self._sent_ns = sensor_ns
        return sensor_ns + self._ahead_ns


@dataclass(frozen=True, slots=True)
class Replayed(OfUnits):
    """Result of a replay: packets sent, and their delays."""

    file: str
    to: str
    units: tuple[
        UnitSent, ...
    ]  # address of each sensor in the capture, and the ports that its packets were sent to
    left_out: int  # datagrams of the file that are no VLP-16 packets
    passes: int
    paced_by_sensor: tuple[str, ...]  # why units were paced by their own clocks, not by the host's stamps
    gaps_s: tuple[float, ...]  # gaps of more than a minute that were shortened
    sent: StreamReport

    @property
    def interrupted(self) -> bool:
        """True if the stop event or Ctrl-C ended it."""
        return self.sent.interrupted


class ReplayStream(Stream):
    """Stream of a capture, whose ports are reserved and whose sockets are open once it is made.

    Parameters
    ----------
    path : capture of any VLP-16
    options : receiver, speed and passes
    stop : ends the replay from another thread

    Raises the errors of `replay`.
    """

    def __init__(self, path: Path, options: ReplayOptions, *, stop: Event | None = None) -> None:
        self.host, data_port = options.receiver
        given = data_port, options.position_port
        self.replay = Replay(path, loop=options.loop, keep_gaps=options.keep_gaps, stop=stop)
        if len(self.replay.units) > 1 and given != (None, None):
            raise InputError(str(path), f"{len(self.replay.units)} sensors", "one, where ports are given")
        pacer = Pacer(options.speed)
        super().__init__(self.replay, {}, pacer, late=Late(options.late), now=options.now, stop=stop)
        with self._opening():
            free = iter(self._opened.enter_context(free_ports(given.count(0))))
            data_port, position_port = (next(free) if port == 0 else port for port in given)
            self.links = [
                replace(
                    link,
                    data_port=data_port or link.data_port,
                    position_port=position_port or link.position_port,
                )
                for link in self.replay.links
            ]
            self.udp = self._open_udp(self.links, options)

    @property
    def result(self) -> Replayed:
        """Result of the replay, once it is closed."""
        replayed = self.replay
        units = tuple(
            UnitSent(
                unit=number,
                name=str(unit),
                address=link.source,
                data_port=link.data_port,
                position_port=link.position_port,
                packets=sent[PacketKind.DATA],
                position_packets=sent[PacketKind.POSITION],
            )
            for number, (unit, link, sent) in enumerate(
                zip(replayed.units, self.links, self.udp.sent, strict=True), start=1
            )
        )
        return Replayed(
            file=str(replayed.path),
            to=self.host,
            units=units,
            left_out=replayed.left_out,
            passes=replayed.passes,
            paced_by_sensor=tuple(replayed.paced_by.values()),
            gaps_s=tuple(replayed.gaps_s),
            sent=self.report,
        )


def replay(
    path: str | Path,
    *,
    parts: Sequence[StreamPart] = (),
    stop: Event | None = None,
    **options: Unpack[ReplayKeys],
) -> Replayed:
    """Send the packets of a capture over UDP at their own pace.

    Nothing leaves this machine unless `to` names another one.

    Parameters
    ----------
    path : capture of any VLP-16
    parts : watch the stream, in their order
    stop : ends the replay from another thread
    options : fields of `ReplayOptions`

    Raises InputError if an option is invalid, ports are given for several sensors, or `now` is combined with
    another speed; CaptureError as in `Replay`; OutputError, RunError as in `Emulator.stream`.
    """
    stream = ReplayStream(Path(path), ReplayOptions.from_fields(options), stop=stop)
    for part in parts:
        stream.add(part)
    stream.run()
    return stream.result


def write_pcap(capture: Path, out: Path, unit: str | None = None, *, stop: Event) -> Tree:
    """Write the packets of a capture of any kind, also a bag, as classic pcap in the frames of a real sensor.

    Parameters
    ----------
    unit : the sensor to write, as `chosen_unit` takes it; by default all sensors
    stop : ends the file between two packets; it is valid

    Raises CaptureError as in `Replay`; InputError if there is no such unit; OutputError, RunError like
    `PcapSink`.
    """
    spare([capture], out)
    check_ending(out)
    replayed = Replay(capture, stop=stop)
    chosen = None if unit is None else chosen_unit(capture, unit, where="--unit", stop=stop)
    taken = [number for number, each in enumerate(replayed.units) if chosen in (None, each)]
    counts = dict.fromkeys(PacketKind, 0)
    with PcapSink(out, replayed.links) as sink:
        for number, datagram in by_unit(Capture(capture), replayed.units):
            kind = _KINDS.get(len(datagram.payload))
            if stop.is_set():
                break
            if kind is not None and number in taken:
                sent = counts[PacketKind.POSITION]
                sink.send(Packet(kind, datagram.stamp_ns, datagram.payload, number, number=sent))
                counts[kind] += 1
    return {
        "file": str(out),
        "packets": counts[PacketKind.DATA],
        "position_packets": counts[PacketKind.POSITION],
        "bytes": sink.result.bytes,
        "sha256": sink.result.sha256,
        "interrupted": stop.is_set(),
    }


def prepared(
    emulator: Emulator, options: StreamOptions, *, progress: Callable[[float], None], stop: Event
) -> Iterator[Packet]:
    """Record a whole run into the file `options.prepare`, and yield its packets as `packets_of` does.

    Raises OutputError if the file cannot be read again, or has the suffix of another format; other errors as
    in `record`.
    """
    path = Path(options.prepare or "")
    if path == STDOUT or (path.exists() and not path.is_file()):
        raise OutputError(str(path), "no file that can be read again", "the name of a file")
    check_ending(path)
    # Stamps are due times, without the errors of a recording host's clock.
    scenario = emulator.scenario.model_copy(update={"capture": CaptureClock(preset="ideal")})
    asked = RecordOptions(duration_s=options.duration_s, truth=options.truth)
    ideal = emulator.with_engine(replace(emulator.engine, scenario=scenario))
    try:
        record(ideal, path, asked, progress=progress, stop=stop)
    except CancelledError:  # stopped before the first packet
        return iter(())
    return packets_of([unit.link for unit in emulator.engine.parts.units], path)


def packets_of(links: Sequence[Link], path: Path) -> Iterator[Packet]:
    """Yield all packets of a capture that the emulator has made.

    They are due at the stamps of their frames, in whole microseconds.

    `links` belong to the units of the packets. Raises CaptureError if the file is damaged.
    """
    ways = {
        (IPv4Address(link.source).packed, port): (kind, number)
        for number, link in enumerate(links)
        for kind, port in ((PacketKind.DATA, link.data_port), (PacketKind.POSITION, link.position_port))
    }
    for datagram in Capture(path, repeats=True):
        kind, number = ways[datagram.source, datagram.destination_port]
        yield Packet(kind, datagram.stamp_ns, datagram.payload, number)
