"""A capture sent again: its packets at their own pace, from any VLP-16."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from ipaddress import ip_address
from pathlib import Path
from threading import Event

from vlp16emu.errors import CaptureError, InputError
from vlp16emu.packets import DATA_BYTES, POSITION_BYTES, Capture, CapturedUnit, units_in
from vlp16emu.packets.frames import FACTORY_LINK, POSITION_PORT, Link
from vlp16emu.packets.retime import moved
from vlp16emu.run.report import Behind, behind_of
from vlp16emu.sinks import LOOPBACK, FellBehind, FirstPacket, Late, Pacer, RigSink, StreamReport, UdpResult, stream
from vlp16emu.types import Packet, PacketKind
from vlp16emu.units import S_NS

_KINDS = {DATA_BYTES: PacketKind.DATA, POSITION_BYTES: PacketKind.POSITION}


class Replay:
    """Data and position packets of a capture, due at the stamps of their frames; an iterable.

    Parameters
    ----------
    path : classic pcap
    loop : begin again and again; each pass is later than the one before it by a whole number of seconds, in stamps and
        sentences too, so that the sensor's time goes on

    Raises
    ------
    CaptureError
        where the file is no capture, or holds no VLP-16 packets; while iterating, where it is damaged
    """

    def __init__(self, path: Path, *, loop: bool = False) -> None:
        if path.is_fifo():
            raise CaptureError(str(path), "a pipe", "a file, which can be read twice")
        self.path, self._loop = path, loop
        self.units = units_in(path, required=True)
        """In order of address, then of port."""
        self.passes = 0
        """Begun so far."""
        self.left_out = 0
        """Datagrams of the first pass that are no whole packets of a unit."""

    def __iter__(self) -> Iterator[Packet]:
        later_ns = 0
        while True:
            self.passes += 1
            begin_ns = end_ns = None
            for captured in self._packets():
                begin_ns = captured.due_ns if begin_ns is None else begin_ns
                end_ns = max(captured.due_ns, begin_ns if end_ns is None else end_ns)
                packet = replace(captured, due_ns=end_ns + later_ns)  # stamps of some captures go back
                yield moved(packet, later_ns // S_NS) if later_ns else packet
            if not self._loop or begin_ns is None or end_ns is None:
                return
            later_ns += ((end_ns - begin_ns) // S_NS + 1) * S_NS

    def _packets(self) -> Iterator[Packet]:
        """Read all packets once."""
        numbers = dict[tuple[bytes, int, bytes], int]()
        with Capture(self.path) as capture:
            for datagram in capture:
                key = datagram.source, datagram.destination_port, datagram.mac
                if key not in numbers:
                    owners = (number for number, unit in enumerate(self.units) if unit.owns(datagram))
                    numbers[key] = next(owners, -1)
                kind = _KINDS.get(len(datagram.payload))
                if kind is None or numbers[key] < 0:
                    self.left_out += self.passes == 1
                else:
                    yield Packet(kind, datagram.stamp_ns, datagram.payload, numbers[key])


@dataclass(frozen=True, slots=True)
class Replayed:
    """What was sent of a capture, and how punctual it was."""

    file: str
    to: str
    units: tuple[str, ...]
    """Address and data port of each sensor in the capture."""
    ports: tuple[tuple[int, int], ...]
    """To which its data and position packets were sent."""
    packets: int
    """Data packets of all units."""
    position_packets: int
    left_out: int
    """Datagrams of the file that are no packets of a VLP-16."""
    passes: int
    moved_s: int
    """Whole seconds by which stamps and sentences were moved into the present; 0 where they were kept."""
    first: FirstPacket | None
    """When the first packet left; None where none did."""
    capture_s: float
    """Time that the packets span in the capture."""
    wall_s: float
    late_median_us: float
    late_p99_us: float
    late_max_us: float
    behind: tuple[Behind, ...]
    delay_s: float
    """By which the stream was late at its end."""
    skipped: int
    """Packets dropped because they were late."""
    interrupted: bool


def replay(
    path: str | Path,
    *,
    to: str = LOOPBACK,
    data_port: int | None = None,
    position_port: int | None = None,
    loop: bool = False,
    now: bool = False,
    speed: float = 1.0,
    late: Late | str = Late.PACE,
    as_sensor: bool = False,
    interface: str | None = None,
    opened: Callable[[Replay], None] = lambda _: None,
    progress: Callable[[float], None] = lambda _: None,
    notify: Callable[[FellBehind], None] = lambda _: None,
    stop: Event | None = None,
) -> Replayed:
    """Send the packets of a capture over UDP at their own pace; nothing leaves this machine unless `to` names another.

    Parameters
    ----------
    path : classic pcap of any VLP-16
    to, speed, late, notify, stop : as of `Emulator.stream`
    data_port, position_port : of the receiver, for a capture of one sensor; those of the capture if left out
    loop : as of `Replay`
    now : move stamps and sentences into the present
    as_sensor : send from the sensors' own addresses, which this machine must have, with their headers
    interface : as of `Emulator.stream`
    opened : called once before the first packet
    progress : called with the seconds of the capture so far, packet by packet

    Raises
    ------
    InputError
        where ports are given for several sensors, or the present is wanted at another speed than its own
    CaptureError
        as `Replay`
    OutputError, RunError
        as `Emulator.stream`
    """
    packets = Replay(Path(path), loop=loop)
    if len(packets.units) > 1 and (data_port or position_port):
        raise InputError(str(path), f"{len(packets.units)} sensors", "one, where ports are given")
    links = [_link(unit, data_port, position_port) for unit in packets.units]
    first = list[int]()

    def sent(due_ns: int) -> None:
        first.append(due_ns) if not first else None
        progress((due_ns - first[0]) / S_NS)

    with RigSink(links, to, as_sensor=as_sensor, interface=interface, sent=sent) as rig:
        opened(packets)
        report = stream(packets, rig, Pacer(speed), late=Late(late), notify=notify, now=now, stop=stop)
    return _summed_up(packets, links, report, rig.results, to)


def _summed_up(
    packets: Replay, links: Sequence[Link], report: StreamReport, sent: Sequence[UdpResult], to: str
) -> Replayed:
    return Replayed(
        file=str(packets.path),
        to=to,
        units=tuple(map(str, packets.units)),
        ports=tuple((link.data_port, link.position_port) for link in links),
        packets=sum(unit.data_packets for unit in sent),
        position_packets=sum(unit.position_packets for unit in sent),
        left_out=packets.left_out,
        passes=packets.passes,
        moved_s=report.moved_s,
        first=report.first,
        capture_s=report.simulated_s,
        wall_s=report.wall_s,
        late_median_us=report.lateness.median_ns * 1e-3,
        late_p99_us=report.lateness.p99_ns * 1e-3,
        late_max_us=report.lateness.max_ns * 1e-3,
        behind=tuple(map(behind_of, report.behind)),
        delay_s=report.delay_s,
        skipped=report.skipped.total(),
        interrupted=report.interrupted,
    )


def _link(unit: CapturedUnit, data_port: int | None, position_port: int | None) -> Link:
    captured = next(iter(unit.position_ports), POSITION_PORT)
    return replace(
        FACTORY_LINK,
        source=str(ip_address(unit.source)),
        data_port=data_port or unit.data_port,
        position_port=position_port or captured,
    )
