"""The whole chain, from the command line to the file: `vlp16emu record --no-audit`, each time in a fresh process.

"First packet" is a recording of a few milliseconds, start of Python and end included, with compiled code in its cache.
The steady state leaves start and first window out: 40 s over what 60 s take longer than 20 s. Recordings of all settings
are made in turn, in the opposite order in every other pair, so that a busy neighbour slows all of them alike. Figures are
medians of the pairs, with the least and the greatest. Memory is the peak of the long recording.
"""

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from rich.box import MARKDOWN
from rich.table import Table

SETTINGS = {"default": [], "one ray": ["beam.model=none"], "default, dual": ["sensor.return_mode=dual"]}
FIRST_S, SHORT_S, LONG_S = 0.002, 20.0, 60.0


class Took(NamedTuple):
    """What a recording took."""

    wall_s: float
    cpu_s: float
    peak_mb: float


def recorded(scene: str, settings: list[str], threads: int, seconds: float) -> Took:
    """Record a scene in a process of its own.

    Raises
    ------
    SystemExit
        where that fails
    """
    sets = [word for setting in settings for word in ("--set", setting)]
    with tempfile.TemporaryDirectory() as folder:
        words = [scene, str(Path(folder) / "bench.pcap"), "--duration", str(seconds), "--threads", str(threads)]
        command = [sys.executable, "-m", "vlp16emu", "record", *words, *sets, "--no-audit", "--json"]
        began_s = time.perf_counter()
        with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
            _, status, used = os.wait4(process.pid, 0)  # memory of this child alone
            process.returncode = os.waitstatus_to_exitcode(status)
        wall_s = time.perf_counter() - began_s
    if process.returncode:
        raise SystemExit(f"{' '.join(command)}: exit code {process.returncode}")
    return Took(wall_s, used.ru_utime + used.ru_stime, used.ru_maxrss * 1024 / 1e6)


def chains(scene: str, pairs: int) -> Table:
    """Record a scene with all settings and numbers of threads."""
    runs = [(name, threads) for name in SETTINGS for threads in range(1, (os.cpu_count() or 1) + 1)]
    for own in SETTINGS.values():
        recorded(scene, own, 1, FIRST_S)  # compiles what is not yet
    took: dict[tuple[str, int], list[list[Took]]] = {run: [] for run in runs}
    for pair in range(pairs):
        for run in runs[:: 1 - 2 * (pair % 2)]:
            name, threads = run
            spans_s = FIRST_S, SHORT_S, LONG_S
            took[run].append([recorded(scene, SETTINGS[name], threads, seconds) for seconds in spans_s])
    heads = "first packet, s", "60 s take, s", "steady, x real time", "simulated s per CPU s", "peak, MB"
    title = f"{scene}, {pairs} pairs, load {os.getloadavg()[0]:.1f} at the end"
    table = Table("chain", "threads", *heads, title=title, box=MARKDOWN)
    for (name, threads), rows in took.items():
        steady_s = LONG_S - SHORT_S
        figures = (
            [first.wall_s for first, _, _ in rows],
            [long.wall_s for _, _, long in rows],
            [steady_s / (long.wall_s - short.wall_s) for _, short, long in rows],
            [steady_s / (long.cpu_s - short.cpu_s) for _, short, long in rows],
        )
        peak_mb = max(long.peak_mb for _, _, long in rows)
        table.add_row(name, str(threads), *map(spread, figures), f"{peak_mb:.0f}")
    return table


def spread(values: list[float]) -> str:
    """Write a median, and between what it lies."""
    middle = f"{statistics.median(values):.2f}"
    return f"{middle} ({min(values):.2f} to {max(values):.2f})" if len(values) > 1 else middle
