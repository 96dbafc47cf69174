"""The start of a run."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from vlp16emu.cli.terminal import Progress, stop_on_ctrl_c

if TYPE_CHECKING:
    from vlp16emu.emulator import Emulator


def make_emulator(
    scene: str, settings: Sequence[str] | None, *, ideal: bool = False, threads: int = 0, audit: bool = False
) -> "Emulator":
    """Make the emulator of a command line; arguments and errors as of `Emulator`."""
    from vlp16emu.scenario import load

    scenario = load(scene, settings or (), ideal=ideal)  # first: no mistake in it should wait for numba
    compile_first(scenario.world.kind)
    from vlp16emu.emulator import Emulator

    return Emulator(scene, settings or (), ideal=ideal, threads=threads, audit=audit)


@contextmanager
def running(emulator: "Emulator", task: str, start_s: float, duration_s: float | None) -> Iterator[dict[str, Any]]:
    """Keywords of a run: its span, what shows its progress, and what Ctrl-C sets."""
    begin_s, end_s = emulator.scenario.span_s(start_s, duration_s, where="--start")
    with stop_on_ctrl_c() as stop, Progress(end_s - begin_s) as bar:
        yield {
            "start_s": start_s,
            "duration_s": duration_s,
            "progress": lambda done_s: bar.show(task, done_s),
            "stop": stop,
        }


def compile_first(world: str | None) -> None:
    """Compile the kernels of runs in a kind of world (None: all) that are not on disk, and say on stderr how far that is."""
    from vlp16emu.kernels.compiler import compile_kernels

    group = "forest" if world not in (None, "hall") else world
    is_terminal = sys.stderr is not None and sys.stderr.isatty()
    for done, count in compile_kernels(group):
        line = f"compiling kernels: {done} of {count}, once"
        if is_terminal:
            print(f"\r{line}", end="\n" if done == count else "", file=sys.stderr, flush=True)
        elif done in (0, count) and sys.stderr is not None:
            print(line, file=sys.stderr, flush=True)
