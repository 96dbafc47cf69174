"""From the name of a scene, or a path, to its file."""

import os
from collections.abc import Iterator
from importlib import resources
from pathlib import Path

from vlp16emu.errors import ScenarioError

__all__ = ["find", "scene_files"]


def _folders() -> Iterator[Path]:
    """Where scenes are looked for, best first."""
    if own := os.environ.get("VLP16EMU_SCENES"):
        yield Path(own)
    package = Path(str(resources.files("vlp16emu")))
    # A checkout has scenes/ beside the package; a copy inside it would be stale there.
    checkout = package.parent / "scenes"
    yield checkout if (package.parent / "pyproject.toml").is_file() else package / "scenes"


def scene_files() -> dict[str, Path]:
    """All scenes that can be called by name, sorted."""
    found: dict[str, Path] = {}
    for folder in _folders():
        for path in folder.glob("*.toml"):
            found.setdefault(path.stem, path)
    return dict(sorted(found.items()))


def find(scene: str) -> Path:
    """Path of a scene given by name or path; a path is not yet looked at.

    Raises
    ------
    ScenarioError
        where there is no scene of that name
    """
    path = Path(scene)
    if path.suffix in (".toml", ".json") or path.parent != Path():
        return path
    known = scene_files()
    if scene not in known:
        raise ScenarioError(
            f"scene '{scene}'", "unknown name", f"{', '.join(known)}, or a path ending in .toml"
        )
    return known[scene]
