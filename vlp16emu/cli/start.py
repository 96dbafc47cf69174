"""The start of a run."""

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from vlp16emu.emulator import Emulator


def make_emulator(
    scene: str, settings: Sequence[str] | None, *, ideal: bool = False, threads: int = 0, audit: bool = False
) -> "Emulator":
    """Make the emulator of a command line; arguments and errors as of `Emulator`."""
    from vlp16emu.scenario import load

    scenario = load(scene, settings or (), ideal=ideal)  # first: no mistake in it should wait for numba
    compile_first("hall" if scenario.world.kind == "hall" else "forest")
    from vlp16emu.emulator import Emulator

    return Emulator(scene, settings or (), ideal=ideal, threads=threads, audit=audit)


def compile_first(group: str | None) -> None:
    """Compile the kernels that a group of runs needs and that are not on disk, and say on stderr how far that is."""
    from vlp16emu.kernels.compiler import compile_kernels

    is_terminal = sys.stderr is not None and sys.stderr.isatty()
    for done, count in compile_kernels(group):
        line = f"compiling kernels: {done} of {count}, once"
        if is_terminal:
            print(f"\r{line}", end="\n" if done == count else "", file=sys.stderr, flush=True)
        elif done in (0, count) and sys.stderr is not None:
            print(line, file=sys.stderr, flush=True)
