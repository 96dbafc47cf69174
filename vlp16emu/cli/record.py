"""`vlp16emu record`: a scene into a pcap file or a bag."""

import sys
import time
from contextlib import nullcontext, redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from vlp16emu.cli import arguments as args
from vlp16emu.cli.printer import finish
from vlp16emu.cli.start import make_emulator, running
from vlp16emu.errors import OutputError
from vlp16emu.options import Option
from vlp16emu.run.options import RecordOptions


def record(
    scene: args.SceneName,
    out: Annotated[
        str,
        Option(
            "File to write, classic pcap (.pcap, .cap, .dump or no ending); overwritten if it exists. - is standard output; the report "
            "then goes to stderr. With .mcap (ROS 2), .bag (ROS 1), or a slash at its end (new folder, ROS 2) a bag, with the truth in it.",
            name="OUT",
        ),
    ],
    options: RecordOptions,
    *,
    settings: args.Settings = None,
    ideal: args.Ideal = False,
    threads: args.Threads = 0,
    audit: args.Audit = True,
    as_json: args.AsJson = False,
) -> None:
    """Record a scene into a pcap file, or a bag.

    The file holds data and position packets in order of sending, in the frames of a real sensor and
    stamped with simulated time. Ctrl-C ends it early and leaves a valid file. Until its end it is
    OUT.xxxxxxxx.part, which after kill -9 holds all whole packets.
    """
    from vlp16emu.output import STDOUT

    if Path(out) == STDOUT and sys.stdout is None:
        raise OutputError("standard output", "closed", "a file or a pipe")
    began_s = time.perf_counter()
    emulator = make_emulator(scene, settings, ideal=ideal, threads=threads, audit=audit)
    with running(emulator, "recording", options) as hooks:
        recording = emulator.record(out, **vars(options), **hooks)
    recording = replace(recording, wall_s=time.perf_counter() - began_s)  # of the whole command
    with redirect_stdout(sys.stderr) if Path(out) == STDOUT else nullcontext():
        finish(recording, as_json=as_json)
