"""The house rules, read from the source with `ast`."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

from vlp16emu.kernels.cache import sources_of
from vlp16emu.store import MAKERS

PACKAGE = Path(__file__).resolve().parents[1] / "vlp16emu"
FILES = sorted(PACKAGE.rglob("*.py"))
NAMES = [str(path.relative_to(PACKAGE)) for path in FILES]

FLOORS = (
    {"__main__"},
    {"cli", "pytest"},
    {"extras"},
    {"run"},
    {"engine"},
    {"scenario"},
    {"forest"},
    {"foliage"},
    {"captures", "raycast", "returns", "sinks"},
    {"packets"},
    {"motion", "sensor", "world"},
    {
        "child",
        "cores",
        "doors",
        "elementary",
        "errors",
        "explain",
        "hosts",
        "inputs",
        "kernels",
        "libraries",
        "models",
        "once",
        "output",
        "random",
        "rotation",
        "settings",
        "store",
        "tables",
        "trees",
        "trig",
        "types",
        "units",
    },
)
"""From the top. Imports run down past any number of floors, or to a room beside; never in a circle."""

NO_CORE = {"__main__", "cli", "extras", "forest", "foliage", "pytest"}
"""What the core runs without; what is asked for by name opens `vlp16emu.doors`."""

FOREST = (
    "settings",
    "purpose",
    "ground",
    "tiles",
    "plants",
    "stand",
    "make",
)  # rooms of `forest/` from the bottom

EXTRAS_TAKE = {
    "bag": {"camera", "imu", "slam", "truth"},
    "bench": {"imu"},
    "camera": {"colours", "options", "truth"},
    "clouds": {"displace", "options", "recorded", "truth"},
    "dataset": {"clouds", "options"},
    "handle": {"clouds", "truth"},
    "plan": {"meshes", "outlook", "walk"},
    "plot": {"colours"},
    "recorded": {"splines"},
    "replay": {"bench", "free_ports"},
    "live": {"recorded"},
    "score": {"clouds", "options", "recorded"},
    "slam": {"truth"},
    "survey": {"colours", "meshes", "stand_map"},
    "truth": {"bench", "camera"},
    "viewer": {"clouds", "colours", "options", "survey", "verify", "walk"},
    "walk": {"splines"},
}
"""Which extras each extra may import beside the core: options, trajectories, colours, ground truth,
clouds, and the stand that the page shows."""

KERNEL = re.compile(r"^ *@(array_|inline_)?kernel$", re.MULTILINE)
"""Decorators of kernels."""

FLOOR_OF = {room: number for number, floor in enumerate(FLOORS) for room in floor}

LIBRARIES = {
    # third-party or system module: where it may be imported
    "ctypes": ("output.py", "raycast/embree", "sinks/pacing.py"),
    "embreex": ("raycast/embree",),
    "pytest": ("pytest.py",),
    "serial": ("extras/bench/",),
    "socket": (
        *("hosts.py", "sinks/", "extras/bench/", "extras/free_ports.py", "extras/live/", "extras/doctor.py"),
        "extras/viewer/live",  # a pair of sockets between a stream and its page
    ),
    "typer": ("cli/",),
    "rich": ("cli/",),
}


OPENS = {
    # module that opens files without `inputs.py`: what it opens
    "cli/app.py": "its own text, and /dev/null",
    "engine/windows.py": "geometries",
    "extras/accuracy/sweep.py": "geometries",
    "extras/bag/bag_file.py": "its own output",
    "extras/bag/write.py": "its own output",
    "extras/bench/device.py": "its own table",
    "extras/bench/outlets.py": "serial ports",
    "extras/bench/web.py": "its own page",
    "extras/camera/folder.py": "images, from an opened file",
    "extras/clouds/cloud.py": "its own output",
    "extras/dataset/cluster.py": "its own output",
    "extras/dataset/run.py": "a folder, to lock it",
    "extras/doctor.py": "/proc",
    "extras/live/windows.py": "geometries",
    "extras/plot/sheet.py": "its own image",
    "extras/score/files.py": "clouds, after `readable`",
    "extras/slam/configure.py": "its own templates",
    "extras/stand_map.py": "geometries",
    "extras/truth/folder.py": "its own output",
    "extras/truth/tables.py": "arrays, from an opened file",
    "forest/ground/dem.py": "by GDAL, after `readable`",
    "inputs.py": "all files of users",
    "kernels/cache.py": "sources of the package",
    "kernels/compiler.py": "its own table, and /dev/null",
    "output.py": "all outputs",
    "sensor/laws.py": "its own table",
    "models.py": "its own tables",
    "store.py": "the cache",
}
JSON = {
    # module that parses JSON without `inputs.py`: what it parses
    "child.py": "answers of its own process",
    "extras/bench/device.py": "its own table",
    "extras/slam/configure.py": "its own templates",
    "extras/viewer/live_settings.py": "answers of the sensor's web interface",
    "inputs.py": "all texts of users",
    "kernels/compiler.py": "its own table",
}
OPENERS = {"open", "read_bytes", "read_text", "memmap", "fromfile", "open_memmap", "loadtxt", "genfromtxt"}


def opens(tree: ast.AST) -> list[int]:
    """Lines that open a file, other than one of the package through `importlib.resources`."""
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    ours = {"files", "resources"}  # names of `importlib.resources`
    found = []
    for call in calls:
        names = {node.id for node in ast.walk(call.func) if isinstance(node, ast.Name)}
        is_opener = isinstance(call.func, ast.Attribute) and call.func.attr in OPENERS
        is_builtin = isinstance(call.func, ast.Name) and call.func.id == "open"
        if is_builtin or (is_opener and not names & ours):
            found.append(call.lineno)
    return found


@cache
def trees() -> dict[str, ast.Module]:
    """Files by name, read by the worker that has these tests and by no other."""
    return {
        name: ast.parse(path.read_text(encoding="utf-8")) for name, path in zip(NAMES, FILES, strict=True)
    }


@cache
def imports(tree: ast.AST) -> tuple[str, ...]:
    """Full names of modules and of what is taken from them, wherever in the file they are imported."""
    found = list[str]()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: relative import"
            found += [f"{node.module}.{alias.name}" for alias in node.names]
    return tuple(found)


def called(tree: ast.AST) -> set[str]:
    """Names of the functions that a file calls, with their modules, as `sys.exit`."""
    funcs = [node.func for node in ast.walk(tree) if isinstance(node, ast.Call)]
    return {ast.unparse(func) for func in funcs if isinstance(func, ast.Name | ast.Attribute)}


def functions(tree: ast.AST) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    return (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))


def room_of(name: str) -> str:
    """Folder of a file, or the module itself where it stands in none."""
    return name.partition("/")[0].removesuffix(".py")


def trespasses(name: str, tree: ast.AST) -> list[str]:
    """List what a file imports of ours that is on a floor above its own."""
    room = room_of(name)
    if room == "__init__":
        return []
    found = []
    for full in imports(tree):
        target = full.removeprefix("vlp16emu.").split(".")[0]
        if full.startswith("vlp16emu.") and FLOOR_OF.get(target, 0) < FLOOR_OF[room]:
            found.append(full)
    return found


def taken_at_once(name: str, tree: ast.Module) -> set[str]:
    """Modules of ours that a file imports as it is loaded, and not within a function."""
    taken = set[str]()
    for node in tree.body:
        for full in imports(node) if isinstance(node, ast.Import | ast.ImportFrom) else ():
            first, *parts = full.split(".")
            paths = ["/".join(stem) for stem in (parts, parts[:-1]) if first == "vlp16emu"]
            files = [
                file for path in paths for file in (f"{path}.py", f"{path}/__init__.py") if file in NAMES
            ]
            taken |= set(files[:1])
    return taken - {name}


def targets(name: str) -> set[str]:
    """Modules of ours that a file imports anywhere, as `room.module.name`."""
    return {full.removeprefix("vlp16emu.") for full in imports(trees()[name]) if full.startswith("vlp16emu.")}


def test_the_core_knows_no_forest_and_no_extra():
    """No file of the core imports what stands around it, not even within a function: it opens doors by
    name."""
    core = [name for name in NAMES if room_of(name) not in NO_CORE | {"__init__"}]
    found = {name: {full for full in targets(name) if full.split(".")[0] in NO_CORE} for name in core}
    assert {name: full for name, full in found.items() if full} == {}


def test_arrows_in_the_forest_run_down():
    """Ground, tiles, plants, stand: a room of the forest imports from its own floor and from lower ones."""
    for name in NAMES:
        if room_of(name) == "forest" and name != "forest/__init__.py":
            own = FOREST.index(name.split("/")[1].removesuffix(".py"))
            taken = {full.split(".")[1] for full in targets(name) if full.startswith("forest.")}
            assert {room for room in taken if FOREST.index(room) > own} == set(), name


def test_extras_take_the_core_and_little_of_each_other():
    """An extra imports no other extra but those of the table; and each row of the table is needed."""
    needed: dict[str, set[str]] = {}
    for name in NAMES:
        if room_of(name) == "extras" and name != "extras/__init__.py":
            own = name.split("/")[1].removesuffix(".py")
            taken = {full.split(".")[1] for full in targets(name) if full.startswith("extras.")} - {own}
            needed[own] = needed.get(own, set()) | taken
    assert {own: taken for own, taken in needed.items() if taken} == EXTRAS_TAKE


def test_every_room_stands_on_one_floor():
    """Each folder and each module of the package has its place, and every place is taken."""
    there = {room_of(name) for name in NAMES} - {"__init__"}
    assert there == set(FLOOR_OF)
    assert sum(map(len, FLOORS)) == len(FLOOR_OF)


def test_arrows_run_down():
    """A file imports of ours only from its own floor and from lower ones."""
    found = {name: trespasses(name, tree) for name, tree in trees().items()}
    assert {name: names for name, names in found.items() if names} == {}


def test_no_room_needs_itself():
    """Between rooms there is no circle of imports, foundations apart."""
    arrows = {room: set[str]() for room in FLOOR_OF}
    for name, tree in trees().items():
        for full in imports(tree):
            target = full.removeprefix("vlp16emu.").split(".")[0]
            if full.startswith("vlp16emu.") and target in FLOOR_OF and room_of(name) in FLOOR_OF:
                arrows[room_of(name)] |= {target} - {room_of(name)}
    list(TopologicalSorter(arrows).static_order())


def test_a_trespass_would_be_seen():
    """The rule above catches an import from above, however it is written."""
    for line in (
        "import vlp16emu.scenario.load",
        "from vlp16emu.scenario import load",
        "from vlp16emu import scenario",
        "from vlp16emu.raycast.beam import ROUND",
    ):
        assert trespasses("motion/mount.py", ast.parse(f"def f():\n    {line}")), line
        assert trespasses("units.py", ast.parse(line)), line
    assert not trespasses("foliage/far.py", ast.parse("from vlp16emu.foliage.polyline import distance_m"))
    assert not trespasses("sinks/udp.py", ast.parse("from vlp16emu.packets.frames import HEADER"))
    assert not trespasses("motion/mount.py", ast.parse("from vlp16emu.world.settings import Terrain"))


def test_no_module_needs_itself():
    """Between files there is no circle of imports."""
    arrows = {name: taken_at_once(name, tree) for name, tree in trees().items()}
    assert sum(map(len, arrows.values())) > 300
    list(TopologicalSorter(arrows).static_order())


def test_changes_of_all_that_a_kernel_takes_are_seen():
    """What decides the name of a compiled kernel is all that its module takes of ours as it is loaded, and
    what this takes in turn."""
    found = {name for name in NAMES if KERNEL.search((PACKAGE / name).read_text(encoding="utf-8"))}
    assert "raycast/kernel.py" in found
    for name in found:
        left, needed = {name}, set()
        while left:
            needed.add(file := left.pop())
            taken = taken_at_once(file, trees()[file])
            left |= {
                one for one in taken if not one.startswith("kernels/")
            } - needed  # by which no number is computed
        module = name.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
        assert needed <= set(sources_of(frozenset({f"vlp16emu.{module}"}))), name


def test_kernels_take_numba_as_it_is_prepared():
    """Only `kernels/`, which sets the processor and the folder before any kernel is made, names options of
    numba."""
    for name in NAMES:
        if not name.startswith("kernels/"):
            assert "njit" not in (PACKAGE / name).read_text(encoding="utf-8"), name


def test_sources_of_what_is_kept_are_there():
    """Each file and folder whose changes make grown worlds anew exists under that name."""
    assert [source for source in MAKERS if not (PACKAGE / source).exists()] == []


def test_a_library_is_imported_where_it_belongs():
    """Sockets, serial ports, Embree and the command line's libraries stay in their rooms."""
    for name, tree in trees().items():
        for full in imports(tree):
            places = LIBRARIES.get(full.split(".")[0])
            assert places is None or name.startswith(places), f"{name} imports {full}"


