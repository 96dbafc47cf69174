"""Start of a run on the command line."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from vlp16emu.cli.terminal import Progress, stop_on_ctrl_c
from vlp16emu.run.options import Span

if TYPE_CHECKING:
    from vlp16emu.emulator import Emulator


def make_emulator(
    scene: str, settings: Sequence[str] | None, *, ideal: bool = False, threads: int = 0, audit: bool = False
) -> "Emulator":
    """Return the emulator of a command line; arguments and errors as `Emulator`."""
    from vlp16emu.scenario import load

    scenario = load(scene, settings or (), ideal=ideal)  # first: no mistake in it should wait for numba
    compile_first(scenario.world.kind)
    from vlp16emu.emulator import Emulator

    return Emulator(scene, settings or (), ideal=ideal, threads=threads, audit=audit)


@contextmanager
def running(emulator: "Emulator", task: str, span: Span) -> Iterator[dict[str, Any]]:
    """Yield the keywords of a run that show its progress and end it after a signal."""
    begin_s, end_s = emulator.scenario.span_s(span.start_s, span.duration_s, where="--start")
    with stop_on_ctrl_c() as stop, Progress(end_s - begin_s) as bar:
        yield {"progress": lambda done_s: bar.show(task, done_s), "stop": stop}


def compile_first(world: str | None) -> None:
    """Compile the kernels of runs in a kind of world (None: all) that are not on disk, with a count on stderr."""
    from vlp16emu.kernels.compiler import compile_kernels

    group = "forest" if world not in (None, "hall") else world
    is_terminal = sys.stderr is not None and sys.stderr.isatty()
    for done, count in compile_kernels(group):
        line = f"compiling kernels: {done} of {count}, once"
        if is_terminal:
            print(f"\r{line}", end="\n" if done == count else "", file=sys.stderr, flush=True)
        elif done in (0, count) and sys.stderr is not None:
            print(line, file=sys.stderr, flush=True)
