"""The scenario file as a frozen tree. Defaults live here and nowhere else."""

from datetime import UTC, datetime
from typing import Annotated, Literal

from pydantic import AwareDatetime, Field

from vlp16emu.scenario.motion import Motion
from vlp16emu.scenario.section import Section
from vlp16emu.scenario.sensor import Gps, Sensor
from vlp16emu.scenario.world import World
from vlp16emu.units import S_NS, US_NS

__all__ = ["Scenario"]


class Scenario(Section):
    """Everything that decides the bytes of a run."""

    schema_version: Annotated[Literal[1], Field(alias="schema")]
    """Version of this file format."""
    title: str
    """One line for people."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    """Of all randomness: same scenario and seed, same bytes."""
    start_utc: AwareDatetime = datetime(2026, 5, 20, 9, 0, tzinfo=UTC)
    """When the first pulse is fired."""
    duration_s: Annotated[float, Field(gt=0, le=7 * 86400)] = 10.0
    """How long a recording is unless the command says otherwise."""
    sensor: Sensor = Sensor()
    gps: Gps = Gps()
    motion: Motion
    world: World

    @property
    def start_ns(self) -> int:
        """UTC of the first pulse, ns since 1970."""
        since = self.start_utc.astimezone(UTC) - datetime(1970, 1, 1, tzinfo=UTC)
        return (since.days * 86400 + since.seconds) * S_NS + since.microseconds * US_NS