def test_files_of_users_come_in_through_one_door():
    """Only `inputs.py` opens what a user names; other modules open what the table says, and no others do."""
    assert {name for name, tree in trees().items() if opens(tree)} == OPENS.keys()
    assert opens(ast.parse("with Path(name).open() as file: pass")) == [1]
    assert opens(ast.parse("np.loadtxt(path)")) == [1]
    assert not opens(ast.parse("files(__package__).joinpath(name).read_text()"))


def test_json_of_users_is_parsed_in_one_place():
    """Only `inputs.py` parses JSON of users; other modules parse what the table says, and no others do."""
    assert {name for name, tree in trees().items() if "json.loads" in called(tree)} == JSON.keys()


def test_names_of_hosts_are_looked_up_in_one_place():
    """Only `hosts.py` asks for the address of a name, or binds a socket: a name server may not answer."""
    asking = {"getaddrinfo", "gethostbyname", "create_connection", "create_server", "TCPServer"}
    found = {
        name
        for name, tree in trees().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and node.attr in asking
    }
    assert found == {"hosts.py"}


def test_only_the_command_line_prints():
    """No `print`, no `sys.exit`, no writing to the standard streams outside `cli/`."""
    for name, tree in trees().items():
        printing = called(tree) & {"print", "exit", "sys.exit", "sys.stdout.write", "sys.stderr.write"}
        assert not printing or name.startswith("cli/"), f"{name} calls {printing}"


