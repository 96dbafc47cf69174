"""Live runs: pose port, report, and the table of knots that repeats a run."""

import select
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from vlp16emu.engine.engine import make_receiver
from vlp16emu.engine.windows import STEP_NS
from vlp16emu.errors import InputError
from vlp16emu.extras.live.flown import FLOWN_HEADER, flown_rows
from vlp16emu.extras.live.motion import LOST_NS, LiveMotion, PosesLost
from vlp16emu.extras.live.pose_packet import POSE_BYTES, is_pose, unpack_pose
from vlp16emu.extras.live.sky import SkyAhead
from vlp16emu.extras.live.windows import LiveWindows
from vlp16emu.hosts import bound, host_and_port
from vlp16emu.output import OutputFile, spare
from vlp16emu.run.options import PosesIn
from vlp16emu.run.part import PosePart
from vlp16emu.run.scene_stream import SceneStream
from vlp16emu.sinks import LatenessHistogram
from vlp16emu.sinks.pacing import settle_memory
from vlp16emu.types import Packet
from vlp16emu.units import S_NS, seconds_to_ns

_LISTEN_S = 0.1  # how often the thread checks if it shall end
_MERGED_S = 0.002  # poses that come within this time count as one; knots are 2.7 ms apart
_MOST = 1000  # datagrams that are read before a pose is passed on
_EXPECTED = "udp://HOST:PORT, for instance udp://127.0.0.1:7000"


