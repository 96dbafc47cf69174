"""What a stream sends, and can leave out; how punctual it was, and why it fell behind."""

from collections import Counter
from collections.abc import Callable, Collection, Generator, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from threading import Thread

from vlp16emu.accuracy import AuditFinding
from vlp16emu.chain import Unit
from vlp16emu.chain.beside import Beside
from vlp16emu.chain.chain import Chain
from vlp16emu.chain.position import position_number
from vlp16emu.device.events import Event
from vlp16emu.flight import LiveReport
from vlp16emu.report.keeping_up import settings_that_keep_up
from vlp16emu.scenario import Scenario
from vlp16emu.sensor.head import Turn, turn_of
from vlp16emu.sinks import (
    FellBehind,
    FirstPacket,
    GpsInResult,
    Late,
    Outlet,
    OutletResult,
    StreamReport,
    TruthTo,
    UdpResult,
    write_json,
)
from vlp16emu.types import Packet, PacketKind
from vlp16emu.units import S_NS, seconds_to_ns


class Engine:
    """Packets of a run in order of sending, an iterator.

    Parameters
    ----------
    chain : makes them
    start_s, stop_s : span of the run, since the first pulse
    also : kinds that leave beside the packets of the sensors

    Raises
    ------
    InputError
        where the chain has no such span, or the scene no device that `also` asks for
    """

    def __init__(
        self, chain: Chain, start_s: float, stop_s: float, *, also: Collection[PacketKind] = ()
    ) -> None:
        self._chain, self._stop_s = chain, stop_s
        self._beside = Beside(chain.scenario, chain.parts, chain.receiver, also)
        self._packets = self._from(start_s)
        self._reached_ns = chain.scenario.start_ns
        self._at_reached = set[tuple[int, PacketKind]]()
        self._from_ns: int | None = None
        self.skipped = Counter[PacketKind]()
        """Packets that were left out."""

    @property
    def scenario(self) -> Scenario:
        """That of the run, with the events so far."""
        return self._chain.scenario

    def __iter__(self) -> Iterator[Packet]:
        return self

    def __next__(self) -> Packet:
        from_ns, self._from_ns = self._from_ns, None
        if from_ns is not None:
            self._leave_out(from_ns)
        packet = next(self._packets)
        if packet.due_ns > self._reached_ns:
            self._reached_ns = packet.due_ns
            self._at_reached.clear()
        self._at_reached.add((packet.unit, packet.kind))
        return packet

    def close(self) -> None:
        """End the workers, and wait for what they have begun."""
        self._packets = iter(())

    def _let_go(self) -> None:
        """End the workers without waiting: what comes next is wanted at once."""
        before, self._packets = self._packets, iter(())
        if isinstance(before, Generator):
            Thread(target=before.close, name="let go", daemon=True).start()

    def go_on_from(self, due_ns: int) -> None:
        """Compute no packet that is due before a UTC time, from the next one on; from any thread."""
        self._from_ns = due_ns

    def begin_again(self, from_ns: int, events: Sequence[Event]) -> None:
        """Go on from a UTC time, or from where the run is if that is earlier, with other events; between two packets."""
        self._let_go()
        self._chain.set_events(events)
        if from_ns > self._reached_ns:
            from_ns, there = self._reached_ns, self._at_reached
        else:
            there = set()
        self._packets = self._after(from_ns, there)

    def _from(self, start_s: float) -> Iterator[Packet]:
        packets = self._chain.packets(start_s, self._stop_s)
        return self._beside.among(packets, seconds_to_ns(start_s), seconds_to_ns(self._stop_s))

    def _after(self, from_ns: int, there: AbstractSet[tuple[int, PacketKind]]) -> Iterator[Packet]:
        """Yield packets due from a UTC time on; of those due just then some are out already."""
        for packet in self._from(self._since_s(from_ns)):
            if packet.due_ns > from_ns or (packet.unit, packet.kind) not in there:
                yield packet

    def _leave_out(self, from_ns: int) -> None:
        """Begin again further on."""
        stop_ns = self.scenario.start_ns + round(self._stop_s * S_NS)
        from_ns = min(from_ns, stop_ns)
        if from_ns <= self._reached_ns:
            return
        self.close()  # of the packets before
        self.skipped += self._count(from_ns) - self._count(self._reached_ns + 1)
        self._packets = self._from(self._since_s(from_ns))

    def _count(self, before_ns: int) -> Counter[PacketKind]:
        """Count the packets of all units due from the first pulse until before a UTC time."""
        units, since_ns = self._chain.parts.units, before_ns - self.scenario.start_ns
        data = 0
        for unit in units:
            data += unit.sending.count(0, since_ns)
        position = sum(position_number(self.scenario, unit, since_ns) for unit in units)
        beside = self._beside.count(0, since_ns)
        return Counter({PacketKind.DATA: data, PacketKind.POSITION: position, **beside})

    def _since_s(self, utc_ns: int) -> float:
        return (utc_ns - self.scenario.start_ns) / S_NS