def test_lines_have_at_most_110_columns():
    """No line of a Python file, nor of a program of the shell, is longer, also where ruff allows it."""
    root = PACKAGE.parent
    tools = [path for folder in ("tools", ".ci") for path in (root / folder).rglob("*") if path.is_file()]
    programs = [path for path in tools if path.suffix == ".sh" or path.read_bytes()[:2] == b"#!"]
    assert {"step.sh", "run", "unmask"} <= {path.name for path in programs}
    files = [*FILES, *(root / "tests").rglob("*.py"), *(root / "tools").rglob("*.py"), *programs]
    found = [
        f"{path.relative_to(root)}:{number}"
        for path in files
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if len(line) > 110
    ]
    assert found == []


def test_files_and_functions_are_short():
    """No file exceeds 600 lines, no function 45 statements."""
    found = []
    for name, tree in trees().items():
        lines = len((PACKAGE / name).read_text(encoding="utf-8").splitlines())
        if lines > 600:
            found.append(f"{name} has {lines} lines")
        for node in functions(tree):
            statements = sum(isinstance(inner, ast.stmt) for inner in ast.walk(node)) - 1
            statements -= ast.get_docstring(node) is not None
            if statements > 45:
                found.append(f"{name}: {node.name} has {statements} statements")
    assert found == []


