"""The sky over the antenna of a live run, cast beside its packets."""

import threading
from concurrent.futures import CancelledError
from contextlib import suppress
from typing import Self

from vlp16emu.engine import Engine
from vlp16emu.errors import InputError
from vlp16emu.extras.live.motion import LiveMotion
from vlp16emu.extras.live.windows import lower_priority
from vlp16emu.units import S_NS


class SkyAhead:
    """Thread that asks the receiver for the fix of each second as it passes; a context manager.

    The sentence of a second arrives a third of a second later. Without this thread the one that packs would
    cast the sky then, 256 rays through the crowns, and packets would wait for it.
    """

    def __init__(self, engine: Engine, motion: LiveMotion) -> None:
        self._receiver = engine.receiver
        self._motion = motion
        self._start_ns = engine.scenario.start_ns
        self._second_ns = self._start_ns // S_NS * S_NS  # the last one that was asked for
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="sky", daemon=True)

    def __enter__(self) -> Self:
        """Ask for the fix of the last second before the first pulse, which the first packets need."""
        if self._receiver is not None:
            with suppress(CancelledError, InputError):
                self._receiver.fix(self._second_ns)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        """Ask for the fixes of the next seconds."""
        if self._receiver is None:
            return
        lower_priority(threading.get_native_id())
        # What cannot be cast ends the stream, where the packer meets it.
        with suppress(CancelledError, InputError):
            while not self._over.wait(self._next_s):
                self._second_ns += S_NS
                self._receiver.fix(self._second_ns)

    @property
    def _next_s(self) -> float:
        """Time until the next second."""
        return (self._second_ns + S_NS - self._start_ns - self._motion.elapsed_ns) / S_NS
