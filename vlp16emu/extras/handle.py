"""A running stream as an object: ports, sent packets, point clouds, ground truth, settings and faults."""

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from threading import Condition, Thread
from typing import Self, Unpack

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import InputError, RunError
from vlp16emu.extras.clouds.scan import Chunk, chunk_of_packets, cut_scans
from vlp16emu.extras.truth.slots import SLOT
from vlp16emu.hosts import LOOPBACK, url_of
from vlp16emu.packets.layout import DATA_PAYLOAD
from vlp16emu.run.emulator import TRUTH_OF_RECORDS, Emulator, Scene
from vlp16emu.run.options import Http, LiveKeys, StreamOptions
from vlp16emu.run.part import StreamPart
from vlp16emu.run.report import Streamed
from vlp16emu.run.scene_stream import SceneStream
from vlp16emu.sinks import LOOK_AHEAD_PACKETS
from vlp16emu.types import Packet, PacketKind, Scan
from vlp16emu.units import S_NS

_HELD = 2048
"""Sent packets kept per sensor and kind: 2.7 s of single return, 50 MB with ground truth."""
_AT_ONCE = 16  # packets that are decoded at once for scans, 21 ms
RECORD_TRUTH = np.dtype([*SLOT.descr, ("world_T_sensor", "<f8", (4, 4))])
"""Ground truth of one record of a data packet, with the pose of its sensor at the instant of the pulse."""


def stream(
    scene: Scene,
    settings: Mapping[str, object] | Sequence[str] = (),
    *,
    ideal: bool = False,
    threads: int = 0,
    truth: bool = True,
    look_ahead: int = LOOK_AHEAD_PACKETS,
    **options: Unpack[LiveKeys],
) -> "Live":
    """Start to stream a scene over UDP, and return when the first data packet is sent.

    Raises the errors of `Emulator.stream`.

    Parameters
    ----------
    scene, settings, ideal, threads : as in `Emulator`
    truth : provide labels of scans and `Live.truth`; takes a third more computing time
    look_ahead, options : as in `Live`

    Examples
    --------
    >>> import vlp16emu
    >>> with vlp16emu.stream("static_bench") as live:
    ...     scan = next(live.scans())
    >>> scan.labels.semantic.shape == scan.t_ns.shape
    True
    """
    emulator = Emulator(scene, settings, ideal=ideal, threads=threads)
    return Live(emulator, truth=truth, look_ahead=look_ahead, **options)


class _Lane:
    """Sent packets of one sensor and kind."""

    def __init__(self) -> None:
        self.held = deque[Packet](maxlen=_HELD)
        self.leaving: Packet | None = None  # a receiver may have it before it counts as sent
        self.count = self.taken = 0
        self.wake_at: float = np.inf  # count at which the waiting threads wake up

    def since(self, number: int) -> list[Packet]:
        """Return the packets from a number on, as far as they are held."""
        return list(islice(self.held, max(number - self.count + len(self.held), 0), None))


