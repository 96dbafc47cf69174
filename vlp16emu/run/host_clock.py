"""Clock of the host that records, which stamps the packets of a capture."""

from dataclasses import replace

from vlp16emu.elementary import exp, log
from vlp16emu.random import Purpose, normal, uniform
from vlp16emu.scenario.capture import CaptureClock
from vlp16emu.types import Packet, PacketKind
from vlp16emu.units import US_NS

_LONGEST_US = 4_500.0
"""Later than any host that keeps up: `verify` takes 5 ms for a delay of the network."""
_LANES_PER_UNIT = 8
_PLACE = {kind: place for place, kind in enumerate(PacketKind)}
_MIDDLE_PPM, _SPREAD_PPM, _AHEAD_MS = 3.0, 10.0, 3.0


def _own(section: CaptureClock, seed: int) -> CaptureClock:
    """Sample the host of one run."""
    names = "jitter_us", "late_share", "late_us"
    *drawn, rate, offset = normal(seed, Purpose.CAPTURE_HOST, 0, len(names) + 2).tolist()
    real = section.preset != "ideal"
    clock = {"ppm": real * (_MIDDLE_PPM + _SPREAD_PPM * rate), "ahead_ms": real * _AHEAD_MS * offset}
    own = {name: getattr(section, name) * exp(section.host_spread * z) for name, z in zip(names, drawn, strict=True)}
    return section.model_copy(
        update=own | {key: value for key, value in clock.items() if getattr(section, key) is None}
    )


class HostClock:
    """Stamps packets of a recording in their order.

    A stamp depends on the seed and the packet alone, unless it would precede the stamp before it.

    Parameters
    ----------
    section : of the scene
    seed : of the scene
    start_ns : UTC of the first pulse
    """

    def __init__(self, section: CaptureClock, seed: int, start_ns: int) -> None:
        self._section, self._seed, self._start_ns = _own(section, seed), seed, start_ns
        section = self._section
        self._is_ideal = not (section.ppm or section.ahead_ms or section.jitter_us or section.late_share)
        self._latest_ns = 0

    def stamped(self, packet: Packet) -> Packet:
        """Return a packet that is due when it is captured."""
        if self._is_ideal:
            return packet
        since_ns = packet.due_ns - self._start_ns
        off_ns = since_ns * 1e-6 * (self._section.ppm or 0.0) + 1e6 * (self._section.ahead_ms or 0.0)
        moved_ns = round(off_ns + self._delay_us(packet) * US_NS)
        self._latest_ns = max(self._latest_ns, packet.due_ns + moved_ns)
        return replace(packet, due_ns=self._latest_ns)

    def _delay_us(self, packet: Packet) -> float:
        """Sample the delay of a packet."""
        section, number = self._section, packet.due_ns // US_NS
        lane = packet.unit * _LANES_PER_UNIT + _PLACE[packet.kind]
        delay_us = section.jitter_us * abs(float(normal(self._seed, Purpose.CAPTURE_STAMP, number, 1, lane)[0]))
        is_late, how = uniform(self._seed, Purpose.CAPTURE_LATE, 2 * number, 2, lane).tolist()
        if is_late < section.late_share:
            delay_us += -section.late_us * log(1.0 - how)
        return min(delay_us, _LONGEST_US)
