"""`vlp16emu truth`: where a sensor goes, without what it sees."""

from pathlib import Path
from typing import Annotated

import typer

from vlp16emu.cli.arguments import (
    AsJson,
    Duration,
    Ideal,
    SceneName,
    Settings,
    Start,
    TruthPackets,
    TruthRate,
    TruthReturns,
)
from vlp16emu.cli.start import make_emulator
from vlp16emu.cli.terminal import INTERRUPTED, Progress, print_json, print_rows, size, stop_on_ctrl_c

Folder = Annotated[
    Path, typer.Argument(metavar="DIR", help="Folder to write: new, empty, or of an earlier run.", show_default=False)
]


def truth(
    scene: SceneName,
    folder: Folder,
    *,
    duration: Duration = None,
    start: Start = 0.0,
    settings: Settings = None,
    ideal: Ideal = False,
    truth_rate: TruthRate = 200,
    truth_packets: TruthPackets = False,
    truth_returns: TruthReturns = False,
    as_json: AsJson = False,
) -> None:
    """Write the ground truth of a run without casting its pulses: trajectory, IMU, GNSS, rig, scenario.

    The files are those of `record --truth` over the same span, byte for byte. Ctrl-C ends them early.
    """
    emulator = make_emulator(scene, settings, ideal=ideal)
    from vlp16emu.extras.truth.truth import write_truth
    from vlp16emu.run.options import TruthTo

    start_s, stop_s = emulator.scenario.span_s(start, duration, where="--start")
    with stop_on_ctrl_c() as stop, Progress(stop_s - start_s) as progress:
        simulated_s = write_truth(
            emulator,
            TruthTo(folder, truth_rate, truth_packets, truth_returns),
            start_s=start,
            duration_s=duration,
            progress=lambda done_s: progress.show("writing", done_s),
            stop=stop,
        )
    sizes = {path.name: path.stat().st_size for path in sorted(folder.iterdir())}
    if as_json:
        print_json({"folder": str(folder), "files": sizes, "simulated_s": simulated_s, "interrupted": stop.is_set()})
    else:
        rows = {"simulated": f"{simulated_s:.1f} s", **{name: size(n) for name, n in sizes.items()}}
        print_rows(f"{'interrupted, kept' if stop.is_set() else 'wrote'} {folder}", rows)
    if stop.is_set():
        raise typer.Exit(INTERRUPTED)
