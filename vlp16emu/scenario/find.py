"""From the name of a scene, or a path, to its file; and the files that a scenario names."""

import difflib
import os
from collections.abc import Iterable, Iterator
from importlib import resources
from pathlib import Path
from typing import get_args, get_type_hints

from vlp16emu.doors import added
from vlp16emu.errors import ScenarioError
from vlp16emu.settings import SceneFile, Section


def _folders() -> Iterator[Path]:
    """Yield the folders of scenes, in order of precedence."""
    if own := os.environ.get("VLP16EMU_SCENES"):
        yield Path(own)
    package = Path(str(resources.files("vlp16emu")))
    # A checkout has scenes/ beside the package; a copy inside it would be stale there.
    checkout = package.parent / "scenes"
    yield checkout if (package.parent / "pyproject.toml").is_file() else package / "scenes"


def scene_files() -> dict[str, Path]:
    """Return all scenes by name, sorted: files, and folders with a file of their name in them.

    Those of other packages, in the folders of their entry points `vlp16emu.scenes`, come last.
    """
    found = _scenes_in(_folders())
    return dict(sorted((_scenes_in(Path(folder) for _, folder in added("scenes")) | found).items()))


def _scenes_in(folders: Iterable[Path]) -> dict[str, Path]:
    found: dict[str, Path] = {}
    for folder in folders:
        own = (path for path in folder.glob("*/*.toml") if path.stem == path.parent.name)
        for path in (*folder.glob("*.toml"), *own):
            found.setdefault(path.stem, path)
    return found


def find(scene: str) -> Path:
    """Return the path of a scene given by name, with _ or - in it, or by path; whether a path exists is not checked.

    Raises ScenarioError if there is no scene of that name.
    """
    path = Path(scene)
    if path.suffix in (".toml", ".json") or path.parent != Path():
        return path
    known = _scenes_in(_folders())
    name = scene if scene in known else scene.replace("-", "_")
    if name not in known:
        known = scene_files()
        name = scene if scene in known else name
    if name not in known:
        near = difflib.get_close_matches(name.lower(), known, n=1)
        names = f"{near[0]}, the nearest of `vlp16emu scenes`" if near else ", ".join(known)
        raise ScenarioError(f"scene '{scene}'", "unknown name", f"{names}, or a path ending in .toml")
    return known[name]


def named_files(scenario: object) -> list[Path]:
    """Return the files that a scenario, or a part of one, names: poses, waypoints, heights, trees, meshes."""
    own, parts = list[Path](), list(scenario) if isinstance(scenario, list | tuple) else []
    if isinstance(scenario, Section):
        kinds, parts = get_type_hints(type(scenario), include_extras=True), [inner for _, inner in scenario]
        named = (key for key, inner in scenario if isinstance(inner, str))
        own = [Path(getattr(scenario, key)) for key in named if SceneFile in (kinds[key], *get_args(kinds[key]))]
    return [*own, *(file for part in parts for file in named_files(part))]
