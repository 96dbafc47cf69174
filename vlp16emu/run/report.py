"""What a stream sent, how punctual it was, and why it fell behind."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from vlp16emu.engine import Unit
from vlp16emu.output import write_json
from vlp16emu.run.feed import PacketFeed
from vlp16emu.run.keeping_up import settings_that_keep_up
from vlp16emu.run.options import TruthTo
from vlp16emu.scenario import Scenario
from vlp16emu.sensor.head import Turn, turn_of
from vlp16emu.sinks import FellBehind, FirstPacket, Late, Outlet, OutletResult, StreamReport, UdpResult
from vlp16emu.types import PacketKind


@dataclass(frozen=True, slots=True)
class AuditFinding:
    """What an audit found; shares are of returns, None where nothing is known."""

    exact: bool
    """A pulse is one ray, by the scene's own choice."""
    pulses: int
    """Pulses cast again."""
    range_rmse_m: float | None
    range_rmse_low_m: float | None
    """Of the interval in which that lies with 95 % confidence, as the next."""
    range_rmse_high_m: float | None
    lost: float | None
    invented: float | None
    other_echo: float | None
    """Share whose strongest return is that of another echo."""


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
    live: Any | None = None
    """`LiveReport` of a run whose poses came in; else None."""
    gps_in: Any | None = None
    """`GpsInResult` of a real receiver; None without one."""
    gps_out: OutletResult | None = None
    """Sentences and pulses of the receiver; None unless asked for, as the next."""
    imu_out: OutletResult | None = None
    """Samples of the inertial unit."""


def summed_up(
    feed: PacketFeed,
    report: StreamReport,
    sent: Sequence[UdpResult],
    scene: str,
    to: str,
    speed: float,
    late: Late,
    *,
    audit: AuditFinding | None,
    live: Any | None = None,
    gps_in: Any | None = None,
) -> Streamed:
    """Sum up a stream.

    Parameters
    ----------
    sent : what the sinks of all units have sent
    live : where poses came in
    """
    scenario, lateness, skipped = feed.engine.scenario, report.lateness, report.skipped + feed.skipped
    units = tuple(_unit(*pair, report.simulated_s) for pair in zip(feed.engine.parts.units, sent, strict=True))
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
        gps_in=gps_in,
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


def with_outlets(streamed: Streamed, sent: Mapping[PacketKind, Outlet], skipped: Counter[PacketKind]) -> Streamed:
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
