"""What verbs do on a terminal: interrupts, a progress bar with the time left, and the rows that several of them print."""

import json
import os
import signal
import sys
import threading
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import typer

from vlp16emu.errors import OutputError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from vlp16emu.run.report import AuditFinding
    from vlp16emu.sensor.head import Turn

INTERRUPTED = 130
"""Exit code after Ctrl-C: 128 + SIGINT, as shells count (POSIX.1-2024, Shell, section 2.8.2)."""

ENDINGS = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
"""By these a run is ended from outside."""

_STDERR = 2


@contextmanager
def stop_on_ctrl_c() -> Iterator[threading.Event]:
    """Event that Ctrl-C, SIGTERM and a hangup set; a second one interrupts at once.

    An exception could come between a packet's write and its count, so that report and file would differ.
    """
    stop = threading.Event()
    before = {number: signal.getsignal(number) for number in ENDINGS}
    if before[signal.SIGHUP] is signal.SIG_IGN:  # by nohup
        del before[signal.SIGHUP]

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    def note(_signal: int, _frame: object) -> None:
        stop.set()
        restore()
        if os.isatty(_STDERR):  # print is not to be called in the midst of a print
            os.write(_STDERR, b"\nfinishing what is under way; Ctrl-C again stops at once\n")

    for number in before:
        signal.signal(number, note)
    try:
        yield stop
    finally:
        restore()


_FIRST = "growing the world"
_REFRESH_S = 0.5
"""Drawing takes a millisecond, which a packet that is due must not wait for more often."""


class Progress:
    """Bar on stderr; nothing where stderr is no terminal.

    Drawn by the thread that shows it: a thread of its own would disturb the pacing of packets. Before the first one it
    counts the seconds by a thread of its own.

    Parameters
    ----------
    total_s : simulated seconds to come
    """

    def __init__(self, total_s: float) -> None:
        self._total_s = total_s
        self._next_s = 0.0
        self._begun = threading.Event()
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
            self._task = self._bar.add_task(_FIRST, total=total_s)

    def __enter__(self) -> Self:
        if self._bar is not None:
            self._bar.start()
            threading.Thread(target=self._show_life, name="progress", daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._begun.set()
        if self._bar is not None:
            with suppress(OSError):  # the terminal may be gone
                self._bar.stop()

    def _show_life(self) -> None:
        began_s = time.monotonic()
        while not self._begun.wait(_REFRESH_S):
            self._draw(f"{_FIRST}, {time.monotonic() - began_s:.0f} s", 0.0)

    def _draw(self, task: str, done_s: float) -> None:
        """Draw the bar, until the terminal is gone."""
        if (bar := self._bar) is not None:
            try:
                bar.update(self._task, description=task, completed=done_s, refresh=True)
            except OSError:
                self._bar = None

    def show(self, task: str, done_s: float) -> None:
        """Show what is being done and how far it is; draws twice a second."""
        if self._bar is not None and (now_s := time.monotonic()) >= self._next_s:
            self._begun.set()
            self._next_s = now_s + _REFRESH_S
            self._draw(task, done_s)

    def say(self, line: str) -> None:
        """Print a line on stderr at once, above the bar where there is one."""
        if self._bar is not None:
            self._bar.console.print(line, markup=False, highlight=False, soft_wrap=True)
        else:
            print(line, file=sys.stderr, flush=True)


def tree_of(result: "DataclassInstance") -> dict[str, Any]:
    """Put a result into the types of JSON; what it says of its `turn` goes beside the rest."""

    def flat(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        tree = dict[str, Any]()
        for name, value in pairs:
            tree |= value if name == "turn" else {name: value}
        return tree

    return asdict(result, dict_factory=flat)


def make_folder(out: Path) -> None:
    """Make the folder of a report, before anything heavy.

    Raises
    ------
    OutputError
        where it cannot be made
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"--out {out}", str(error.strerror), "a folder") from error


def print_json(tree: Mapping[str, object]) -> None:
    """Print one JSON object."""
    print(json.dumps(tree, indent=2))


def print_rows(title: str, rows: Mapping[str, str]) -> None:
    """Print a title and under it names and values in two columns."""
    print(title)
    width = max(map(len, rows))
    for name, value in rows.items():
        print(f"  {name:<{width}}  {value}")


def finish(tree: Mapping[str, Any], place: object, rows: Mapping[str, str], *, as_json: bool) -> None:
    """Print what a run has written in some place, as JSON or in rows; exit as interrupted if `tree` says so."""
    interrupted = tree.get("interrupted")
    if as_json:
        print_json(tree)
    else:
        print_rows(f"{'interrupted, kept' if interrupted else 'wrote'} {place}", rows)
    if interrupted:
        raise typer.Exit(INTERRUPTED)


def print_files(files: Iterable[Path]) -> None:
    """Print the names and sizes of files that were written."""
    for path in files:
        print(f"wrote {path}, {size(path.stat().st_size)}")


def count(number: int) -> str:
    """Write a whole number in groups of three digits (ISO 80000-1, section 7.3.1)."""
    return f"{number:,}".replace(",", " ")


def size(number_of_bytes: int) -> str:
    """Write a file's size in MB of a million bytes."""
    return f"{number_of_bytes / 1e6:.1f} MB"


def light_rows(beam: str, noise: str, weather: str | None) -> dict[str, str]:
    """Rows of the active models of beam, noise and weather; none for clear air."""
    return {"beam": beam, "noise": noise} | ({} if weather is None else {"weather": weather})


def revolutions(turns: "Sequence[Turn]") -> str:
    """Write how far sensors turned, once for those that turned alike."""
    texts = (
        f"{round(turn.revolutions, 1):.12g} of {count(round(turn.sequences_per_revolution))} firing "
        f"sequences, {turn.azimuth_step_deg:.4g} deg apart"
        for turn in turns
    )
    return "; ".join(dict.fromkeys(texts))


_WIDEST = 10.0
"""Quotient of the ends of an interval beyond which it does not give as much as the order of magnitude."""


def audit_rows(found: "AuditFinding | None") -> dict[str, str]:
    """Row of what an audit found; none without one."""
    if found is None:
        return {}
    if found.exact:
        return {"range error": "rounding to float32 only: by the scene's choice a pulse is one ray"}
    if found.range_rmse_m is None:
        return {"range error": f"not known: {found.pulses} pulses cast again had no return"}
    low_m, high_m = found.range_rmse_low_m, found.range_rmse_high_m
    if low_m is None or high_m is None:
        sure = "interval not known from so few"
    elif high_m > _WIDEST * low_m:
        sure = "run too short for an interval"
    else:
        sure = f"95 %: {1e3 * low_m:.1f} to {1e3 * high_m:.1f} mm"
    lost, invented, other = (
        f"{100 * (share or 0.0):.1f} %" for share in (found.lost, found.invented, found.other_echo)
    )
    return {
        "range error": f"RMSE {1e3 * found.range_rmse_m:.1f} mm before noise ({sure}), "
        f"{lost} lost, {invented} invented, {other} of another echo"
    }
