"""Where poses of a live run come in: a UDP port, and the thread that reads it."""

import select
import socket
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Self

from vlp16emu.errors import InputError, OutputError
from vlp16emu.extras.live.pose_packet import POSE_BYTES, is_pose, unpack_pose

_POLL_S = 0.1
"""How often the thread looks whether it shall end."""
_MERGED_S = 0.002
"""Poses that come within this time are one; knots are 5 ms apart."""
_MOST = 1000
"""Datagrams that are looked at before a pose is handed on."""
_EXPECTED = "udp://HOST:PORT, for instance udp://127.0.0.1:7000"


def pose_port(text: str) -> tuple[str, int]:
    """Read where poses come in; `InputError` if it is no address and port."""
    scheme, _, rest = text.partition("://")
    host, _, port = rest.rpartition(":")
    if scheme != "udp" or not host or not port.isascii() or not port.isdecimal() or int(port) > 65_535:
        raise InputError("--pose-in", f"found {text}", _EXPECTED)
    return host, int(port)


class PoseReceiver:
    """Reads datagrams of poses in a thread of its own, and hands them on at once; a context manager.

    Parameters
    ----------
    where : as `pose_port` takes it; port 0 is any free one
    put : takes position, quaternion and time of a pose, and raises `InputError` if they are none

    Raises
    ------
    InputError
        If `where` is no address and port
    OutputError
        If the port cannot be listened to
    """

    def __init__(self, where: str, put: Callable[[Sequence[float], Sequence[float], int | None], object]) -> None:
        host, port = pose_port(where)
        self._put, self._over = put, threading.Event()
        self.malformed = 0
        """Datagrams that are no pose packet."""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except (OSError, UnicodeError) as error:
            self._socket.close()
            found = getattr(error, "strerror", None) or str(error)
            raise OutputError(where, found, "an address of this machine and a free port") from error
        self._socket.setblocking(False)
        host, port = self._socket.getsockname()
        self.where = f"udp://{host}:{port}"
        """Address and port that are listened to."""
        self._thread = threading.Thread(target=self._run, name="poses", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        self._socket.close()

    def _run(self) -> None:
        """Body of the thread: of poses that are there at once the last one counts, so a flood costs no more than a few."""
        while not self._over.is_set():
            if select.select([self._socket], [], [], _POLL_S)[0]:
                self._take()
                self._over.wait(_MERGED_S)

    def _take(self) -> None:
        """Hand on the last pose among the datagrams that have come."""
        last = None
        with suppress(BlockingIOError):
            for _ in range(_MOST):
                payload = self._socket.recv(POSE_BYTES + 1)
                if is_pose(payload):
                    last = payload
                else:
                    self.malformed += 1
        if last is not None:
            pose = unpack_pose(last)
            with suppress(InputError):  # `put` counts what is no pose
                self._put(pose.position_m, pose.quaternion, pose.t_ns)
