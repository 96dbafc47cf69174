"""Results of runs: packets sent, their timing, and the estimated error."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, Self

from vlp16emu.engine import Unit
from vlp16emu.run.stream import StreamReport
from vlp16emu.scenario import Scenario
from vlp16emu.sensor.head import Head
from vlp16emu.sensor.settings import require_packets
from vlp16emu.types import PacketKind
from vlp16emu.units import S_NS, seconds_to_ns


class AuditResult(Protocol):
    """Error of a run, estimated from pulses that were cast again."""

    @property
    def exact(self) -> bool:
        """True if no sub-rays were drawn, so that only rounding is left."""


@dataclass(frozen=True, slots=True)
class About:
    """The scene of a run, with its active models in words."""

    scene: str  # Name, path or title
    seed: int
    beam: str
    noise: str
    weather: str | None  # None for clear air

    @classmethod
    def of(cls, name: str, scenario: Scenario) -> Self:
        """Describe a scenario."""
        noise = scenario.noise.of_model(scenario.sensor.unit_noise)
        return cls(name, scenario.seed, scenario.beam.summary, noise.summary, scenario.weather.summary)


@dataclass(frozen=True, slots=True)
class Turn:
    """Rotation of a sensor over a run."""

    rpm: float  # mean of the set speed over the run; the next two fields refer to it
    azimuth_step_deg: float  # angle from one firing sequence to the next
    sequences_per_revolution: float
    revolutions: float
    azimuth_steps: int  # whole firing sequences


def turn_of(head: Head, start_s: float, stop_s: float) -> Turn:
    """Return the rotation of a head over a span of a run, in seconds since the first pulse."""
    start_ns = seconds_to_ns(start_s)
    stop_ns = seconds_to_ns(stop_s)
    sequences_per_s = S_NS / head.beams.sequence_ns
    revolutions = head.rotor.revolutions(stop_ns) - head.rotor.revolutions(start_ns)
    rpm = head.rotor.rpm
    if len(head.rotor.spins) > 1 and stop_ns > start_ns:
        rpm = revolutions * 60 * S_NS / (stop_ns - start_ns)
    return Turn(
        rpm=rpm,
        azimuth_step_deg=6 * rpm / sequences_per_s,
        sequences_per_revolution=sequences_per_s * 60 / rpm if rpm else math.inf,
        revolutions=revolutions,
        azimuth_steps=(stop_ns - start_ns) // head.beams.sequence_ns,
    )


@dataclass(frozen=True, slots=True)
class UnitSent:
    """Packets sent by one sensor, and its revolutions."""

    unit: int  # From 1
    name: str
    address: str
    data_port: int
    position_port: int
    packets: int  # Data packets
    position_packets: int
    returns: int | None = None  # None if not counted, as in a stream
    turn: Turn | None = None  # None for a capture

    @classmethod
    def of(
        cls,
        unit: Unit,
        sent: Mapping[PacketKind, int],
        span_s: tuple[float, float],
        returns: int | None = None,
    ) -> Self:
        """Describe the packets sent by a sensor of a scene in a span, by kind."""
        sensor = require_packets(unit.section)
        turn = turn_of(unit.head, *span_s)
        where = sensor.name, sensor.address, sensor.data_port, sensor.position_port
        return cls(unit.number + 1, *where, sent[PacketKind.DATA], sent[PacketKind.POSITION], returns, turn)


class OfUnits:
    """Sums over the sensors of a result."""

    __slots__ = ()
    units: tuple[UnitSent, ...]

    @property
    def packets(self) -> int:
        """Data packets of all sensors."""
        return sum(unit.packets for unit in self.units)

    @property
    def position_packets(self) -> int:
        """Position packets of all sensors."""
        return sum(unit.position_packets for unit in self.units)


@dataclass(frozen=True, slots=True)
class Recording(OfUnits):
    """Result of a recording: its content, and its cost."""

    file: str
    about: About
    units: tuple[UnitSent, ...]
    bytes: int
    sha256: str  # Of the whole file; for several files, in their order
    simulated_s: float
    walk_share: float | None  # Share of the whole motion, in time; None for an endless motion
    wall_s: float
    audit: AuditResult | None  # `AuditFinding` of `extras.accuracy.audit`; None without an audit
    interrupted: bool  # True if the stop event ended it
    messages: Mapping[str, int] | None  # Messages of a bag by topic; None for a capture

    @property
    def returns(self) -> int:
        """Returns of all sensors."""
        return sum(unit.returns or 0 for unit in self.units)

    @property
    def real_time_factor(self) -> float:
        """Simulated seconds per second."""
        return self.simulated_s / self.wall_s


@dataclass(frozen=True, slots=True)
class Streamed(OfUnits):
    """Result of a stream: packets sent, and their punctuality."""

    about: About
    to: str
    speed: float  # Requested simulated seconds per second
    late: str  # Treatment of late packets, `pace` or `skip`
    units: tuple[UnitSent, ...]
    sent: StreamReport
    """Send times; `moved_s` is the offset from scene time, used by the ground truth, to stamps and
    sentences."""
    keeps_up_with: tuple[str, ...]
    """Options of `vlp16emu stream` that would let the engine keep up, each sufficient alone."""
    audit: AuditResult | None  # `AuditFinding` of `extras.accuracy.audit`; None without an audit
    live: object  # `LiveReport` of a run whose poses came in; else None
    gps_in: object  # `GpsInResult` of a real receiver; None without one
    gps_out: object  # `OutletResult` of the sentences and pulses of the receiver; None unless asked for
    imu_out: object  # `OutletResult` of the samples of the inertial unit; None unless asked for

    @property
    def interrupted(self) -> bool:
        """True if the stop event or Ctrl-C ended it."""
        return self.sent.interrupted