TOGETHER = [
    set(words.split())
    for words in (
        *(
            "x y z w",
            "nx ny nz",
            "ax ay az",
            "bx by bz",
            "qx qy qz",
            "x0 y0",
            "x1 y1",
            "ix iy",
            "dx dy dz",
            "u v w",
            "i j k",
            "a b c",
            "p q r",
            "sin cos",
            "sine cosine",
        ),
        *(
            "sy cy",
            "sp cp",
            "sr cr",
            "yaw pitch roll",
            "red green blue",
            "start stop",
            "begin end",
            "begins ends",
        ),
        *(
            "first last",
            "first stop",
            "least most",
            "low high",
            "lower upper",
            "min max",
            "width height",
            "rows columns",
        ),
        *(
            "row column",
            "east north up",
            "latitude longitude",
            "left right",
            "near far",
            "along across",
            "inner outer",
        ),
        *(
            "before after",
            "old new",
            "given found",
            "slow fast",
            "host port",
            "above below",
            "one other",
            "mean sigma",
        ),
    )
]
"""Names whose values belong together, so that one statement may assign them."""
UNIT = re.compile(r"(_(m|ns|us|ms|deg|rad|hz|rpm|s|cdeg|km|mm|cm|m2|m3|um2|rad2|px))+$")


def belong_together(targets):
    """Whether the names of a tuple are one family but for units and words that all of them have."""
    names = [getattr(one, "id", getattr(one, "attr", "")).strip("_").lower() for one in targets]
    words = [UNIT.sub("", name).split("_") for name in names]
    if len({len(each) for each in words}) > 1:
        return False
    different = [set(column) for column in zip(*words, strict=True) if len(set(column)) > 1]
    return (
        len(different) == 1
        and len(different[0]) == len(names)
        and any(different[0] <= one for one in TOGETHER)
    )


