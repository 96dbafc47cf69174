"""The start of a run: what it loads and makes stays until its end."""

import gc
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from vlp16emu.kernel_cache import is_compiled

if TYPE_CHECKING:
    from vlp16emu.emulator import Emulator

__all__ = ["announce_compiling", "make_emulator", "starting"]


def make_emulator(
    scene: str,
    settings: Sequence[str] | None,
    *,
    ideal: bool = False,
    threads: int = 0,
    audit: bool = False,
) -> "Emulator":
    """Make the emulator of a command line; arguments and errors as of `Emulator`."""
    from vlp16emu.scenario import load

    load(scene, settings or (), ideal=ideal)  # first: no mistake in it should wait for numba
    _load_numba()
    announce_compiling()
    from vlp16emu.emulator import Emulator

    return Emulator(scene, settings or (), ideal=ideal, threads=threads, audit=audit)


def announce_compiling() -> None:
    """Say on stderr that the first run takes longer, where no kernel has been compiled yet."""
    if sys.stderr is not None and not is_compiled():
        print("compiling kernels, about a minute, once", file=sys.stderr, flush=True)


@contextmanager
def starting() -> Iterator[None]:
    """Load libraries and make the parts of a run without the garbage collector.

    It would visit the 300 000 objects of the libraries again and again, for 0.1 s, and find next to nothing; afterwards
    it leaves them alone, so that no packet waits for it either. Where libraries are loaded already, a longer program
    calls us, and nothing changes: what is garbage by then must not stay.
    """
    if "numba" in sys.modules or not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


def _load_numba() -> None:
    """Load numba without scipy's linear algebra, which takes 0.2 s; no kernel calls it."""
    if "scipy.linalg" in sys.modules:
        return
    sys.modules["scipy.linalg"] = None  # type: ignore[assignment]  # so that nobody can import it
    try:
        import numba.np.arraymath  # noqa: F401
    finally:
        del sys.modules["scipy.linalg"]
