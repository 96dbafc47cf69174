"""The house rules, read from the source with `ast`."""

import ast
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "vlp16emu"
FILES = sorted(PACKAGE.rglob("*.py"))
NAMES = [str(path.relative_to(PACKAGE)) for path in FILES]

FLOORS = (
    {"__main__"},
    {"cli"},
    {"fidelity", "truth"},
    {"emulator"},
    {"telemetry"},
    {"assembly"},
    {"report", "sinks", "device", "scenario", "pipeline"},
    {"packets"},
    {"returns"},
    {"raycast"},
    {"sensor", "motion", "world"},
    {"errors", "random", "store", "trig", "types", "units", "compiled"},
)
"""From the top. Imports run down, past any number of floors, never sideways; foundations may stand on each other."""

FLOOR_OF = {room: number for number, floor in enumerate(FLOORS) for room in floor}
FOUNDATIONS = FLOORS[-1]

LIBRARIES = {
    # third-party or system module: where it may be imported
    "ctypes": ("raycast/embree", "sinks/timer_slack.py"),
    "embreex": ("raycast/embree", "raycast/slow.py"),
    "serial": ("sinks/", "device/"),
    "socket": ("sinks/", "device/"),
    "typer": ("cli/",),
    "rich": ("cli/",),
    "pydantic": ("scenario/",),
}


def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def imports(tree: ast.AST) -> Iterator[str]:
    """Full names of modules and of what is taken from them, wherever in the file they are imported."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: relative import"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def functions(tree: ast.AST) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    return (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))


def public(body: list[ast.stmt]) -> Iterator[ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef]:
    """Public functions and classes of a module, and the public methods of those classes."""
    for node in body:
        if isinstance(
            node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
        ) and not node.name.startswith("_"):
            yield node
            if isinstance(node, ast.ClassDef):
                yield from public(node.body)


def room_of(name: str) -> str:
    """Folder of a file, or the module itself where it stands in none."""
    return name.partition("/")[0].removesuffix(".py")


def trespasses(name: str, tree: ast.AST) -> list[str]:
    """List what a file imports of ours that is on its own floor or above."""
    room = room_of(name)
    if room == "__init__":
        return []
    found = []
    for full in imports(tree):
        target = full.removeprefix("vlp16emu.").split(".")[0]
        if not full.startswith("vlp16emu.") or target == room or room in FOUNDATIONS >= {target}:
            continue
        if FLOOR_OF.get(target, 0) <= FLOOR_OF[room]:
            found.append(full)
    return found


def taken_at_once(name: str, tree: ast.Module) -> set[str]:
    """Modules of ours that a file imports as it is loaded, and not within a function."""
    taken = set[str]()
    for node in tree.body:
        for full in imports(node) if isinstance(node, ast.Import | ast.ImportFrom) else ():
            parts = full.split(".")
            paths = ["/".join(stem[1:]) for stem in (parts, parts[:-1])]
            files = [
                file for path in paths for file in (f"{path}.py", f"{path}/__init__.py") if file in NAMES
            ]
            taken |= set(files[:1])
    return taken - {name}


def test_every_room_stands_on_one_floor():
    """Each folder and each module of the package has its place, and every place is taken."""
    there = {room_of(name) for name in NAMES} - {"__init__"}
    assert there == set(FLOOR_OF)
    assert sum(map(len, FLOORS)) == len(FLOOR_OF)


@pytest.mark.parametrize("name", NAMES)
def test_arrows_run_down(name):
    """A file imports of ours only its own room, rooms of lower floors and the foundations."""
    assert trespasses(name, parsed(PACKAGE / name)) == []


def test_a_trespass_would_be_seen():
    """The rule above catches an import from above or from beside, however it is written."""
    for line in (
        "import vlp16emu.world.tree",
        "from vlp16emu.world import Forest",
        "from vlp16emu import world",
        "from vlp16emu.raycast.beam import ROUND",
    ):
        assert trespasses("motion/walk.py", ast.parse(f"def f():\n    {line}")), line
        assert trespasses("units.py", ast.parse(line)), line
    assert not trespasses("raycast/far.py", ast.parse("from vlp16emu.world.tiles import TILE_M"))
    assert not trespasses("sinks/udp.py", ast.parse("from vlp16emu.packets.frames import HEADER"))
    assert not trespasses("motion/walk.py", ast.parse("from vlp16emu.motion.path import Path"))


def test_no_module_needs_itself():
    """Between files there is no circle of imports."""
    arrows = {name: taken_at_once(name, parsed(PACKAGE / name)) for name in NAMES}
    assert sum(map(len, arrows.values())) > 300
    list(TopologicalSorter(arrows).static_order())


@pytest.mark.parametrize("name", NAMES)
def test_a_library_is_imported_where_it_belongs(name):
    """Sockets, serial ports, Embree, pydantic and the command line's libraries stay in their rooms."""
    for full in imports(parsed(PACKAGE / name)):
        places = LIBRARIES.get(full.split(".")[0])
        assert places is None or name.startswith(places), f"{name} imports {full}"


@pytest.mark.parametrize("name", NAMES)
def test_only_the_command_line_prints(name):
    """No `print`, no `sys.exit`, no writing to the standard streams outside `cli/`."""
    if name.startswith("cli/"):
        return
    tree = parsed(PACKAGE / name)
    calls = {ast.unparse(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    assert not calls & {"print", "exit", "sys.exit", "sys.stdout.write", "sys.stderr.write"}


@pytest.mark.parametrize("name", NAMES)
def test_files_and_functions_are_short(name):
    """No file exceeds 400 lines, no function 45; the main file stays under 120."""
    text = (PACKAGE / name).read_text(encoding="utf-8")
    assert len(text.splitlines()) <= (119 if name == "emulator.py" else 400)
    lengths = {node.name: (node.end_lineno or 0) - node.lineno + 1 for node in functions(ast.parse(text))}
    assert {function: n for function, n in lengths.items() if n > 45} == {}


@pytest.mark.parametrize("name", NAMES)
def test_public_things_have_docstrings(name):
    """Every module, public class and public function says what it is."""
    tree = parsed(PACKAGE / name)
    assert [node.name for node in public(tree.body) if not ast.get_docstring(node)] == []
    assert ast.get_docstring(tree)
