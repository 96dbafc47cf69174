"""`vlp16emu truth`: where a sensor goes, without what it sees."""

from pathlib import Path
from typing import Annotated

from vlp16emu.cli import arguments as args
from vlp16emu.cli.arguments import argument
from vlp16emu.cli.start import make_emulator, running
from vlp16emu.cli.terminal import finish, size


def truth(
    scene: args.SceneName,
    folder: Annotated[Path, argument("DIR", "Folder to write: new, empty, or of an earlier run.")],
    *,
    duration: args.Duration = None,
    start: args.Start = 0.0,
    settings: args.Settings = None,
    ideal: args.Ideal = False,
    truth_rate: args.TruthRate = 200,
    truth_packets: args.TruthPackets = False,
    truth_returns: args.TruthReturns = False,
    as_json: args.AsJson = False,
) -> None:
    """Write the ground truth of a run without casting its pulses: trajectory, IMU, GNSS, rig, scenario.

    The files are those of `record --truth` over the same span, byte for byte. Ctrl-C ends them early.
    """
    emulator = make_emulator(scene, settings, ideal=ideal)
    from vlp16emu.extras.truth.truth import write_truth
    from vlp16emu.run.options import TruthTo

    with running(emulator, "writing", start, duration) as span:
        wanted = TruthTo(folder, truth_rate, truth_packets, truth_returns)
        simulated_s = write_truth(emulator, wanted, **span)
    sizes = {path.name: path.stat().st_size for path in sorted(folder.iterdir())}
    interrupted = span["stop"].is_set()
    tree = {"folder": str(folder), "files": sizes, "simulated_s": simulated_s, "interrupted": interrupted}
    rows = {"simulated": f"{simulated_s:.1f} s", **{name: size(n) for name, n in sizes.items()}}
    finish(tree, folder, rows, as_json=as_json)
