"""Parts outside the core: each is what the core says that it is. mypy reads this file too, and compares their types."""

import ast
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import vlp16emu
from vlp16emu.doors import Part
from vlp16emu.extras.bench.events import checked, tables
from vlp16emu.extras.camera.settings import Camera
from vlp16emu.extras.imu.settings import Imu
from vlp16emu.extras.meshes.furnished import furnished
from vlp16emu.extras.meshes.settings import MeshFile
from vlp16emu.forest.make import ForestSite
from vlp16emu.forest.settings import FOREST_SITE, Wind
from vlp16emu.scenario.model import CAMERA_SECTION, CHECKED_EVENTS, EVENT_TABLES, IMU_SECTION, WIND_SECTION
from vlp16emu.world.hall import HallWorld
from vlp16emu.world.settings import FURNISHED, HALL_SITE, MESH_SECTION

T = TypeVar("T")


def loads(part: Part[T]) -> Callable[[T], tuple[Part[Any], object]]:
    """Return a function that pairs a part with the object that it loads, which mypy compares with the part's type."""
    return lambda found: (part, found)


PARTS = (
    loads(IMU_SECTION)(Imu),
    loads(CAMERA_SECTION)(Camera),
    loads(WIND_SECTION)(Wind),
    loads(MESH_SECTION)(MeshFile),
    loads(EVENT_TABLES)(tables),
    loads(CHECKED_EVENTS)(checked),
    loads(FURNISHED)(furnished),
    loads(HALL_SITE)(HallWorld),
    loads(FOREST_SITE)(ForestSite),
)


def test_a_part_loads_the_object_whose_type_is_compared() -> None:
    """The place of each part leads to the object that mypy compares with the part's type."""
    assert [part.place for part, found in PARTS if part.load() is not found] == []


def test_every_part_is_compared() -> None:
    """Every `Part` that a module of the package declares is in the list above."""
    declared = set()
    for path in Path(vlp16emu.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Subscript):
                name = node.func.value
                if isinstance(name, ast.Name) and name.id == "Part":
                    declared.add(ast.literal_eval(node.args[0]))
    assert declared == {part.place for part, _ in PARTS}
