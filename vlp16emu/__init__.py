"""Hardware-in-the-loop emulator of the Velodyne VLP-16 lidar.

`Emulator` makes scans, captures and streams of a scene, `stream` yields packets while they are made, `load`
reads a scene, `decode` gives the scans of a capture, and `verify` checks it against the rules of VLP-16
traffic. Names load on first use.
"""

from importlib import import_module

TYPE_CHECKING = False  # not from typing, which takes a third of the package's start
if TYPE_CHECKING:
    from vlp16emu.extras.clouds.points import write_points
    from vlp16emu.extras.clouds.scan import decode
    from vlp16emu.extras.handle import Live, stream
    from vlp16emu.extras.replay import Replayed, replay
    from vlp16emu.extras.truth.truth import write_truth
    from vlp16emu.extras.verify.frames import Finding
    from vlp16emu.extras.verify.run import Verification, verify
    from vlp16emu.run.emulator import Emulator
    from vlp16emu.run.options import GpsIn, Http, Outlets, PosesIn, TruthTo
    from vlp16emu.run.part import StreamPart
    from vlp16emu.run.report import Recording
    from vlp16emu.scenario import Scenario, load
    from vlp16emu.types import Labels, Scan

__all__ = ["Emulator", "decode", "load", "replay", "stream", "verify", "write_points", "write_truth"]
__all__ += ["GpsIn", "Http", "Outlets", "PosesIn", "TruthTo"]  # options
__all__ += ["Finding", "Labels", "Live", "Recording", "Replayed", "Scan", "Scenario", "StreamPart"]
__all__ += ["Verification"]

_MODULES = {
    "run.emulator": "Emulator",
    "extras.clouds.points": "write_points",
    "extras.clouds.scan": "decode",
    "extras.handle": "Live stream",
    "extras.replay": "Replayed replay",
    "extras.truth.truth": "write_truth",
    "extras.verify.frames": "Finding",
    "extras.verify.run": "Verification verify",
    "run.options": "GpsIn Http Outlets PosesIn TruthTo",
    "run.part": "StreamPart",
    "run.report": "Recording",
    "scenario": "Scenario load",
    "types": "Labels Scan",
}
_PLACES = {
    name: module for module, names in _MODULES.items() for name in names.split()
}  # public name -> its module


def __getattr__(name: str) -> object:
    """Load a public name when it is first used."""
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_PLACES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names, loaded or not."""
    return sorted({*globals(), *__all__})
