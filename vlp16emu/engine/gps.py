"""The GPS receiver on the sensor's serial input and pulse line."""

from dataclasses import dataclass

from vlp16emu.packets.nmea import rmc
from vlp16emu.types import GnssFix, PpsState
from vlp16emu.units import S_NS


@dataclass(frozen=True)
class GpsInput:
    """A receiver to which the sensor has been locked since before the run, or none at all; times are UTC in ns."""

    connected: bool
    sentence_delay_ns: int
    """From the second's edge to the arrival of the sentence that names it."""

    def pps_at(self, t_ns: int) -> PpsState:  # noqa: ARG002  # the same at all times, unless events happen
        """State of the pulse as the sensor reports it.

        It stays locked while trees hide fixes: that receivers keep their pulse is an assumption.
        """
        return PpsState.LOCKED if self.connected else PpsState.ABSENT

    def second_ns(self, t_ns: int) -> int | None:
        """Return the whole UTC second that the sentence in the sensor's buffer names at `t_ns`; None if there is no sentence.

        The sentence names the edge before it, so it is up to a second and the delay old
        (63-9243 Rev D, figure 7-4).
        """
        return (t_ns - self.sentence_delay_ns) // S_NS * S_NS if self.connected else None

    def sentence(self, fix: GnssFix, seed: int) -> bytes:  # noqa: ARG002  # as above
        """Sentence of a fix as it reaches the sensor.

        Parameters
        ----------
        seed : of the unit
        """
        return rmc(fix)
