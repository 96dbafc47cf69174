"""The files that a scenario names."""

from collections.abc import Iterator
from pathlib import Path
from typing import get_args, get_type_hints

from vlp16emu.scenario import Scenario
from vlp16emu.settings import SceneFile, Section

__all__ = ["named_files"]


def named_files(scenario: Scenario) -> list[Path]:
    """List the files that a scenario is made of beside its own: poses, way points, heights, trees, meshes."""
    return list(_named_in(scenario))


def _named_in(value: object) -> Iterator[Path]:
    """Find the files of a section and of all that it holds."""
    if isinstance(value, Section):
        kinds = get_type_hints(type(value), include_extras=True)
        for key, inner in value:
            if isinstance(inner, str) and SceneFile in (kinds[key], *get_args(kinds[key])):
                yield Path(inner)
            yield from _named_in(inner)
    elif isinstance(value, list | tuple):
        for inner in value:
            yield from _named_in(inner)
