"""The GPS receiver on the sensor's serial input and pulse line."""

from dataclasses import dataclass

from vlp16emu.types import PpsState
from vlp16emu.units import S_NS

__all__ = ["GpsInput"]


@dataclass(frozen=True, slots=True)
class GpsInput:
    """A receiver that has been locked since before the run, or none at all."""

    connected: bool
    sentence_delay_ns: int
    """From the second's edge to the arrival of the sentence that names it."""

    @property
    def pps(self) -> PpsState:
        """State of the pulse as the sensor reports it.

        Lost fixes leave it locked: that receivers keep their pulse is an assumption, and the sensor takes the time
        of sentences with status V too ("Require GPS receiver valid" off; 63-9243 Rev D, appendix G).
        """
        return PpsState.LOCKED if self.connected else PpsState.ABSENT

    @property
    def locked_spans_ns(self) -> tuple[tuple[int, int], ...]:
        """Spans of UTC in which pulse and sentences set the sensor's clock."""
        return ((-(2**62), 2**62),) if self.connected else ()

    def second_ns(self, t_ns: int) -> int | None:
        """Whole UTC second that the sentence in the sensor's buffer names at `t_ns`; None without a receiver.

        The sentence names the edge before it, so it is up to a second and the delay old
        (63-9243 Rev D, figure 7-4).
        """
        return (t_ns - self.sentence_delay_ns) // S_NS * S_NS if self.connected else None
