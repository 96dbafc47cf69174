"""What leaves beside the packets of the sensors: sentences and pulses of the GPS receiver, samples of the inertial unit."""

import heapq
from collections.abc import Callable, Collection, Iterator
from functools import partial
from operator import itemgetter

from vlp16emu.engine import Engine
from vlp16emu.errors import ScenarioError
from vlp16emu.extras.bench.imu_frame import imu_frames
from vlp16emu.motion.imu import ImuSampler
from vlp16emu.packets import rmc
from vlp16emu.types import Packet, PacketKind
from vlp16emu.units import MS_NS, S_NS

PULSE_NS = 100 * MS_NS
"""Length of a pulse: the sensor wants 20 to 200 ms (User's Manual of the HDL-32E)."""
PULSE_HIGH, PULSE_LOW = b"\1", b"\0"
_READS_PER_S = 50
"""How often samples are read: those of 20 ms together, and none of a time long to come, in which live poses are unknown."""

_Beat = tuple[int, Packet | Callable[[], Packet]]
"""When a packet is due, and the packet or what makes it."""


class Beside:
    """Packets of kinds NMEA, PPS and IMU, made in the order of a run and not before their time.

    Raises `ScenarioError` if the scene has no such device.
    """

    def __init__(self, engine: Engine, kinds: Collection[PacketKind]) -> None:
        scenario, parts = engine.scenario, engine.parts
        if not scenario.gps.connected and not {PacketKind.NMEA, PacketKind.PPS}.isdisjoint(kinds):
            raise ScenarioError("gps.connected", "found false", "true, for a receiver to be played")
        if scenario.imu is None and PacketKind.IMU in kinds:
            raise ScenarioError("imu", "no such table in the scene", "[imu], such as imu.preset=consumer")
        self._start_ns, self._delay_ns = scenario.start_ns, parts.gps.sentence_delay_ns
        self._receiver, self._imu, self._kinds = engine.receiver, parts.imu, kinds
        self._rate_hz = scenario.imu.rate_hz if scenario.imu else 0

    def among(self, packets: Iterator[Packet], start_ns: int, stop_ns: int) -> Iterator[Packet]:
        """Merge the packets of a span since the first pulse with what is due beside them; of those due at once, packets are first."""
        if not self._kinds:
            return packets
        made = {PacketKind.NMEA: self._sentences, PacketKind.PPS: self._pulses, PacketKind.IMU: self._samples}
        streams = [made[kind](self._numbers(kind, start_ns, stop_ns)) for kind in self._kinds]
        others = ((packet.due_ns, packet) for packet in packets)
        beats = heapq.merge(others, *streams, key=itemgetter(0))
        return (what if isinstance(what, Packet) else what() for _, what in beats)

    def count(self, start_ns: int, stop_ns: int) -> dict[PacketKind, int]:
        """Count what is due in a span since the first pulse, by kind."""
        return {kind: len(self._numbers(kind, start_ns, stop_ns)) for kind in self._kinds}

    def _numbers(self, kind: PacketKind, start_ns: int, stop_ns: int) -> range:
        """Numbers of what is due in a span: UTC seconds, ends of pulses counted from 1970 as two a second, or samples."""
        if kind is PacketKind.IMU:
            return range(*(-(-since_ns * self._rate_hz // S_NS) for since_ns in (start_ns, stop_ns)))
        span_ns = [self._start_ns + since_ns for since_ns in (start_ns, stop_ns)]
        if kind is PacketKind.NMEA:
            return range(*(-(-(utc_ns - self._delay_ns) // S_NS) for utc_ns in span_ns))
        return range(*(-(-utc_ns // S_NS) + -(-(utc_ns - PULSE_NS) // S_NS) for utc_ns in span_ns))

    def _sentences(self, seconds: range) -> Iterator[_Beat]:
        """Yield sentences, each as long after its second as the sensor gets it."""

        def sentence(second_ns: int) -> Packet:
            return Packet(PacketKind.NMEA, second_ns + self._delay_ns, rmc(self._receiver.fix(second_ns)))

        for second in seconds:
            yield second * S_NS + self._delay_ns, partial(sentence, second * S_NS)

    def _pulses(self, numbers: range) -> Iterator[_Beat]:
        for number in numbers:
            second, is_end = divmod(number, 2)
            due_ns, level = second * S_NS + is_end * PULSE_NS, (PULSE_HIGH, PULSE_LOW)[is_end]
            yield due_ns, Packet(PacketKind.PPS, due_ns, level)

    def _samples(self, numbers: range) -> Iterator[_Beat]:
        imu, ready = self._imu, dict[int, Packet]()
        assert isinstance(imu, ImuSampler)

        def sample(number: int) -> Packet:
            """Read those of 20 ms at once."""
            if number not in ready:
                ready.clear()
                count = min(max(self._rate_hz // _READS_PER_S, 1), numbers.stop - number)
                read = imu.read(number, count)
                stamps_ns = read.t_ns if read.stamp_ns is None else read.stamp_ns
                frames = imu_frames(number, stamps_ns, read.angular_rate_rad_s, read.specific_force_m_s2)
                for at, (due_ns, frame) in enumerate(zip(stamps_ns.tolist(), frames, strict=True), number):
                    ready[at] = Packet(PacketKind.IMU, due_ns, frame)
            return ready[number]

        for number in numbers:
            due_ns = self._start_ns + number * S_NS // self._rate_hz + int(imu.late_ns(number, 1)[0])
            yield due_ns, partial(sample, number)
