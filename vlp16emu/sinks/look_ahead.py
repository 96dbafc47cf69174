"""Packets that are computed ahead by a thread with lower priority."""

import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Self

from vlp16emu.types import Packet

LOOK_AHEAD_PACKETS = 2048  # About 2.3 s of single return with its position packets, 1.2 s of dual; 2.6 MB

_POLL_S = 0.05  # interval at which a waiting thread checks for a stop
_REFILLS = 8
"""Share of the full buffer that is taken before it is filled again: waking the computing thread for each
packet would cost the sending thread as much as sending."""
_NICE = 3
"""Niceness added to computing threads. A driver that shares a core with one of them gets two thirds of it; at
equal priority it gets half, and a driver that needs half loses packets. More niceness would cost speed beside
other programs, and the sending thread would be late more often: it waits for the interpreter, which a thread
without a core may hold."""


class LookAhead:
    """Iterates over packets in its own thread, at most `capacity` of them ahead of `take`.

    A context manager; leaving it stops the thread after the current packet. The thread is a daemon, so a
    second Ctrl-C need not wait for it. On Linux it and the threads that it starts have a lower priority,
    which new threads inherit; on other systems the priority belongs to the process.

    Parameters
    ----------
    packets : packets in order of sending; from now on used by the thread alone
    capacity : greatest number of packets held
    stop : event that ends the wait of both sides
    """

    def __init__(self, packets: Iterable[Packet], capacity: int, stop: threading.Event) -> None:
        self._capacity = capacity
        self._stop = stop
        self._room_at = capacity - max(capacity // _REFILLS, 1)
        self._ready = deque[Packet]()
        self._changed = threading.Condition()
        self._done = self._ended = False
        self._left = False
        self._error: BaseException | None = None
        self._made_due_ns = 0
        self._full: tuple[int, int] | None = None
        self._redo: tuple[int, Callable[[int], None]] | None = None
        self._thread = threading.Thread(
            target=self._run, args=(iter(packets),), name="look-ahead", daemon=True
        )

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._changed:
            self._left = True
            self._changed.notify_all()
        self._thread.join()

    @property
    def first(self) -> Packet | None:
        """Packet that `take` returns next, if it is ready."""
        return self._ready[0] if self._ready else None

    @property
    def made_until_ns(self) -> int:
        """Due time of the last computed packet; far in the future once all are computed."""
        return 2**63 if self._done else self._made_due_ns

    @property
    def engine_speed(self) -> float | None:
        """Simulated time per computing time since the buffer was last full; None before."""
        if (full := self._full) is None:
            return None
        clock_ns, due_ns = full
        return (self._made_due_ns - due_ns) / max(time.monotonic_ns() - clock_ns, 1)

    def fill(self) -> None:
        """Wait until the buffer is full, the packets have ended, or `stop` is set."""
        with self._changed:
            while len(self._ready) < self._capacity and not self._done and not self._over:
                self._changed.wait(_POLL_S)

    def take(self, waiting: Callable[[float | None], None] = lambda _: None) -> Packet | None:
        """Return the next packet; None at the end or when `stop` is set.

        While it waits, it calls `waiting` with the engine's speed every 50 ms.

        Raises
        ------
        BaseException : Error of the packet iterator, raised once the packets before it have been taken.
        """
        with self._changed:
            while not self._ready and not self._done and not self._over:
                if not self._changed.wait(_POLL_S):
                    waiting(self.engine_speed)
            if self._over:
                return None
            if self._ready:
                packet = self._ready.popleft()
                if len(self._ready) == self._room_at or not self._ready:
                    self._changed.notify_all()
                return packet
        if self._error is not None:
            raise self._error
        return None

    def redo(self, due_ns: int, restart: Callable[[int], None]) -> None:
        """Compute again the packets due from `due_ns` on that are not taken yet; from any thread.

        It has no effect after the last packet.

        `restart` makes the packet iterator start again at a due time; the computing thread calls it.
        """
        with self._changed:
            if self._ended:
                return
            earliest_ns = min(due_ns, self._redo[0]) if self._redo else due_ns
            while self._ready and self._ready[-1].due_ns >= earliest_ns:
                self._ready.pop()
            # A finished thread waits until its buffer is empty, so that it can still start again.
            self._redo = (earliest_ns, restart)
            self._done = False
            self._made_due_ns = min(self._made_due_ns, earliest_ns)
            self._changed.notify_all()

    @property
    def _over(self) -> bool:
        return self._left or self._stop.is_set()

    def _wait_for_room(self, packet: Packet | None) -> None:
        """Wait until a share of the full buffer has been taken, after the last packet all of it.

        The lock is held.

        It also ends at a stop, or if the buffer must be computed again.
        """
        most = self._room_at
        if packet is None:
            most = 0
            self._done = True
            self._changed.notify_all()
        elif len(self._ready) < self._capacity:
            return
        while len(self._ready) > most and not self._over and self._redo is None:
            self._changed.wait(_POLL_S)
        if packet is not None:
            self._full = time.monotonic_ns(), packet.due_ns

    def _run(self, packets: Iterator[Packet]) -> None:
        if sys.platform == "linux":
            os.nice(_NICE)
        try:
            while True:
                packet = next(packets, None)
                with self._changed:
                    self._wait_for_room(packet)
                    redo = self._redo
                    self._redo = None
                    if self._over or (packet is None and redo is None):
                        return
                    if packet is not None and (redo is None or packet.due_ns < redo[0]):
                        self._made_due_ns = packet.due_ns
                        self._ready.append(packet)
                        self._changed.notify_all()
                if redo is not None:
                    due_ns, restart = redo
                    restart(due_ns)
        except BaseException as error:  # noqa: BLE001  # raised in the taking thread
            self._error = error
        finally:
            with self._changed:
                self._done = self._ended = True
                self._changed.notify_all()
