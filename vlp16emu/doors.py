"""What the core loads by name and only when a scene or an option asks for it."""

from importlib import import_module
from typing import Any

from vlp16emu.errors import InputError

DOORS = {
    "audit": "vlp16emu.extras.accuracy.audit:Audit",
    "bag": "vlp16emu.extras.bag:bag_of_run",
    "beside": "vlp16emu.extras.bench.beside:Beside",
    "faults": "vlp16emu.extras.bench.wire:arriving",
    "live": "vlp16emu.extras.live.flight:flying",
    "live_motion": "vlp16emu.extras.live.motion:live_motion",
    "truth": "vlp16emu.extras.truth.truth:Truth",
    "truth_of_records": "vlp16emu.extras.truth.behind:slots_of",
    "web": "vlp16emu.extras.bench.control:web_interfaces",
}
"""What stands behind each name, as module:name."""


def door(name: str) -> Any:
    """Return what stands behind a name of `DOORS`.

    Raises
    ------
    InputError
        If its part of the package is not installed
    """
    module, _, attribute = DOORS[name].partition(":")
    try:
        return getattr(import_module(module), attribute)
    except ModuleNotFoundError as error:
        if error.name is None or not error.name.startswith("vlp16emu"):
            raise
        raise InputError(name, f"no module {error.name}", "a complete installation") from None
