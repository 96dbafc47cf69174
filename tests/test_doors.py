"""Entry points of other packages: checked when they are loaded, and left out with a line if they are broken.

What the metadata of a package may hold follows the specification of entry points of the Python packaging user
guide: any name, any object.
"""

import json
import os
import subprocess
import sys

import pytest

_MODULE = """
import sys
from typing import Callable, Literal
from vlp16emu.motion.settings import MotionSection
from vlp16emu.world.settings import WorldSection
NUMBER = 7
TEXT = "no such folder"
class Bare: pass
def unread(a: "no expression"): pass
class Fault(BaseException): pass
class Noisy:
    def __call__(self): pass
    def __repr__(self): raise Fault("of its own")
noisy = Noisy()
def gives_a_text(): return "done"
class Renamed(WorldSection):
    kind: Literal["other"] = "other"
class Opaque(MotionSection):
    kind: Literal["opaque"] = "opaque"
    call: Callable[[], int] | None = None
"""
_LEAVES = "raise SystemExit('gone')"
_FAILS = "class Fault(BaseException): pass\nraise Fault('of its own')"
_ENTRIES = """
[vlp16emu.worlds]
number = damaged:NUMBER
bare = damaged:Bare
renamed = damaged:Renamed
leaves = leaves
fails = fails
[vlp16emu.motions]
opaque = damaged:Opaque
[vlp16emu.sensors]
world = damaged:Renamed
[vlp16emu.scenes]
text = damaged:TEXT
number = damaged:NUMBER
leaves = leaves
bad place = not a module!!
[vlp16emu.clouds]
.xyz = damaged:Bare
[vlp16emu.verbs]
seven = damaged:NUMBER
leave = leaves
unread = damaged:unread
noisy = damaged:noisy
gives = damaged:gives_a_text
"""
_RUN = """
import sys
from vlp16emu.cli.app import run
print(*(run(line.split()) for line in sys.argv[1:]), file=sys.stderr)
"""
_LINES = {
    "worlds": {
        "number": "found a int; expected a class on vlp16emu.world.settings:WorldSection",
        "bare": "found the class Bare; expected a class on vlp16emu.world.settings:WorldSection",
        "renamed": 'found the class Renamed; expected a class with kind: Literal["renamed"]',
        "leaves": "SystemExit: gone; expected leaves, which can be imported",
        "fails": "Fault: of its own; expected fails, which can be imported",
    },
    "motions": {"opaque": "PydanticInvalidForJsonSchema: "},
    "sensors": {"world": "found the class Renamed; expected a class on vlp16emu.sensor.settings:Lidar"},
    "scenes": {
        "text": "found 'no such folder'; expected the path of a folder",
        "number": "found a int; expected the path of a folder",
        "leaves": "SystemExit: gone; expected leaves, which can be imported",
        "bad place": "",
    },
}
_COMMANDS = (
    "scenes --json",
    "schema",
    "truth no_such_scene t",
    "seven",
    "leave",
    "unread",
    "noisy",
    "gives",
    "points static_bench x.xyz",
)


@pytest.fixture(scope="module")
def said(tmp_path_factory):
    """Standard output and lines of errors of commands beside a package with broken entry points only."""
    folder = tmp_path_factory.mktemp("damaged")
    for name, text in (("damaged", _MODULE), ("leaves", _LEAVES), ("fails", _FAILS)):
        (folder / f"{name}.py").write_text(text)
    for name, entries in (("damaged", _ENTRIES), ("garbled", "[vlp16emu.worlds]\nno assignment\n")):
        info = folder / f"{name}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(entries)
    path = os.pathsep.join((str(folder), *filter(None, sys.path)))
    done = subprocess.run(
        [sys.executable, "-c", _RUN, *_COMMANDS],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ
        | {"PYTHONPATH": path, "PYDANTIC_DISABLE_PLUGINS": "__all__"},  # as the program sets it
        cwd=folder,
    )
    return done.stdout, done.stderr.splitlines()


def test_verbs_work_beside_broken_entry_points(said):
    """`scenes` and `schema` print all that is ours, an unknown name of a scene is bad input, and so is what
    is broken where it is named."""
    out, lines = said
    assert lines[-1] == "0 0 2 2 2 2 2 0 2"
    decoder = json.JSONDecoder()
    scenes, end = decoder.raw_decode(out)
    schema, _ = decoder.raw_decode(out[end:].lstrip())
    assert "birch_walk" in {row["name"] for row in scenes["scenes"]}
    assert {*schema["properties"]["world"]["discriminator"]["mapping"]} >= {"forest", "hall", "plot"}
    assert any("unknown name" in line for line in lines)


@pytest.mark.parametrize(
    ("group", "name", "reason"),
    [(group, name, reason) for group, rows in _LINES.items() for name, reason in rows.items()],
)
def test_a_broken_entry_point_is_left_out_with_a_line(said, group, name, reason):
    """The line names the distribution, the entry point and its group, and the reason."""
    where = f"damaged: entry point {name} of vlp16emu.{group}: {reason}"
    assert any(where in line and line.endswith("it is left out") for line in said[1])


@pytest.mark.parametrize(
    "name",
    [
        "seven of vlp16emu.verbs",
        "leave of vlp16emu.verbs",
        "unread of vlp16emu.verbs",
        "noisy of vlp16emu.verbs",
        ".xyz of vlp16emu.clouds",
    ],
)
def test_a_broken_entry_point_that_is_named_is_bad_input(said, name):
    """A verb and a format of points are refused in one line that names who has broken them."""
    assert sum(line.startswith(f"error: damaged: entry point {name}: ") for line in said[1]) == 1


def test_a_list_of_entry_points_that_cannot_be_read_is_named(said):
    """A package whose list is no such file costs a line, and no other package its entry points."""
    assert any("garbled: entry points that cannot be read" in line for line in said[1])
