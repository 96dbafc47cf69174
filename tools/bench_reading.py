"""Reading of captures: run time, CPU time and memory of programs for a short capture and for one of hours."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import dpkt
from rich.box import MARKDOWN
from rich.table import Table
from toolbox import VLP16EMU, took

REPEAT = Path(__file__).with_name("repeat_capture.py")

DECODER = """
import sys, velodyne_decoder
config = velodyne_decoder.Config(model=velodyne_decoder.Model.VLP16)
print(sum(len(points) for _, points in velodyne_decoder.read_pcap(sys.argv[1], config)))
"""
"""Reads a capture with velodyne_decoder, scan by scan, as `decode` does without a file."""
FINDINGS = (0, 1)  # `verify` has some, as at the seams
ALL = ("short.pcap", "short.pcapng", "long.pcap")
PROGRAMS = {  # command by name, and the captures that it reads
    "verify": ([*VLP16EMU, "verify", "{}", "--json"], ALL),
    "decode": ([*VLP16EMU, "decode", "{}", "--json"], ALL),
    "velodyne_decoder": ([sys.executable, "-c", DECODER, "{}"], ALL[::2]),
    "decode --out npz": ([*VLP16EMU, "decode", "{}", "--json", "--out", "{out}.npz"], ALL[:1]),
    "bag": ([*VLP16EMU, "bag", "{}", "{out}.mcap", "--json"], ALL[:1]),
}


def reading_table(scene: str, seconds: float, passes: int) -> Table:
    """Record a scene, write its capture as pcapng and repeat it, and read all with each of the programs.

    Parameters
    ----------
    seconds : length of the short captures
    passes : length of the long one, in short ones
    """
    heads = ("capture", "MB", "run time, s", "CPU time, s", "MB per CPU s", "peak, MB")
    title = f"{scene}, load {os.getloadavg()[0]:.1f}"
    table = Table("program", *heads, title=title, box=MARKDOWN)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        short, pcapng, long = (folder / each for each in ALL)
        words = ["record", scene, str(short), "--duration", str(seconds), "--no-audit"]
        subprocess.run([*VLP16EMU, *words], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        _write_pcapng(short, pcapng)
        subprocess.run([sys.executable, REPEAT, short, long, str(passes), str(seconds)], check=True)
        lengths = dict(
            zip(ALL, (f"{seconds:g} s", f"{seconds:g} s, pcapng", f"{seconds * passes:g} s"), strict=True)
        )
        for program, (command, captures) in PROGRAMS.items():
            for capture in captures:
                words = [word.format(folder / capture, out=folder / "out") for word in command]
                wall_s, cpu_s, peak_mb = took(words, codes=FINDINGS)
                size_mb = (folder / capture).stat().st_size / 1e6
                cells = (lengths[capture], f"{size_mb:.0f}", f"{wall_s:.1f}", f"{cpu_s:.1f}")
                table.add_row(program, *cells, f"{size_mb / cpu_s:.0f}", f"{peak_mb:.0f}")
                for made in folder.glob("out*"):
                    made.unlink()
    return table


def _write_pcapng(pcap: Path, pcapng: Path) -> None:
    """Write the frames of a capture as pcapng."""
    with pcap.open("rb") as source, pcapng.open("wb") as target:
        writer = dpkt.pcapng.Writer(target)
        for stamp_s, frame in dpkt.pcap.Reader(source):
            writer.writepkt(frame, ts=stamp_s)
