"""Reading of captures: run time, CPU time and memory of programs for a short capture and for one of hours."""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from rich.box import MARKDOWN
from rich.table import Table
from toolbox import VLP16EMU

REPEAT = Path(__file__).with_name("repeat_capture.py")

PROGRAMS = {  # with the longest captures in passes of the short one
    "verify {}": True,
    "decode {}": True,
    "decode {} --out {out}.npz": False,
    "bag {} {out}.mcap": False,
}


def reading_table(scene: str, seconds: float, passes: int) -> Table:
    """Record a scene, repeat its capture, and read both with each of the programs.

    Parameters
    ----------
    seconds : length of the short capture
    passes : length of the long one, in short ones
    """
    heads = ("capture", "MB", "run time, s", "CPU time, s", "MB per s", "peak, MB")
    title = f"{scene}, load {os.getloadavg()[0]:.1f}"
    table = Table("program", *heads, title=title, box=MARKDOWN)
    with tempfile.TemporaryDirectory() as folder:
        short, long = Path(folder) / "short.pcap", Path(folder) / "long.pcap"
        words = ["record", scene, str(short), "--duration", str(seconds), "--no-audit"]
        subprocess.run([*VLP16EMU, *words], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        subprocess.run([sys.executable, REPEAT, short, long, str(passes), str(seconds)], check=True)
        for words_of, is_long in PROGRAMS.items():
            for capture, length_s in ((short, seconds), (long, seconds * passes))[: 1 + is_long]:
                out = Path(folder) / "out"
                took = _took([word.format(capture, out=out) for word in words_of.split()])
                size_mb = capture.stat().st_size / 1e6
                wall_s, cpu_s, peak_mb = took
                cells = (f"{length_s:g} s", f"{size_mb:.0f}", f"{wall_s:.1f}", f"{cpu_s:.1f}")
                table.add_row(words_of.split()[0], *cells, f"{size_mb / wall_s:.0f}", f"{peak_mb:.0f}")
                for made in Path(folder).glob("out*"):
                    made.unlink()
    return table


def _took(words: list[str]) -> tuple[float, float, float]:
    """Return run time and CPU time in seconds, and peak memory in MB, of the program in a process."""
    began_s = time.perf_counter()
    with subprocess.Popen(
        [*VLP16EMU, *words, "--json"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as process:
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode not in (0, 1):  # 1 where `verify` has findings, as at the seams
        raise SystemExit(f"{' '.join(words)}: exit code {process.returncode}")
    wall_s = time.perf_counter() - began_s
    return wall_s, used.ru_utime + used.ru_stime, used.ru_maxrss * 1024 / 1e6