class Live(StreamPart):
    """A running stream with a thread of its own; a context manager that stops it.

    Its errors are raised by the method that waits for packets, by `stop`, or at the end of the `with` block.

    Parameters
    ----------
    emulator : the scene
    truth : keep the ground truth of packets
    look_ahead : packets per sensor that are computed before the first one is sent
    options : fields of `StreamOptions`. By default packets go to free ports of this machine (None: ports of
        the scene), and the web interface listens on another free port (None: no web interface)
    """

    def __init__(
        self,
        emulator: Emulator,
        *,
        truth: bool = True,
        look_ahead: int = LOOK_AHEAD_PACKETS,
        **options: Unpack[LiveKeys],
    ) -> None:
        if truth:
            emulator = emulator.with_engine(replace(emulator.engine, truth_of=TRUTH_OF_RECORDS.load()))
        options.setdefault("http", Http(f"{LOOPBACK}:0"))
        options.setdefault("position_port", 0)
        if ":" not in (options.get("to") or ""):
            options.setdefault("data_port", 0)
        self._stream = SceneStream(emulator, StreamOptions.from_fields(options), look_ahead=look_ahead)
        self._stream.add(self)
        self.ports = [(link.data_port, link.position_port) for link in self._stream.links]
        """Ports of data and position packets of each sensor."""
        self._units = self._stream.emulator.parts.units
        self._lanes = {(unit.number, kind): _Lane() for unit in self._units for kind in PacketKind}
        self._changed = Condition()
        self._over = False
        self._error: BaseException | None = None
        self._has_raised = False
        self._not_before_ns = 0
        self._thread = Thread(target=self._work, name="vlp16emu stream", daemon=True)
        self._thread.start()
        try:
            with self._changed:
                self._wait(self._lanes[0, PacketKind.DATA], lambda: 1)
            self._raise()
        except BaseException:
            self._end()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        self._end()
        if not any(raised) and not self._has_raised:
            self._raise()

    @property
    def data_port(self) -> int:
        """Destination port of the data packets of the first sensor."""
        return self.ports[0][0]

    @property
    def position_port(self) -> int:
        """Destination port of the position packets of the first sensor."""
        return self.ports[0][1]

    @property
    def http(self) -> str | None:
        """URL of the web interface of the first sensor; None without one."""
        web = self._stream.web
        return url_of(*web.places[0]) if web and web.places else None

    def stop(self) -> Streamed:
        """End the stream and return its report, or raise its error. A second call returns the same report."""
        self._end()
        self._raise()
        return self._result

    def packets(
        self, count: int, *, unit: int = 1, kind: str = "data", timeout_s: float = 30.0
    ) -> list[bytes]:
        """Wait for `count` sent packets and return their payloads in order of sending.

        No packet is returned twice.

        Only the last 2048 packets are kept. After `set` and `fault` the packets are those that the change
        affects.

        Raises InputError if there is no such unit or kind (data or position), or `count` is above 2048;
        RunError if the stream ends, or `timeout_s` passes, before they are sent; errors of the stream.
        """
        lane = self._lane(unit, kind)
        if not 1 <= count <= _HELD:
            raise InputError("packets", f"found {count}", f"1 to {_HELD}")
        with self._changed:
            self._wait(lane, lambda: self._next_of(lane) + count, timeout_s)
            lane.taken = self._next_of(lane)
            is_over = self._over
            found = [packet.payload for packet in lane.since(lane.taken)[:count]]
            if len(found) == count:
                lane.taken += count
                return found
        self._raise()
        when = "before the stream ended" if is_over else f"within {timeout_s:g} s"
        raise RunError(f"{len(found)} of {count} packets have left {when}")

    def truth(self, payload: bytes, *, unit: int = 1) -> NDArray[np.void]:
        """Return the ground truth of a sent data packet, found by its time stamp: `RECORD_TRUTH` (384,).

        Row 32 b + c is record c of block b. `range_m`, `sensor_m` (3), `world_m` (3), `semantic`, `part`,
        `instance` and `species` describe the surface of the return; `echo` is 0 for the strongest, 1 for the
        last, 2 for the second strongest return and 255 for none; `t_ns` and `world_T_sensor` (4, 4) belong to
        the pulse.

        Raises InputError if none of the sensor's last 2048 packets has the stamp, or the stream has no truth.
        """
        lane = self._lane(unit, "data")
        stamp = _stamp(payload)
        with self._changed:
            known = [*lane.held, *filter(None, [lane.leaving])]
        slots = next((packet.slots for packet in reversed(known) if _stamp(packet.payload) == stamp), None)
        if slots is None:
            expected = f"one of the last {len(known)} of unit {unit}, in a stream with truth"
            raise InputError("packet", "found no truth of its time stamp", expected)
        rows = np.zeros(len(slots), RECORD_TRUTH)
        for name in SLOT.names or ():
            rows[name] = slots[name]
        rows["world_T_sensor"] = self._units[unit - 1].world_T_sensor(rows["t_ns"])
        return rows

    def scans(self, *, unit: int = 1) -> Iterator[Scan]:
        """Yield whole revolutions of a sensor, until the stream ends.

        They are decoded from its packets as they are sent.

        Scans have labels if the stream has truth; their times are times of the scene. A reader that is more
        than 2048 packets behind goes on with the newest packet. Incomplete and corrupt data packets are
        skipped.

        Raises InputError if there is no such unit; errors of the stream.
        """
        lane = self._lane(unit, "data")
        sensor = self._units[unit - 1]
        return cut_scans(self._chunks(lane), lambda t_ns: sensor.world_T_sensor(np.array([t_ns]))[0])

    def set(self, *, unit: int = 1, **settings: object) -> None:
        """Change settings of a sensor as its web interface does: keys of the event `setting`.

        Errors are those of `fault`.
        """
        self.fault("setting", unit=unit, **settings)

    def fault(self, kind: str, *, unit: int = 1, **keys: object) -> None:
        """Inject an event of `[[events]]` into a sensor.

        Returns when the packets that it affects are sent.

        Parameters
        ----------
        kind : kind of the event, for instance drop, reorder, corrupt, pps_loss or power_cycle
        keys : keys of that event, for instance `count=1` or `duration_s=0.5`

        Raises InputError if there is no such event, the scene does not allow it, or the stream has no web
        interface.
        """
        stream = self._stream
        if stream.web is None:
            raise InputError(kind, "found http = None", "a stream with web interface, which sets sensors")
        at_ns = stream.web.happen(kind, unit, **keys)
        with self._changed:
            self._not_before_ns = at_ns
        while (left_ns := at_ns - stream.due_in_ns(0)) > 0 and not self._over:
            stream.stop.wait(max(left_ns / S_NS / stream.pacer.speed, 0.001))

    def leaving(self, packet: Packet) -> Packet:
        """Keep a packet that a receiver may have before it counts as sent; called by the stream."""
        self._lanes[packet.unit, packet.kind].leaving = packet
        return packet

    def sent(self, packet: Packet) -> None:
        """Keep a packet, and wake the threads that wait for it; called by the stream."""
        lane = self._lanes[packet.unit, packet.kind]
        with self._changed:
            lane.held.append(packet)
            lane.count += 1
            if lane.count >= lane.wake_at:
                lane.wake_at = np.inf
                self._changed.notify_all()

    def _work(self) -> None:
        try:
            self._stream.run()
            self._result = self._stream.result
        except BaseException as error:  # noqa: BLE001  # belongs to the thread that waits, which raises it
            self._error = error
        with self._changed:
            self._over = True
            self._changed.notify_all()

    def _end(self) -> None:
        self._stream.stop.set()
        self._thread.join()

    def _raise(self) -> None:
        if self._error is not None:
            self._has_raised = True
            raise self._error

    def _lane(self, unit: int, kind: str) -> _Lane:
        if kind not in ("data", "position"):
            raise InputError("kind", f"found {kind}", "data or position")
        return self._lanes[self._stream.emulator.number(unit), PacketKind(kind)]

    def _next_of(self, lane: _Lane) -> int:
        """Return the number of the next packet to take: still kept, and not due before the last change."""
        first = max(lane.taken, lane.count - len(lane.held))
        return first + sum(packet.due_ns < self._not_before_ns for packet in lane.since(first))

    def _wait(self, lane: _Lane, count: Callable[[], int], timeout_s: float | None = None) -> None:
        """Wait until `count()` packets are sent, the stream ends, or the timeout passes.

        The caller holds the lock.
        """

        def is_there() -> bool:
            """Return True once there are as many as are waited for, or none come any more."""
            wanted = count()
            lane.wake_at = min(lane.wake_at, wanted)
            return lane.count >= wanted or self._over

        self._changed.wait_for(is_there, timeout_s)

    def _chunks(self, lane: _Lane) -> Iterator[Chunk]:
        """Yield the points of packets as they are sent.

        Packets that are no longer kept leave a jump of the clock.
        """
        number = 0
        is_over = False
        while not is_over:
            with self._changed:
                self._wait(lane, lambda wanted=number + _AT_ONCE: wanted)  # type: ignore[misc]
                is_late = number < lane.count - len(lane.held)
                packets = [] if is_late else lane.since(number)
                number = lane.count
                is_over = self._over
            if (chunk := chunk_of_packets(packets)) is not None:
                yield chunk
        self._raise()


def _stamp(payload: bytes) -> bytes:
    """Return the four bytes of the time stamp; the whole payload if it is too short."""
    at = DATA_PAYLOAD.fields["timestamp_us"][1]  # type: ignore[index]  # it has fields
    return payload[at : at + 4] or payload
