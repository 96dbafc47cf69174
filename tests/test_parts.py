"""Parts outside the core: each is what the core says that it is. mypy reads this file too, and compares
their types."""

import ast
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import vlp16emu
from vlp16emu.captures.capture import FRAMES, UNWRAPPER
from vlp16emu.doors import Part
from vlp16emu.engine.build import EVENTS, IMU, PEOPLE
from vlp16emu.engine.engine import FAULTS
from vlp16emu.extras.accuracy.audit import Audit
from vlp16emu.extras.bag.write import bag_of_run
from vlp16emu.extras.bench.changes import with_events
from vlp16emu.extras.bench.control import WebInterfaces
from vlp16emu.extras.bench.events import check_events, event_adapter
from vlp16emu.extras.bench.faults import arriving_packets
from vlp16emu.extras.bench.gps_in import GpsReader
from vlp16emu.extras.bench.outlets import DevicePackets, OutletSinks
from vlp16emu.extras.bench.retime import Present
from vlp16emu.extras.camera.settings import Camera
from vlp16emu.extras.captures.containers import frames
from vlp16emu.extras.captures.links import Unwrapper
from vlp16emu.extras.clouds.scan import scans_of
from vlp16emu.extras.displace import displace
from vlp16emu.extras.field import in_the_field
from vlp16emu.extras.free_ports import free_ports
from vlp16emu.extras.imu.sampler import sampler_of
from vlp16emu.extras.imu.settings import Imu
from vlp16emu.extras.live.flight import Flight
from vlp16emu.extras.meshes.files import load_mesh
from vlp16emu.extras.meshes.furnish import furnish
from vlp16emu.extras.meshes.settings import MeshFile
from vlp16emu.extras.outlook import Outlook
from vlp16emu.extras.people import People
from vlp16emu.extras.replay import prepared
from vlp16emu.extras.truth.slots import slots_of
from vlp16emu.extras.truth.truth import Truth
from vlp16emu.foliage.far import far_caster
from vlp16emu.forest.make import ForestSite
from vlp16emu.forest.settings import FOREST_SITE, Wind
from vlp16emu.forest.stand.tree_models import LOAD_MESH
from vlp16emu.raycast.caster import FAR
from vlp16emu.raycast.near import DISPLACE
from vlp16emu.run.emulator import AUDIT, SCANS, TRUTH, TRUTH_OF_RECORDS
from vlp16emu.run.feed import BESIDE
from vlp16emu.run.record import BAG
from vlp16emu.run.scene_stream import FREE_PORTS, GPS_IN, LIVE, OUTLETS, OUTLOOK, PREPARED, WEB
from vlp16emu.run.stream import PRESENT
from vlp16emu.scenario.load import FIELD
from vlp16emu.scenario.model import CAMERA_SECTION, CHECKED_EVENTS, EVENT_TABLES, IMU_SECTION, WIND_SECTION
from vlp16emu.world.hall import HallWorld
from vlp16emu.world.settings import FURNISH, HALL_SITE, MESH_SECTION

T = TypeVar("T")


def loads(part: Part[T]) -> Callable[[T], tuple[Part[Any], object]]:
    """Return a function that pairs a part with the object that it loads, which mypy compares with the
    part's type."""
    return lambda found: (part, found)


PARTS = (
    loads(AUDIT)(Audit),
    loads(BAG)(bag_of_run),
    loads(BESIDE)(DevicePackets),
    loads(CAMERA_SECTION)(Camera),
    loads(CHECKED_EVENTS)(check_events),
    loads(DISPLACE)(displace),
    loads(EVENTS)(with_events),
    loads(EVENT_TABLES)(event_adapter),
    loads(FAR)(far_caster),
    loads(FAULTS)(arriving_packets),
    loads(FIELD)(in_the_field),
    loads(FOREST_SITE)(ForestSite),
    loads(FRAMES)(frames),
    loads(FREE_PORTS)(free_ports),
    loads(FURNISH)(furnish),
    loads(GPS_IN)(GpsReader),
    loads(HALL_SITE)(HallWorld),
    loads(IMU)(sampler_of),
    loads(IMU_SECTION)(Imu),
    loads(LIVE)(Flight),
    loads(LOAD_MESH)(load_mesh),
    loads(MESH_SECTION)(MeshFile),
    loads(OUTLETS)(OutletSinks),
    loads(OUTLOOK)(Outlook),
    loads(PEOPLE)(People),
    loads(PREPARED)(prepared),
    loads(PRESENT)(Present),
    loads(SCANS)(scans_of),
    loads(TRUTH)(Truth),
    loads(TRUTH_OF_RECORDS)(slots_of),
    loads(UNWRAPPER)(Unwrapper),
    loads(WEB)(WebInterfaces),
    loads(WIND_SECTION)(Wind),
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
