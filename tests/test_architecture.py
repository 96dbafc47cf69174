"""The house rules, read from the source with `ast`."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "vlp16emu"
FILES = sorted(PACKAGE.rglob("*.py"))
NAMES = [str(path.relative_to(PACKAGE)) for path in FILES]

ROOMS = {
    "cli",
    "device",
    "motion",
    "packets",
    "raycast",
    "report",
    "returns",
    "scenario",
    "sensor",
    "sinks",
    "world",
}
FOUNDATIONS = {"errors", "random", "store", "trig", "types", "units"}
WIRING = {
    "__main__",
    "assembly",
    "compiled",
    "emulator",
    "fidelity",
    "pipeline",
    "telemetry",
    "truth",
}  # they know all rooms, no room knows them

ALLOWED = {
    ("sinks/pcap.py", "packets.frames"): "a recording holds whole frames, headers and all",
    ("sinks/udp.py", "packets.frames"): "ports and addresses of a sensor are stated once",
    ("report/verify", "packets"): "the lint reads what it checks with the wire's own tables",
}
LIBRARIES = {
    # third-party or system module: where it may be imported
    "ctypes": ("raycast/embree", "sinks/timer_slack.py"),
    "embreex": ("raycast/embree", "raycast/plain.py"),
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


def is_allowed(name: str, target: str) -> bool:
    return any(name.startswith(who) and f"{target}.".startswith(f"{what}.") for who, what in ALLOWED)


def trespasses(name: str, tree: ast.AST) -> list[str]:
    """List what a file imports of ours that it may not."""
    room = name.partition("/")[0]
    if room not in ROOMS or room == "cli":
        return []
    found = []
    for full in imports(tree):
        target = full.removeprefix("vlp16emu.")
        if (
            target != full
            and target.split(".")[0] not in FOUNDATIONS | {room}
            and not is_allowed(name, target)
        ):
            found.append(full)
    return found


def test_every_folder_is_a_room_and_every_module_has_its_place():
    """Nothing lives in the package but the rooms, the foundations and the wiring."""
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    modules = {path.stem for path in PACKAGE.glob("*.py")} - {"__init__"}
    assert folders <= ROOMS | WIRING
    assert FOUNDATIONS <= modules <= FOUNDATIONS | WIRING


@pytest.mark.parametrize("name", NAMES)
def test_a_room_does_not_import_its_neighbour(name):
    """A room imports of ours only itself and the foundations; exceptions are listed above with their reason."""
    assert trespasses(name, parsed(PACKAGE / name)) == []


def test_a_trespass_would_be_seen():
    """The rule above catches an import of a neighbour, however it is written."""
    for line in (
        "import vlp16emu.world.tree",
        "from vlp16emu.world import Forest",
        "from vlp16emu import world",
    ):
        assert trespasses("motion/walk.py", ast.parse(f"def f():\n    {line}")), line
    assert trespasses("sinks/udp.py", ast.parse("from vlp16emu.packets.data import pack_data"))
    assert not trespasses("sinks/udp.py", ast.parse("from vlp16emu.packets.frames import HEADER"))
    assert not trespasses("motion/walk.py", ast.parse("from vlp16emu.motion.path import Path"))


@pytest.mark.parametrize("name", NAMES)
def test_foundations_stand_on_nothing_of_ours(name):
    """A foundation imports only other foundations."""
    if name.removesuffix(".py") not in FOUNDATIONS:
        return
    ours = {full.split(".")[1] for full in imports(parsed(PACKAGE / name)) if full.startswith("vlp16emu.")}
    assert ours <= FOUNDATIONS


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
