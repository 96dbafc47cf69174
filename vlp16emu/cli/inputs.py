"""The scene of a run whose outputs take the place of none of its inputs."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from vlp16emu.cli.start import load_numba

if TYPE_CHECKING:
    from vlp16emu.scenario import Scenario

__all__ = ["load_for"]


def load_for(
    outputs: Sequence[Path | None], scene: str, settings: Sequence[str] | None, *, ideal: bool = False
) -> "Scenario":
    """Read a scene and apply settings to it.

    Parameters
    ----------
    outputs : files that the run is to write; None for those that are not wanted
    scene, settings, ideal : as `load` takes them

    Raises
    ------
    ScenarioError
        where the file or a setting is no scene
    OutputError
        where an output is the scene's own file, or one that it names
    """
    from vlp16emu.errors import spare
    from vlp16emu.scenario import find, load

    scenario = load(scene, settings or (), ideal=ideal)
    load_numba()  # now: no mistake should wait for it
    from vlp16emu.assembly.files import named_files

    inputs = [find(scene), *named_files(scenario)]
    for output in outputs:
        if output is not None:
            spare(inputs, output)
    return scenario
