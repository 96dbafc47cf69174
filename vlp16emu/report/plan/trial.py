"""Short pieces of a run, carried out as `record` does, and what they took."""

import os
import time
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from vlp16emu.engine import Engine
from vlp16emu.errors import InputError
from vlp16emu.packets import returns_in
from vlp16emu.report.plan.forecast import Spent
from vlp16emu.sinks import PcapSink
from vlp16emu.types import PacketKind
from vlp16emu.units import S_NS, seconds_to_ns

_PIECES = 6
_PIECES_S = 7.0
"""Time for all of them together."""


@dataclass(frozen=True, slots=True)
class Trial:
    """What pieces of a run took."""

    until_first_packet: Spent
    pieces: tuple[Spent, ...]
    second_window: Spent
    """Opened, while nothing else went on; nothing where no second one is needed."""
    windows: int
    """Of the whole run."""
    peak_bytes: int | None
    """As `peak_bytes` has it, with as many windows open as a run keeps."""


def spent_since(began: Spent | None = None) -> Spent:
    """Time spent by this process since it was read before; from an arbitrary zero on without that."""
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    return Spent(wall_s, cpu_s) if began is None else Spent(wall_s - began.wall_s, cpu_s - began.cpu_s)


def peak_bytes() -> int | None:
    """Greatest memory that this process has held so far, or None where the system does not report it.

    `VmHWM` (proc(5)) begins anew with the program; the figure of getrusage(2) would be that of the parent, if it
    was greater.
    """
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii")
    except OSError:
        return None
    return next(
        (1024 * int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM")), None
    )


def try_out(chain: Engine, stop_s: float, threads: int, began: Spent) -> Trial:
    """Carry out pieces of a run, evenly over the first two windows, with all that `record` does but the file.

    Parameters
    ----------
    stop_s : end of the run; pieces may lie beyond that of a short one
    threads : of the chain
    began : reading of the clocks at the start of the command

    Raises
    ------
    InputError
        where the walk is too short to measure on, or a window for so many threads
    """
    batching, motion = chain.batching, chain.parts.motion
    if threads > (most := batching.segment // 3):
        raise InputError("--threads", f"found {threads}", f"at most {most} to measure on")
    block_s, run_time_s = batching.block_ns / S_NS, motion.run_time_s
    least_s, window_s = 3 * threads * block_s, batching.segment * block_s
    end_s = min(run_time_s, max(min(stop_s, 2 * window_s), least_s))
    if end_s < least_s:
        raise InputError("motion", f"found a walk of {run_time_s:.2f} s", f"{least_s:.2f} s to measure on")
    windows = _windows(chain, stop_s)
    pieces, second, first = list[Spent](), Spent(0.0, 0.0), None
    starts_s = np.linspace(0.0, end_s, 1 + min(int(end_s / least_s), _PIECES)).tolist()
    for start_s, next_s in pairwise(starts_s):
        # A piece that reached into the next window would open it by itself.
        span_s = start_s, min(next_s, window_s) if start_s < window_s else next_s
        reached, piece = _piece(chain, span_s, _PIECES_S / _PIECES, threads)
        pieces += [piece] * (piece.simulated_s > 0.0)
        if first is None:
            first = Spent(reached.wall_s - began.wall_s, reached.cpu_s - began.cpu_s, block_s)
            if windows > 1:
                before = spent_since()
                chain.windows.at_block(batching.segment).result()
                second = spent_since(before)
    assert first is not None
    return Trial(first, tuple(pieces), second, windows, peak_bytes())


def _windows(chain: Engine, stop_s: float) -> int:
    if not chain.parts.moves:
        return 1
    return (chain.batching.blocks(0, seconds_to_ns(stop_s)).stop - 1) // chain.batching.segment + 1


def _piece(chain: Engine, span_s: tuple[float, float], limit_s: float, threads: int) -> tuple[Spent, Spent]:
    """Send packets to nowhere until the time is over: clocks at the first one, and what went by from there on."""
    first, piece, marks = None, Spent(0.0, 0.0), dict[int, int]()
    links, block_ns = [unit.link for unit in chain.parts.units], chain.batching.block_ns
    with PcapSink(Path(os.devnull), links) as sink:
        for packet in chain.packets(*span_s):
            sink.send(packet)
            returns_in(packet)
            if packet.kind is not PacketKind.DATA or packet.unit:
                continue
            block = (packet.due_ns - chain.scenario.start_ns - 1) // block_ns
            if first is None:
                first, marks = spent_since(), _marks(chain, block, span_s[1], threads)
            elif blocks := marks.pop(block, 0):
                took = spent_since(first)
                piece = Spent(took.wall_s, took.cpu_s, blocks * block_ns / S_NS)
                if took.wall_s >= limit_s:
                    break
    assert first is not None
    return first, piece


def _marks(chain: Engine, first_block: int, stop_s: float, threads: int) -> dict[int, int]:
    """Blocks at which clocks are read, and how many had been worked on since the first packet came.

    Blocks of a run come at once, and workers finish as many runs as there are threads about together. So when the first
    of them comes, all have been worked on.
    """
    own = threads // len(chain.parts.units) or 1
    blocks = range(first_block, chain.batching.blocks(0, seconds_to_ns(stop_s)).stop)
    runs = list(chain.windows.runs(blocks, chain.parts.units[0].beam.together, own))
    return {runs[n].start: sum(map(len, runs[own : n + own])) for n in range(own, len(runs), own)}
