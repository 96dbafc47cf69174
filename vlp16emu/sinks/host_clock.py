"""The `[capture]` table: when the host that records packets takes them to have come."""

from dataclasses import replace
from typing import Annotated, Literal

from pydantic import Field

from vlp16emu.settings import Preset
from vlp16emu.types import Packet
from vlp16emu.units import US_NS

_LONGEST_US = 4_500.0
"""Later than any host that keeps up: `verify` takes 5 ms for a delay of the network."""
_LANES_PER_UNIT = 8
_PRESETS: dict[str, dict[str, object]] = {
    "ideal": {},
    # On mrpt and nebula half of all stamps are within 1 us of an even spacing, and 6 % of nebula's are 10 to 230 us late.
    "quiet_pc": {"ppm": 6.0, "jitter_us": 1.3, "late_share": 0.06, "late_us": 60.0, "host_spread": 0.4},
    # Up to 640 us were seen; the law of it is an assumption.
    "busy_pc": {"ppm": 6.0, "jitter_us": 40.0, "late_share": 0.04, "late_us": 1500.0, "host_spread": 0.4},
}


class CaptureClock(Preset):
    """The clock of the host that records; only stamps of pcap files follow it."""

    presets = _PRESETS

    preset: Literal["ideal", "quiet_pc", "busy_pc"] = "quiet_pc"
    """Values of the keys that are not given beside it; `ideal` stamps packets when they are due."""
    ppm: Annotated[float, Field(ge=-100, le=100)] = 0.0
    """How much the host's clock is fast against the sensor's; -8 to 17 in captures of real units."""
    jitter_us: Annotated[float, Field(ge=0, le=500)] = 0.0
    """Delay of a stamp, one sigma of the normal law whose absolute value it has."""
    late_share: Annotated[float, Field(ge=0, le=0.5)] = 0.0
    """Share of packets that the host is late with; those behind them come in a burst."""
    late_us: Annotated[float, Field(ge=0, le=3000)] = 0.0
    """Mean of that delay, exponential, up to 4.5 ms."""
    host_spread: Annotated[float, Field(ge=0, le=1)] = 0.0
    """By how much a host's own jitter, share and delay differ from these, one sigma of the logarithm; it is drawn from the
    seed. 0 for exactly these."""


def _own(section: CaptureClock, seed: int) -> CaptureClock:
    """Draw the host of a run."""
    if not section.host_spread:
        return section
    from vlp16emu.elementary import exp  # here: a scene is read without numba
    from vlp16emu.random import Purpose, normal

    names = "jitter_us", "late_share", "late_us"
    drawn = normal(seed, Purpose.CAPTURE_HOST, 0, len(names))
    own = {
        name: getattr(section, name) * exp(float(section.host_spread * z))
        for name, z in zip(names, drawn, strict=True)
    }
    return section.model_copy(update=own)


class HostClock:
    """Stamps the packets of a recording, in their order.

    A stamp follows from the seed and the packet alone, but where it would be before the one in front of it.

    Parameters
    ----------
    section : of the scene
    seed : of the scene
    start_ns : UTC of the first pulse, at which both clocks agree
    """

    def __init__(self, section: CaptureClock, seed: int, start_ns: int) -> None:
        self._section, self._seed, self._start_ns = _own(section, seed), seed, start_ns
        self._is_ideal = not (section.ppm or section.jitter_us or section.late_share)
        self._latest_ns = 0

    def stamped(self, packet: Packet) -> Packet:
        """Give a packet the instant at which it is captured instead of that at which it is due."""
        if self._is_ideal:
            return packet
        since_ns = packet.due_ns - self._start_ns
        moved_ns = round(since_ns * self._section.ppm * 1e-6 + self._delay_us(packet) * US_NS)
        self._latest_ns = max(self._latest_ns, packet.due_ns + moved_ns)
        return replace(packet, due_ns=self._latest_ns)

    def _delay_us(self, packet: Packet) -> float:
        """Draw by how much a packet is late."""
        from vlp16emu.elementary import log  # here: a scene is read without numba
        from vlp16emu.random import Purpose, normal, uniform

        section, number = self._section, packet.due_ns // US_NS
        lane = packet.unit * _LANES_PER_UNIT + list(type(packet.kind)).index(packet.kind)
        delay_us = section.jitter_us * abs(
            float(normal(self._seed, Purpose.CAPTURE_STAMP, number, 1, lane)[0])
        )
        is_late, how = (
            float(uniform(self._seed, Purpose.CAPTURE_LATE, 2 * number + i, 1, lane)[0]) for i in (0, 1)
        )
        if is_late < section.late_share:
            delay_us += -section.late_us * log(1.0 - how)
        return min(delay_us, _LONGEST_US)