@dataclass(frozen=True, slots=True)
class Http:
    """Where the web interfaces of a stream's sensors are."""

    host: str
    port: int
    """Of the first sensor, those of others follow; 0 for free ones."""
    saved: Path | None = None
    """File that keeps the saved settings of the first sensor from run to run; others have its name with their number."""
    serving: Callable[[list[tuple[str, int]]], None] = lambda _: None
    """Called with the address and port of each, before the first packet leaves."""


@dataclass(frozen=True, slots=True)
class UnitStreamed:
    """What one sensor sent, and how far it turned."""

    unit: int
    """From 1."""
    data_port: int
    position_port: int
    packets: int
    """Data packets."""
    position_packets: int
    turn: Turn


@dataclass(frozen=True, slots=True)
class Behind:
    """One time that a stream fell behind."""

    at_s: float
    """From the start of the stream."""
    behind_s: float
    """Delay that came of it, or with `skip` the greatest lateness."""
    engine: bool
    """The engine was the cause."""
    engine_speed: float | None
    """Simulated seconds per second; None where it was not the cause, or is unknown."""
    cause: str


@dataclass(frozen=True, slots=True)
class Streamed:
    """What a stream sent, and how it went."""

    scene: str
    """Name, path or title."""
    seed: int
    to: str
    speed: float
    """Simulated seconds per second that were asked for."""
    late: Late
    moved_s: int
    """Whole seconds from the time of the scene, which truth has, to that of stamps and sentences."""
    first: FirstPacket | None
    """When the first packet left; None where none did."""
    beam: str
    """The active model in words, as the next two; None for clear air."""
    noise: str
    weather: str | None
    data_port: int
    """Of the first unit, as the next."""
    position_port: int
    packets: int
    """Data packets of all units."""
    position_packets: int
    units: tuple[UnitStreamed, ...]
    simulated_s: float
    wall_s: float
    real_time_factor: float
    late_median_us: float
    late_p99_us: float
    late_max_us: float
    fell_behind: int
    """How often."""
    most_behind_s: float
    behind: tuple[Behind, ...]
    delay_s: float
    """By which the stream was late at its end."""
    skipped_packets: int
    skipped_position_packets: int
    keeps_up_with: tuple[str, ...]
    """Options of `vlp16emu stream` with which the engine would keep up, each enough by itself."""
    interrupted: bool
    audit: AuditFinding | None
    """None without an audit."""
    live: LiveReport | None = None
    """None where no poses came in."""
    gps_in: GpsInResult | None = None
    """None without a real receiver."""
    gps_out: OutletResult | None = None
    """Sentences and pulses of the receiver; None unless asked for, as the next."""
    imu_out: OutletResult | None = None
    """Samples of the inertial unit."""