def packed(tree):
    """Yield the lines of assignments of several values that neither belong together nor need each other's
    old values."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Assign) or not isinstance(node.value, ast.Tuple):
            continue
        targets, values = getattr(node.targets[0], "elts", []), node.value.elts
        if not values or len(targets) != len(values) or belong_together(targets):
            continue
        if all(isinstance(one, ast.Subscript) for one in targets):
            continue  # elements of a table, such as two of its columns
        stored = {ast.unparse(one) for one in targets}
        loaded = {ast.unparse(one) for value in values for one in ast.walk(value)}
        if not stored & loaded:
            yield node.lineno


def test_an_assignment_has_one_value():
    """A statement assigns one value, unless several belong together (x, y; start, stop) or are exchanged."""
    assert {name: lines for name, tree in trees().items() if (lines := list(packed(tree)))} == {}
    assert list(packed(ast.parse("a_m, path = 1.0, 2"))) == [1]
    assert not list(packed(ast.parse("start_s, stop_s = 1.0, 2.0\na, b = b, a")))


def test_words_are_the_fields_own():
    """No docstring, message or document that users read has a word that this project has left behind."""
    words = re.compile(
        r"\b(told|(?<!\.)tells?|telling|reckon\w*|errs?|of which|none but|whence)\b", re.IGNORECASE
    )
    root = PACKAGE.parent
    documents = [root / "README.md", root / "tools/README.md", *sorted((root / "scenes").glob("*.md"))]
    found = [
        f"{path.relative_to(root)}: {line}"
        for path in (*FILES, *documents)
        for line in path.read_text(encoding="utf-8").splitlines()
        if words.search(line)
    ]
    assert found == []


def test_validators_of_sections_raise_expectations():
    """A validator raises `ExpectationError`, so that its text is known to end the line after "expected"."""
    found = [
        f"{name}: {function.name}"
        for name, tree in trees().items()
        for function in functions(tree)
        if any("_validator" in ast.unparse(decorator) for decorator in function.decorator_list)
        for node in ast.walk(function)
        if isinstance(node, ast.Raise) and node.exc and "ExpectationError(" not in ast.unparse(node.exc)
    ]
    assert found == []
