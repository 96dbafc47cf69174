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

DECODER = """
import sys, velodyne_decoder
config = velodyne_decoder.Config(model=velodyne_decoder.Model.VLP16)
print(sum(len(points) for _, points in velodyne_decoder.read_pcap(sys.argv[1], config)))
"""
"""Reads a capture with velodyne_decoder, scan by scan, as `decode` does without a file."""
PROGRAMS = {  # command by name, and whether it also reads the long capture
    "verify": ([*VLP16EMU, "verify", "{}", "--json"], True),
    "decode": ([*VLP16EMU, "decode", "{}", "--json"], True),
    "velodyne_decoder": ([sys.executable, "-c", DECODER, "{}"], True),
    "decode --out npz": ([*VLP16EMU, "decode", "{}", "--json", "--out", "{out}.npz"], False),
    "bag": ([*VLP16EMU, "bag", "{}", "{out}.mcap", "--json"], False),
}


def reading_table(scene: str, seconds: float, passes: int) -> Table:
    """Record a scene, repeat its capture, and read both with each of the programs.

    Parameters
    ----------
    seconds : length of the short capture
    passes : length of the long one, in short ones
    """
    heads = ("capture", "MB", "run time, s", "CPU time, s", "MB per CPU s", "peak, MB")
    title = f"{scene}, load {os.getloadavg()[0]:.1f}"
    table = Table("program", *heads, title=title, box=MARKDOWN)
    with tempfile.TemporaryDirectory() as folder:
        short, long = Path(folder) / "short.pcap", Path(folder) / "long.pcap"
        words = ["record", scene, str(short), "--duration", str(seconds), "--no-audit"]
        subprocess.run([*VLP16EMU, *words], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        subprocess.run([sys.executable, REPEAT, short, long, str(passes), str(seconds)], check=True)
        for name, (command, is_long) in PROGRAMS.items():
            for capture, length_s in ((short, seconds), (long, seconds * passes))[: 1 + is_long]:
                out = Path(folder) / "out"
                took = _took([word.format(capture, out=out) for word in command])
                size_mb = capture.stat().st_size / 1e6
                wall_s, cpu_s, peak_mb = took
                cells = (f"{length_s:g} s", f"{size_mb:.0f}", f"{wall_s:.1f}", f"{cpu_s:.1f}")
                table.add_row(name, *cells, f"{size_mb / cpu_s:.0f}", f"{peak_mb:.0f}")
                for made in Path(folder).glob("out*"):
                    made.unlink()
    return table


def _took(command: list[str]) -> tuple[float, float, float]:
    """Return run time and CPU time in seconds, and peak memory in MB, of the program in a process."""
    began_s = time.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode not in (0, 1):  # 1 where `verify` has findings, as at the seams
        raise SystemExit(f"{' '.join(command)}: exit code {process.returncode}")
    wall_s = time.perf_counter() - began_s
    return wall_s, used.ru_utime + used.ru_stime, used.ru_maxrss * 1024 / 1e6
