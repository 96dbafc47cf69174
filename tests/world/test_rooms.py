"""The rooms within the world, and what each may import."""

import ast
from pathlib import Path

import vlp16emu

WORLD = Path(vlp16emu.__file__).parent / "world"
ORDER = ("ground", "tiles", "plants", "stand", "given", "make")
"""From the bottom; all other files are below them, but for `__init__`."""


def floor_of(room):
    return ORDER.index(room) if room in ORDER else -1


def test_rooms_import_downwards():
    """A file of the world imports from its own room and from lower ones: ground, tiles, plants, stand, given, make."""
    found = []
    for path in WORLD.rglob("*.py"):
        room = path.relative_to(WORLD).parts[0].removesuffix(".py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("vlp16emu.world."):
                target = (node.module or "").split(".")[2]
                if floor_of(target) > floor_of(room) and room not in ("__init__", "twin"):
                    found.append(f"{path.relative_to(WORLD)} imports {node.module}")
    assert found == []
