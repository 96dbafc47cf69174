"""What a run is asked for beside its packets."""

from collections.abc import Callable, Collection
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, Self

from vlp16emu.motion.settings import Gps, Imu
from vlp16emu.sinks.sink import Outlet, PacketSink
from vlp16emu.types import PacketKind


@dataclass(frozen=True, slots=True)
class TruthTo:
    """Where the truth of a run goes, and how fine it is."""

    folder: Path
    """As `TruthFolder` wants it."""
    rate_hz: int = 200
    """Of the trajectory; samples count from the first pulse."""
    per_packet: bool = False
    """Also write the pose at the first firing of each data packet."""
    per_return: bool = False
    """Also write what is behind each record of the data packets, which must be cast for it."""

    @property
    def scenario(self) -> Path:
        """File of the scene with all its values, which can be recorded again."""
        return self.folder / "scenario.json"


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
class PosesIn:
    """Where poses of a live run come in, and what becomes of them."""

    where: str | None = None
    """`udp://HOST:PORT`, of this machine; None where `Emulator.put_pose` alone brings them."""
    flown: Path | None = None
    """File for what is flown, which repeats the run as `motion.flown`; overwritten if it exists."""
    news: Callable[[str], None] = lambda _: None
    """Called with a line when poses are waited for, lost, or back."""


class Outlets(Protocol):
    """What leaves beside the packets of the sensors, such as sentences, pulses and inertial samples."""

    @property
    def kinds(self) -> Collection[PacketKind]:
        """Kinds of packets to make."""

    def look_ahead(self, imu: Imu | None) -> int:
        """Packets that a stream computes further ahead, because of those between the packets of the sensors."""

    def opened(self, imu: Imu | None) -> AbstractContextManager[dict[PacketKind, Outlet]]:
        """Open the ways that packets of each kind take."""


class ClockReader(Protocol):
    """A receiver that is listened to, and sets the clock of the sensors; a context manager."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *raised: object) -> None: ...

    def sink(self, way: PacketSink) -> PacketSink:
        """Return a sink that stamps packets anew before they take their way."""

    @property
    def result(self) -> Any:
        """What was heard."""


class ClockInput(Protocol):
    """Where a receiver is wired to the sensors."""

    def reader(self, gps: Gps, powered_for_s: float) -> ClockReader:
        """Open it for sensors that have had power for some time."""
