"""The start of a run: what it loads and makes stays until its end."""

import gc
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from vlp16emu.emulator import Emulator


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

    scenario = load(scene, settings or (), ideal=ideal)  # first: no mistake in it should wait for numba
    _load_numba()
    compile_first("hall" if scenario.world.kind == "hall" else "forest")
    from vlp16emu.emulator import Emulator

    return Emulator(scene, settings or (), ideal=ideal, threads=threads, audit=audit)


def compile_first(group: str | None) -> None:
    """Compile the kernels that a group of runs needs and that are not on disk, and say on stderr how far that is."""
    from vlp16emu.compiling import compile_kernels

    is_terminal = sys.stderr is not None and sys.stderr.isatty()
    for done, count in compile_kernels(group):
        line = f"compiling kernels: {done} of {count}, once"
        if is_terminal:
            print(f"\r{line}", end="\n" if done == count else "", file=sys.stderr, flush=True)
        elif done in (0, count) and sys.stderr is not None:
            print(line, file=sys.stderr, flush=True)


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