def summed_up(
    chain: Chain,
    engine: Engine,
    report: StreamReport,
    sent: Sequence[UdpResult],
    scene: str,
    to: str,
    speed: float,
    late: Late,
    *,
    audit: AuditFinding | None,
    live: LiveReport | None = None,
) -> Streamed:
    """Sum up a stream.

    Parameters
    ----------
    sent : what the sinks of all units have sent
    live : where poses came in
    """
    scenario, lateness, skipped = chain.scenario, report.lateness, report.skipped + engine.skipped
    units = tuple(_unit(*pair, report.simulated_s) for pair in zip(chain.parts.units, sent, strict=True))
    return Streamed(
        scene=scene,
        seed=scenario.seed,
        to=to,
        speed=speed,
        late=late,
        moved_s=report.moved_s,
        first=report.first,
        beam=scenario.beam.summary,
        noise=scenario.noise.summary,
        weather=scenario.weather.summary,
        data_port=units[0].data_port,
        position_port=units[0].position_port,
        packets=sum(unit.packets for unit in units),
        position_packets=sum(unit.position_packets for unit in units),
        units=units,
        simulated_s=report.simulated_s,
        wall_s=report.wall_s,
        real_time_factor=report.real_time_factor,
        late_median_us=lateness.median_ns * 1e-3,
        late_p99_us=lateness.p99_ns * 1e-3,
        late_max_us=lateness.max_ns * 1e-3,
        fell_behind=len(report.behind),
        most_behind_s=max((behind.total_s for behind in report.behind), default=0.0),
        behind=tuple(map(behind_of, report.behind)),
        delay_s=report.delay_s,
        skipped_packets=skipped[PacketKind.DATA],
        skipped_position_packets=skipped[PacketKind.POSITION],
        keeps_up_with=tuple(options_for(report.behind, scenario, speed)),
        interrupted=report.interrupted,
        audit=audit,
        live=live,
    )


def write_times(to: str | Path | TruthTo, report: StreamReport, speed: float) -> None:
    """Write beside the truth of a stream when its first packet left, so that what was made of it live can be compared.

    Raises
    ------
    OutputError, RunError
        where the file cannot be written
    """
    if report.first is not None:
        folder = to.folder if isinstance(to, TruthTo) else Path(to)
        times = {"moved_s": report.moved_s, "speed": speed, "packet_0": asdict(report.first)}
        write_json(folder / "time.json", times)


def with_outlets(
    streamed: Streamed, sent: Mapping[PacketKind, Outlet], skipped: Counter[PacketKind]
) -> Streamed:
    """Add what left beside the packets of the sensors to a summary, and count what the stream skipped as dropped."""

    def found(kind: PacketKind) -> OutletResult | None:
        result = sent[kind].result if kind in sent else None
        return result and replace(result, dropped=result.dropped + skipped[kind])

    return replace(streamed, gps_out=found(PacketKind.NMEA), imu_out=found(PacketKind.IMU))


def _unit(unit: Unit, sent: UdpResult, simulated_s: float) -> UnitStreamed:
    """Sum up what a sensor sent."""
    return UnitStreamed(
        unit=unit.number + 1,
        data_port=unit.link.data_port,
        position_port=unit.link.position_port,
        packets=sent.data_packets,
        position_packets=sent.position_packets,
        turn=turn_of(unit.head, simulated_s),
    )


def options_for(times: Sequence[FellBehind], scenario: Scenario, speed: float) -> list[str]:
    """Options with which the engine keeps up, as slow as it was; none where it was not the cause."""
    speeds = [behind.engine_speed for behind in times if behind.engine and behind.engine_speed is not None]
    return settings_that_keep_up(scenario, min(speeds), speed) if speeds else []


def cause_of(behind: FellBehind) -> str:
    """Why a stream fell behind."""
    if not behind.engine:
        return "the process stood still or got no core"
    if behind.engine_speed is None:
        return "the engine is too slow"
    return f"the engine computes {behind.engine_speed:.2f} x real time"


def behind_of(behind: FellBehind) -> Behind:
    """Take what is of interest afterwards."""
    speed = behind.engine_speed if behind.engine else None
    return Behind(behind.at_s, behind.total_s, behind.engine, speed, cause_of(behind))
