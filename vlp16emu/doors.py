"""What the core loads by name and only when a scene or an option asks for it."""

from importlib import import_module
from importlib.util import find_spec
from typing import Annotated, Any, Union

from vlp16emu.errors import InputError

DOORS = {
    "audit": "vlp16emu.extras.accuracy.audit:Audit",
    "bag": "vlp16emu.extras.bag:bag_of_run",
    "beside": "vlp16emu.extras.bench.beside:Beside",
    "events": "vlp16emu.extras.bench.changes:with_events",
    "events_of_scene": "vlp16emu.extras.bench.events:checked",
    "events_schema": "vlp16emu.extras.bench.events:tables",
    "far": "vlp16emu.foliage.far_caster:FarCaster",
    "faults": "vlp16emu.extras.bench.faults:arriving",
    "forest_site": "vlp16emu.forest.make:ForestSite",
    "hall_site": "vlp16emu.world.hall:HallSite",
    "live": "vlp16emu.extras.live.flight:flying",
    "live_motion": "vlp16emu.extras.live.motion:live_motion",
    "truth": "vlp16emu.extras.truth.truth:Truth",
    "truth_of_records": "vlp16emu.extras.truth.behind:slots_of",
    "web": "vlp16emu.extras.bench.control:web_interfaces",
}
"""What stands behind each name, as module:name."""

SECTIONS = {
    "world": (
        "vlp16emu.forest.stand.settings:Forest",
        "vlp16emu.forest.stand.settings:Plot",
        "vlp16emu.world.settings:Hall",
    )
}
"""Kinds of a table of a scene, each with a `kind` of its own."""


def sections(name: str) -> Any:
    """Return the type of a table of a scene: one of the sections of `SECTIONS` that are installed."""
    from pydantic import Field  # here: who opens another door needs none

    found = [getattr(import_module(m), c) for m, _, c in (s.partition(":") for s in SECTIONS[name]) if _is_there(m)]
    if len(found) == 1:
        return found[0]
    return Annotated[Union[tuple(found)], Field(discriminator="kind")]  # noqa: UP007  # as many as are installed


def has_door(name: str) -> bool:
    """Whether what stands behind a name of `DOORS` is installed."""
    return _is_there(DOORS[name].partition(":")[0])


def _is_there(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:
        return False


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
