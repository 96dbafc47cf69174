"""A bounded channel between two processes of this machine, whose writer never waits."""

import pickle
import socket
from typing import Self

CHANNEL_BYTES = 150_000
"""Limit of a message; a socket of Linux holds 212 992 at a time unless net.core.wmem_default is less."""


class Channel:
    """One end of a pair, which may be given to a process that is started.

    What is written while the other end is slow, hangs, or is gone is lost. Messages come whole, and in order.
    """

    def __init__(self, end: socket.socket) -> None:
        self._end = end

    @classmethod
    def pair(cls) -> tuple[Self, Self]:
        """Make both ends."""
        # SOCK_SEQPACKET keeps messages apart, and a reader learns that the writer is gone (unix(7)).
        one, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        return cls(one), cls(other)

    def offer(self, message: object) -> bool:
        """Send a message if there is room for it now, and return whether there was."""
        try:
            self._end.send(pickle.dumps(message), socket.MSG_DONTWAIT)
        except OSError:
            return False
        return True

    def take(self, timeout_s: float | None = None) -> object:
        """Return the next message; raise TimeoutError if none comes in time, EOFError if the other end is gone."""
        self._end.settimeout(timeout_s)
        try:
            data = self._end.recv(CHANNEL_BYTES)
        except ConnectionError:
            data = b""
        if not data:
            raise EOFError
        return pickle.loads(data)  # noqa: S301  # the other end is a process of ours

    def close(self) -> None:
        """Close this end."""
        self._end.close()