class PoseReceiver:
    """Receiver of pose datagrams on a thread of its own; a context manager.

    Parameters
    ----------
    where : udp://HOST:PORT; port 0 is any free one
    put : takes position, quaternion and time of a pose, and raises `InputError` if they are not valid

    Raises InputError if `where` is no address and port; OutputError if the port cannot be opened.
    """

    def __init__(
        self, where: str, put: Callable[[Sequence[float], Sequence[float], int | None], object]
    ) -> None:
        place = host_and_port(where, "--pose-in", _EXPECTED, "udp://")
        self._put = put
        self._over = threading.Event()
        self.malformed = 0  # datagrams that are not pose packets
        self._socket = bound(socket.SOCK_DGRAM, *place, where)
        self._socket.setblocking(False)
        host, port = self._socket.getsockname()
        self.where = f"udp://{host}:{port}"  # address and port of the socket
        self._thread = threading.Thread(target=self._run, name="poses", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        self._socket.close()

    def _run(self) -> None:
        """Pass on poses until closed; of several waiting poses only the last, so a flood costs little."""
        while not self._over.is_set():
            if not select.select([self._socket], [], [], _LISTEN_S)[0]:
                continue
            last = None
            with suppress(BlockingIOError):
                for _ in range(_MOST):
                    payload = self._socket.recv(POSE_BYTES + 1)
                    if is_pose(payload):
                        last = payload
                    else:
                        self.malformed += 1
            if last is not None:
                with suppress(InputError):  # `put` counts invalid poses
                    self._put(*unpack_pose(last))
            self._over.wait(_MERGED_S)


_POLL_S = 0.05  # how often a run that waits for the first pose checks if it shall end
_START_NS = 40_000_000
"""Time from the end of preparation to the first pulse, in which threads start and the sky is cast."""
_LEAD_NS = 20_000_000
_MOST_WINDOWS = 6
"""Windows that are opened in turn before the first pulse, for the start and the next seconds of the body;
poses that jump to and fro would ask for others without end, and the run begins with steps left out
instead."""
_SAID_S = 4.0  # how often a line says that windows are being opened
_WARM_S = 0.02  # span that is computed before the run, so that kernels are loaded and compiled
_ROWS_NS = S_NS  # how often knots are written


@dataclass(frozen=True, slots=True)
class LiveReport:
    """Poses received, and the latency of the packets that followed."""

    poses: int
    refused: int  # malformed, or without a valid rotation
    out_of_order: int  # not later than the pose before
    longest_gap_s: float  # between arrivals
    lost: tuple[PosesLost, ...]  # times without a pose for more than a second
    left_out_s: float
    """Time of the run, summed over units, whose pulses were not cast because the engine was late."""
    latency_median_us: float
    """Time from the arrival of a pose to the first data packet that was computed with it, like the next
    fields."""
    latency_p95_us: float
    latency_p99_us: float
    latency_max_us: float
    flown: str | None  # path of the table of knots, if one is written


class Flight(PosePart):
    """A live run: the part of a stream that takes poses, starts its clock, and measures latency.

    Parameters
    ----------
    stream : stream of a live scene, with options for its poses
    clock_ns : monotonic clock

    Raises InputError if the scene is not live, or the speed is not 1; OutputError if the table cannot be
    written, or would be written over a file that is read; and the errors of `PoseReceiver`.
    """

    look_ahead = 8
    """Packets of a unit that are computed before the first leaves: two steps, or one of dual return."""
    lead_ns = _LEAD_NS
    """Time ahead of now from which an engine that is too slow goes on: nothing is computed further ahead."""

    result: LiveReport | None = None

    def __init__(self, stream: SceneStream, *, clock_ns: Callable[[], int] = time.monotonic_ns) -> None:
        engine = stream.emulator.engine
        poses = stream.options.poses or PosesIn()
        motion = engine.parts.carrier
        windows = engine.windows
        if not isinstance(motion, LiveMotion):
            option = "--flown" if poses.where is None else "--pose-in"
            found = f'found motion.kind = "{engine.scenario.motion.kind}"'
            raise InputError(option, found, 'motion.kind = "live", without motion.flown')
        assert isinstance(windows, LiveWindows)
        if stream.pacer.speed != 1.0:
            raise InputError("--speed", f"found {stream.pacer.speed:g}", "1 in a live scene")
        if poses.flown is not None:
            spare(stream.emulator.files, poses.flown)
        self._stream = stream
        self._engine = engine
        self._motion = motion
        self._windows = windows
        self._clock_ns = clock_ns
        self._latency = LatenessHistogram()
        self._lost_ns: int | None = None
        self._refusal_said = False
        self._written = 0
        self._write_at_ns = 0
        self._flown = poses.flown
        with ExitStack() as stack:
            self._file = stack.enter_context(OutputFile(poses.flown)) if poses.flown else None
            receiver = PoseReceiver(poses.where, motion.poses.put) if poses.where else None
            self._receiver = stack.enter_context(receiver) if receiver else None
            self._open = stack.pop_all()
        motion.is_open = True

    def end(self, error: BaseException | None) -> None:
        """Sum up, complete the table, and end the motion."""
        with self._open:
            if error is None:
                self.result = self._report()
            if self._file and self._motion.knots:
                with self._file.writing():
                    self._write()
        self._motion.end()

    def begin(self) -> None:
        """Wait for the first pose or a stop, open the world around it, and start the clock."""
        stop = self._stream.stop
        self._stream.say(f"waiting for poses{f' on {self._receiver.where}' if self._receiver else ''}")
        while not self._motion.poses.came.wait(_POLL_S):
            self._say_refusal()
            if stop.is_set():
                return
        with suppress(CancelledError):
            self._prepare()
        settle_memory()
        self._start_clock()

    def _prepare(self) -> None:
        """Open the world around the body and where it is heading, and load kernels."""
        stop = self._stream.stop
        began_s = said_s = time.monotonic()
        self._stream.say("opens the world around the first pose")
        for round_ in range(2):
            for _ in range(_MOST_WINDOWS):
                window = self._windows.missing()  # the body moves on meanwhile
                if window is None or stop.is_set():
                    break
                while not window.done() and not stop.wait(_POLL_S):
                    if time.monotonic() - said_s > _SAID_S:
                        said_s = time.monotonic()
                        self._stream.say(f"opens the world: {said_s - began_s:.0f} s")
            if round_ == 0:
                # With a receiver of its own: this one sees a body that does not move yet.
                receiver = make_receiver(self._engine.scenario, self._engine.parts, self._engine.windows)
                deque(replace(self._engine, receiver=receiver).packets(0.0, _WARM_S), 0)

    def _say_refusal(self) -> None:
        """Say once why poses are refused; the report counts them."""
        refusal = self._motion.poses.refusal
        if refusal and not self._refusal_said:
            self._refusal_said = True
            self._stream.say(f"left out: {refusal}")

    def _start_clock(self) -> None:
        """Fire the first pulse in a moment, and let packets leave by the same clock.

        With `now` it is fired where the clock of the system has the fraction of a second that the scene
        begins with.
        """
        start_ns = self._engine.scenario.start_ns
        in_ns = _START_NS
        if self._stream.options.now:
            in_ns += (start_ns - time.time_ns() - in_ns) % S_NS
        self._windows.openers.begin()
        self._motion.begin(self._clock_ns() + in_ns)
        self._stream.pacer.begin(start_ns, -in_ns)
        self._open.enter_context(SkyAhead(self._engine, self._motion))

    def sent(self, packet: Packet) -> None:
        """Record the latency of a packet, say if poses are lost or back, and write knots that are settled."""
        now_ns = self._clock_ns()
        self._say_refusal()
        uses = self._motion.first_uses
        if packet.fired_ns is not None:
            while uses and uses[0][0] <= packet.fired_ns:
                self._latency.add(now_ns - uses.popleft()[1])
        if (last := self._motion.poses.last) is not None:
            if self._lost_ns is None and now_ns - last.arrived_ns > LOST_NS:
                self._lost_ns = last.arrived_ns
                since_s = self._motion.since_s(last.arrived_ns)
                self._stream.say(f"poses lost: none since {since_s:.1f} s; the body comes to rest")
            elif self._lost_ns is not None and last.arrived_ns > self._lost_ns:
                gap_s = (last.arrived_ns - self._lost_ns) / S_NS
                self._lost_ns = None
                self._stream.say(f"poses are back after {gap_s:.1f} s")
        if self._file and now_ns >= self._write_at_ns:
            self._write_at_ns = now_ns + _ROWS_NS
            self._write()

    def _report(self) -> LiveReport:
        """Sum up, and fly on until the end of the run, so that a run that is repeated gets there too."""
        report = self._stream.report
        until_s = report.simulated_s if report.interrupted else self._stream.span_s[1]
        if self._motion.knots:
            self._motion.poses_at(np.array([self._engine.scenario.start_ns + seconds_to_ns(until_s)]))
        poses = self._motion.poses
        late = self._latency.summary
        since_s = self._motion.since_s
        gaps_ns = list(poses.gaps_ns)
        longest_ns = poses.longest_gap_ns
        if self._lost_ns is not None:
            gaps_ns.append((self._lost_ns, self._clock_ns()))
            longest_ns = max(longest_ns, gaps_ns[-1][1] - self._lost_ns)
        return LiveReport(
            poses=poses.received,
            refused=poses.refused + (self._receiver.malformed if self._receiver else 0),
            out_of_order=poses.out_of_order,
            longest_gap_s=longest_ns / S_NS,
            lost=tuple(PosesLost(since_s(begin), (end - begin) / S_NS) for begin, end in gaps_ns),
            left_out_s=self._windows.left_out * STEP_NS / S_NS,
            latency_median_us=late.median_ns * 1e-3,
            latency_p95_us=self._latency.quantile_ns(0.95) * 1e-3,
            latency_p99_us=late.p99_ns * 1e-3,
            latency_max_us=late.max_ns * 1e-3,
            flown=str(self._flown) if self._flown else None,
        )

    def _write(self) -> None:
        """Write the knots that are not in the table yet."""
        knots = self._motion.knots
        assert self._file is not None
        if knots is None:
            return
        stop = knots.last + 1
        header = "" if self._written else FLOWN_HEADER
        rows = flown_rows(self._written, knots.states(self._written, stop))
        self._file.file.write(f"{header}{rows}".encode())
        self._written = stop
