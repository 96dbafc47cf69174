"""The terminal: signals that end a run, a progress bar with the time left, and the start of a run."""

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import TYPE_CHECKING, Self

from vlp16emu.errors import printable
from vlp16emu.output import SignalEvent, is_ending
from vlp16emu.run.options import Span
from vlp16emu.trees import Tree

if TYPE_CHECKING:
    from vlp16emu.cli.arguments import SceneOptions
    from vlp16emu.run.emulator import Emulator

ENDINGS = signal.SIGINT, signal.SIGTERM, signal.SIGHUP  # signals that end a run

_STDERR = 2


@contextmanager
def stop_on_ctrl_c() -> Iterator[threading.Event]:
    """Yield an event that Ctrl-C, SIGTERM and SIGHUP set; a second signal interrupts at once.

    An exception in place of the event could arise between writing a packet and counting it: report and file
    would then differ.
    """
    stop = SignalEvent()
    is_ending.clear()  # set by a run before
    handlers = {number: signal.getsignal(number) for number in ENDINGS}
    if handlers[signal.SIGHUP] is signal.SIG_IGN:  # by nohup
        del handlers[signal.SIGHUP]

    def restore() -> None:
        """Put back the handlers of before."""
        for number, handler in handlers.items():
            signal.signal(number, handler)

    def request_stop(_signal: int, _frame: object) -> None:
        """Ask the run to stop, and let a second signal end the program."""
        stop.set()
        is_ending.set()
        restore()
        with suppress(OSError):  # the terminal may be gone; print is not reentrant
            if os.isatty(_STDERR):
                os.write(_STDERR, b"\nfinishing what is under way; Ctrl-C again stops at once\n")

    for number in handlers:
        signal.signal(number, request_stop)
    try:
        yield stop
    finally:
        restore()


_REFRESH_S = 0.5  # drawing takes a millisecond, which can delay a packet that is due


class Progress:
    """Progress bar on stderr, if that is a terminal.

    The thread that calls `show` draws it: another thread would disturb the pacing of packets. Before the
    first call, a thread of its own counts the seconds.

    Parameters
    ----------
    total_s : simulated seconds to come, or another amount
    first_task : task before the first call of `show`
    unit : unit of the amount
    """

    def __init__(self, total_s: float, first_task: str = "growing the world", unit: str = "s") -> None:
        self._total_s = total_s
        self._first_task = first_task
        self._next_s = 0.0
        self._has_begun = threading.Event()
        self._bar = None
        if sys.stderr is not None and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
            from rich.progress import Progress as Bar

            columns = (
                TextColumn("{task.description}"),
                BarColumn(),
                TextColumn("{task.completed:.1f} of {task.total:.1f} " + unit),
                TimeRemainingColumn(),
                TextColumn("left"),
            )
            self._bar = Bar(*columns, console=Console(stderr=True), auto_refresh=False, transient=True)
            self._task = self._bar.add_task(first_task, total=total_s)

    def __enter__(self) -> Self:
        if self._bar is not None:
            self._bar.start()
            threading.Thread(target=self._count_seconds, name="progress", daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._has_begun.set()
        if self._bar is not None:
            with suppress(OSError):  # the terminal may be gone
                self._bar.stop()

    def _count_seconds(self) -> None:
        began_s = time.monotonic()
        while not self._has_begun.wait(_REFRESH_S):
            self._draw(f"{self._first_task}, {time.monotonic() - began_s:.0f} s", 0.0)

    def _draw(self, task: str, done_s: float) -> None:
        """Draw the bar, until the terminal is gone."""
        if (bar := self._bar) is not None:
            try:
                bar.update(self._task, description=task, completed=done_s, refresh=True)
            except OSError:
                self._bar = None

    def show(self, task: str, done_s: float) -> None:
        """Show a task and its progress; draws at most twice a second."""
        if self._bar is not None and (now_s := time.monotonic()) >= self._next_s:
            self._has_begun.set()
            self._next_s = now_s + _REFRESH_S
            self._draw(task, done_s)

    def show_share(self, task: str, share: float) -> None:
        """Show a task and the share of it that is done, 0 to 1; draws at most twice a second."""
        self.show(task, share * self._total_s)

    def say(self, line: str) -> None:
        """Print a line on stderr at once, above the bar if there is one, with control characters escaped."""
        line = printable(line)
        with suppress(OSError):  # the terminal may be gone
            if self._bar is not None:
                self._bar.console.print(line, markup=False, highlight=False, soft_wrap=True)
            else:
                print(line, file=sys.stderr, flush=True)


def make_emulator(scene: str, options: "SceneOptions") -> "Emulator":
    """Return the emulator of a command line; raises the errors of `Emulator`."""
    from vlp16emu.scenario import load

    settings = options.settings or ()
    # First, so that mistakes in the scene show before numba loads.
    scenario = load(scene, settings, ideal=options.ideal)
    compile_first(scenario.world.kind)
    from vlp16emu.run.emulator import Emulator

    return Emulator(scene, **vars(options) | {"settings": settings})


@contextmanager
def running(emulator: "Emulator", task: str, span: Span) -> Iterator[Tree]:
    """Yield keyword arguments for a run that show its progress and end it after a signal."""
    begin_s, end_s = emulator.scenario.span_s(span.start_s, span.duration_s, where="--start")
    with stop_on_ctrl_c() as stop, Progress(end_s - begin_s) as bar:
        yield {"progress": partial(bar.show, task), "stop": stop}


def compile_first(world: str | None) -> None:
    """Compile the kernels for a kind of world (None: all) that are not on disk, with a count on stderr."""
    from vlp16emu.kernels.compiler import compile_kernels

    group = "forest" if world not in (None, "hall") else world
    is_terminal = sys.stderr is not None and sys.stderr.isatty()
    for done_count, total in compile_kernels(group):
        line = f"compiling kernels: {done_count} of {total}, once"
        if is_terminal:
            print(f"\r{line}", end="\n" if done_count == total else "", file=sys.stderr, flush=True)
        elif done_count in (0, total) and sys.stderr is not None:
            print(line, file=sys.stderr, flush=True)
