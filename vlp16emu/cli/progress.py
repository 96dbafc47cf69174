"""A progress bar with the time left, on a terminal only."""

import sys
import time
from types import TracebackType
from typing import Self

__all__ = ["Progress"]

_REFRESH_S = 0.5
"""Drawing takes a millisecond, which a packet that is due must not wait for more often."""


class Progress:
    """Bar on stderr; nothing where stderr is no terminal.

    Drawn by the thread that shows it: a thread of its own would disturb the pacing of packets.

    Parameters
    ----------
    total_s : simulated seconds to come
    """

    def __init__(self, total_s: float) -> None:
        self._total_s = total_s
        self._next_s = 0.0
        self._bar = None
        if sys.stderr is not None and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
            from rich.progress import Progress as Bar

            columns = (
                TextColumn("{task.description}"),
                BarColumn(),
                TextColumn("{task.completed:.1f} of {task.total:.1f} s"),
                TimeRemainingColumn(),
                TextColumn("left"),
            )
            self._bar = Bar(*columns, console=Console(stderr=True), auto_refresh=False, transient=True)
            self._task = self._bar.add_task("growing the world", total=total_s)

    def __enter__(self) -> Self:
        if self._bar is not None:
            self._bar.start()
            self._bar.refresh()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def show(self, task: str, done_s: float) -> None:
        """Show what is being done and how far it is; draws twice a second."""
        if self._bar is not None and (now_s := time.monotonic()) >= self._next_s:
            self._next_s = now_s + _REFRESH_S
            self._bar.update(self._task, description=task, completed=done_s, refresh=True)

    def say(self, line: str) -> None:
        """Print a line on stderr at once, above the bar where there is one."""
        if self._bar is not None:
            self._bar.console.print(line, markup=False, highlight=False, soft_wrap=True)
        else:
            print(line, file=sys.stderr, flush=True)
