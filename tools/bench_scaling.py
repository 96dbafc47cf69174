"""Simulation of a run on more cores, from the measured times of its workers and of the thread that writes."""

import os
import subprocess
import sys
from collections import deque
from pathlib import Path
from typing import NamedTuple

from rich.box import MARKDOWN
from rich.table import Table
from toolbox import set_words

CORES = (1, 2, 4, 8, 16)
_JOBS = 400  # of a simulated run

_MEASURE = """
import json, sys, tempfile, time
from pathlib import Path
from vlp16emu import Emulator
scene, threads, begin_s, stop_s, *settings = sys.argv[1:]
emulator = Emulator(scene, settings, threads=int(threads))
unit, batching = emulator.parts.units[0], emulator.engine.batching
marks = []
def mark(simulated_s):
    due_s = (float(begin_s), float(stop_s))[min(len(marks), 1)]
    if len(marks) < 2 and simulated_s >= due_s:
        marks.append((simulated_s, time.thread_time(), time.process_time()))
with tempfile.TemporaryDirectory() as folder:
    emulator.record(Path(folder) / "bench.pcap", duration_s=1.01 * float(stop_s), progress=mark)
(from_s, writer0_s, all0_s), (to_s, writer1_s, all1_s) = marks
job_s = unit.beam.revolutions_at_once * batching.block * batching.parts * batching.sequence_ns / 1e9
writer_s = (writer1_s - writer0_s) / (to_s - from_s)
print(json.dumps([writer_s, (all1_s - all0_s) / (to_s - from_s) - writer_s, job_s]))
"""


class Parts(NamedTuple):
    """Processor seconds per simulated second of the two kinds of threads, and what a job covers."""

    writer_s: float  # the thread that takes results in order, packs, stamps and writes them
    workers_s: float  # all others
    job_s: float  # simulated seconds


def measured(scene: str, settings: list[str], threads: int, span_s: tuple[float, float]) -> Parts:
    """Measure a recording in a process of its own, between two simulated times."""
    words = [scene, str(threads), *map(str, span_s), *settings]
    done = subprocess.run(
        [sys.executable, "-c", _MEASURE, *words], capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise SystemExit(f"{' '.join(words)}: {(done.stderr.strip().splitlines() or ['no message'])[-1]}")
    return Parts(*map(float, done.stdout.strip().strip("[]").split(",")))


def speed(cores: int, writer_s: float, workers_s: float, job_s: float) -> float:
    """Return simulated seconds per second of a run on some cores, one worker for each.

    Jobs are started in order, at most as many ahead of the writer as there are workers and one more, as
    `vlp16emu.engine.windows.in_order` does. With all cores at work the writer's time is taken from them.

    Parameters
    ----------
    writer_s, workers_s : as in `Parts`, on so many cores
    """
    free_s = [0.0] * cores
    waiting = deque[float]()
    writer_free_s = 0.0
    at_work_s = workers_s * job_s * (1.0 + writer_s / workers_s)
    for _ in range(_JOBS):
        worker = min(range(cores), key=free_s.__getitem__)
        if len(waiting) > cores:
            writer_free_s = max(writer_free_s, waiting.popleft()) + writer_s * job_s
        free_s[worker] = max(free_s[worker], writer_free_s if len(waiting) == cores else 0.0) + at_work_s
        waiting.append(free_s[worker])
    for done_s in waiting:
        writer_free_s = max(writer_free_s, done_s) + writer_s * job_s
    return _JOBS * job_s / writer_free_s


def scaling_table(scene: str, settings: dict[str, list[str]], span_s: tuple[float, float]) -> Table:
    """Measure the parts with one thread and with two, and simulate runs on more cores.

    What a second thread adds to the others' time, by caches and memory that they share, is added again for
    each doubling of the cores.
    """
    heads = ("writer, s per s", "workers, 1 thread", "2 threads", "share of the writer")
    title = f"{scene}, load {os.getloadavg()[0]:.1f}; simulated: x real time on so many cores"
    table = Table("chain", *heads, *map(str, CORES), "at most", title=title, box=MARKDOWN)
    for name, own in settings.items():
        one, two = (measured(scene, own, threads, span_s) for threads in (1, 2))
        slower = max(two.workers_s / one.workers_s, 1.0)
        speeds = (
            speed(cores, two.writer_s, one.workers_s * slower ** (cores.bit_length() - 1), two.job_s)
            for cores in CORES
        )
        share = two.writer_s / (two.writer_s + two.workers_s)
        parts = (two.writer_s, one.workers_s, two.workers_s, share)
        cells = (*(f"{part:.3f}" for part in parts), *(f"{times:.1f}" for times in speeds))
        table.add_row(name, *cells, f"{1.0 / two.writer_s:.0f}")
    return table


def pairs_table(
    scene: str, settings: dict[str, list[str]], other: str, pairs: int, spans_s: tuple[float, float]
) -> Table:
    """Record with another checkout and with this one in turns, and compare their processor time.

    The figure is that of a long recording less a short one, in CPU seconds per simulated second.
    """
    here = sys.prefix
    title = f"{scene}, {spans_s[1]:g} s less {spans_s[0]:g} s, CPU s per s"
    table = Table("chain", "pair", other, "here", "here / there", "load", title=title, box=MARKDOWN)
    for name, own in settings.items():
        for prefix in (f"{other}/.venv", here):  # compiles missing kernels, and grows what the store lacks
            _recorded_s(prefix, scene, own, spans_s[1])
        for pair in range(pairs):
            order = (f"{other}/.venv", here) if pair % 2 == 0 else (here, f"{other}/.venv")
            took = {prefix: _steady_s(prefix, scene, own, spans_s) for prefix in order}
            there_s, here_s = took[f"{other}/.venv"], took[here]
            cells = (f"{there_s:.3f}", f"{here_s:.3f}", f"{here_s / there_s:.2f}")
            table.add_row(name, str(pair + 1), *cells, f"{os.getloadavg()[0]:.1f}")
    return table


def _steady_s(prefix: str, scene: str, settings: list[str], spans_s: tuple[float, float]) -> float:
    short_s, long_s = (_recorded_s(prefix, scene, settings, span_s) for span_s in spans_s)
    return (long_s - short_s) / (spans_s[1] - spans_s[0])


def _recorded_s(prefix: str, scene: str, settings: list[str], seconds: float) -> float:
    """Return the CPU time of a recording to standard output by the program in a virtual environment."""
    words = ["record", scene, "-", "--duration", str(seconds), *set_words(settings), "--no-audit"]
    before = os.times()
    program = [f"{prefix}/bin/python", "-m", "vlp16emu", *words]
    done = subprocess.run(
        program,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        cwd=Path(prefix).parent,  # `-m` takes the package in the current folder before the installed one
    )
    after = os.times()
    if done.returncode:
        raise SystemExit(f"{' '.join(program)}: {(done.stderr.strip().splitlines() or ['no message'])[-1]}")
    return after.children_user + after.children_system - before.children_user - before.children_system
