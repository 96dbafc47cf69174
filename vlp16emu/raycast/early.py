"""Shapes that a run needs first, built while the rest of the program is loaded.

A run leaves the names of the large shapes of its first window in the store. The next run of the same name reads and builds
them on a thread beside its imports, which keep one core busy for a second and the others idle.
"""

import json
import sys
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress

import numpy as np

from vlp16emu.errors import RunError
from vlp16emu.raycast.build import Solid
from vlp16emu.raycast.kept import unpacked_shape
from vlp16emu.store import user_store

__all__ = ["EARLY", "LARGE", "Early"]

LARGE = 5_000
"""Faces of a shape that is worth it."""

_SWITCH_S = 1e-4
"""How long imports keep the interpreter to themselves: the default of 5 ms would be waited for at each call of Embree."""


class Early:
    """Solids by the name under which the store has their faces."""

    def __init__(self) -> None:
        self._run, self._known = "", list[str]()
        self._pending = dict[str, Future[Solid]]()
        self._switch_s = sys.getswitchinterval()

    def begin(self, run: str) -> None:
        """Begin to build what a run of this name needed first the last time."""
        self.end()
        self._run, self._known = run, []
        if (bundle := user_store().get(f"first {run}")) is None:
            return
        self._known = json.loads(bundle["names"].tobytes())
        worker = ThreadPoolExecutor(1, "early")
        self._switch_s = sys.getswitchinterval()
        sys.setswitchinterval(_SWITCH_S)
        self._pending = {name: worker.submit(_solid, name) for name in self._known}
        worker.shutdown(wait=False)

    def take(self, name: str) -> Solid | None:
        """Give a solid, once; None for one that nobody has begun to build."""
        future = self._pending.pop(name, None)
        if future is None or future.cancel():
            return None
        with suppress(KeyError, RunError):  # whoever asked builds it anew
            return future.result()
        return None

    def remember(self, names: Sequence[str]) -> None:
        """Take note, once, of what the first window of the run needed, the largest first."""
        run, self._run = self._run, ""
        if run and names != self._known:
            text = json.dumps(list(names)).encode()
            user_store().put(f"first {run}", {"names": np.frombuffer(text, np.uint8)})
        self.end()

    def end(self) -> None:
        """Let go of what nobody took."""
        if self._pending or self._known:
            sys.setswitchinterval(self._switch_s)
        for future in self._pending.values():
            future.cancel()
        self._pending, self._known = {}, []


def _solid(name: str) -> Solid:
    """Build a shape of the store; a `KeyError` where it has none of the name."""
    if (bundle := user_store().get(name)) is None:
        raise KeyError(name)
    return Solid(unpacked_shape(bundle))


EARLY = Early()
"""That of this process."""
