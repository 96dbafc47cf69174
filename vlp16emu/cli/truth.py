"""`vlp16emu truth`: where a sensor goes, without what it sees."""

from pathlib import Path
from typing import Annotated

from vlp16emu.cli import arguments as args
from vlp16emu.cli.printer import finish, size
from vlp16emu.cli.start import make_emulator, running
from vlp16emu.options import Option
from vlp16emu.run.options import Span, TruthPackets, TruthRate, TruthReturns, TruthTo


def truth(
    scene: args.SceneName,
    folder: Annotated[Path, Option("Folder to write: new, empty, or of an earlier run.", name="DIR")],
    span: Span,
    *,
    rate_hz: TruthRate = TruthTo.rate_hz,
    per_packet: TruthPackets = TruthTo.per_packet,
    per_return: TruthReturns = TruthTo.per_return,
    settings: args.Settings = None,
    ideal: args.Ideal = False,
    as_json: args.AsJson = False,
) -> None:
    """Write the ground truth of a run without casting its pulses: trajectory, IMU, GNSS, rig, scenario.

    The files are those of `record --truth` over the same span, byte for byte. Ctrl-C ends them early.
    """
    emulator = make_emulator(scene, settings, ideal=ideal)
    from vlp16emu.extras.truth.truth import write_truth

    with running(emulator, "writing", span) as hooks:
        simulated_s = write_truth(emulator, TruthTo(folder, rate_hz, per_packet, per_return), **vars(span), **hooks)
    sizes = {path.name: path.stat().st_size for path in sorted(folder.iterdir())}
    found = {"folder": folder, "simulated_s": simulated_s, "interrupted": hooks["stop"].is_set()}
    finish(found | ({"files": sizes} if as_json else {name: size(n) for name, n in sizes.items()}), as_json=as_json)
