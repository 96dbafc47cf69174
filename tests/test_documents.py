"""What the documents show can be done and prints what they say, and what they name exists."""

import json
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from printed import TIMES, differences, shown_block

from vlp16emu.cli.app import run
from vlp16emu.cli.verb import options_of_function
from vlp16emu.doors import door
from vlp16emu.errors import InputError
from vlp16emu.scenario import load, scene_files

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = {
    str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
    for pattern in ("README.md", "protocol/*.md", "scenes/*.md", "tools/*.md", "tools/results/*.md")
    for path in ROOT.glob(pattern)
}
COMMANDS = sorted(
    {
        command
        for text in DOCUMENTS.values()
        for command in re.findall(r"(?m)(?:`|^    )(vlp16emu [a-z]+\b[^`\n]*)", text)
    }
    | {
        f"vlp16emu {line}"
        for line in (ROOT / "vlp16emu/cli/examples.txt").read_text(encoding="utf-8").splitlines()
    }
)
TABLES = re.findall(r"```toml\n(.*?)```", DOCUMENTS["scenes/README.md"], re.DOTALL)
HEAD = "schema", "title", "seed", "duration_s"
documents = pytest.mark.parametrize("document", DOCUMENTS)


def anchors(text):
    """Fragments of the headings, as web pages of repositories make them."""
    headings = re.findall(r"(?m)^#+ (.*)$", text)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_the_scene_of_the_documents_can_be_walked(tmp_path):
    """The scene file that `scenes/README.md` shows is one, and its walk is long enough."""
    path = tmp_path / "my_forest.toml"
    path.write_text(TABLES[0], encoding="utf-8")
    scenario = load(str(path))
    assert scenario.duration_s * scenario.motion.speed_m_s <= 40.0


@pytest.mark.parametrize("tables", TABLES[1:])
def test_the_tables_of_the_documents_fit_into_a_scene(tables, tmp_path):
    """Tables that `scenes/README.md` shows alone, in the place of those of its scene, make a scene."""
    lines = [f"{key} = {json.dumps(value)}" for key, value in tomllib.loads(TABLES[0]).items() if key in HEAD]
    others = [table for table in re.split(r"(?m)^(?=\[)", TABLES[0])[1:] if table.split()[0] not in tables]
    path = tmp_path / "my_forest.toml"
    path.write_text("\n".join([*lines, tables, *others]), encoding="utf-8")
    assert load(str(path)).title == "Thirty seconds among birches"


BLOCK = shown_block(DOCUMENTS["README.md"], "wrote walk.pcap")


def program(folder, *words):
    """Run the program in a folder, and return its standard output."""
    command = [sys.executable, "-m", "vlp16emu", *map(str, words)]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout


@pytest.fixture(scope="module")
def quickstart(tmp_path_factory):
    """Run the commands of `tools/quickstart` in an empty folder; return it and their output."""
    folder = tmp_path_factory.mktemp("quickstart")
    script = (ROOT / "tools/quickstart").read_text(encoding="utf-8").replace('"$walk"', "./walk.pcap")
    commands = re.findall(r'(?m)^"\$emulator" (.*)$', script)
    return folder, "".join(program(folder, *shlex.split(command)) for command in commands)


def test_the_readme_shows_what_the_quick_start_prints(quickstart):
    """The first block of README is what the commands of `tools/quickstart` print, apart from times."""
    _, printed = quickstart
    assert differences(BLOCK, printed) == []


FIGURES = [figure.start() for figure in re.finditer(r"\d", BLOCK)]


def edited(place):
    """Return the block of README with another digit at a place, and the line of that place."""
    digit = "1" if BLOCK[place] == "0" else "0"
    begin = BLOCK.rfind("\n", 0, place) + 1
    return BLOCK[:place] + digit + BLOCK[place + 1 :], BLOCK[begin:].partition("\n")[0]


def test_an_edited_figure_of_the_readme_is_found():
    """A change of any digit of the block is a difference, unless it belongs to a time."""
    for place in FIGURES:
        other, line = edited(place)
        is_time = line.strip().startswith(TIMES)
        assert len(differences(other, BLOCK)) == (0 if is_time else 1), line
    assert sum(edited(place)[1].strip().startswith(TIMES) for place in FIGURES) < 10 < len(FIGURES)


def test_a_line_more_or_less_is_found():
    """A line that only the document or only the command has is a difference, also that of a time."""
    for line in (*TIMES, "sha256"):
        without = "\n".join(one for one in BLOCK.splitlines() if not one.strip().startswith(line))
        assert differences(BLOCK, without)
        assert differences(without, BLOCK)


ENDLESS = {"--loop": "", "--to 192.168.1.10": "--to 127.0.0.1 --data-port 0 --position-port 0"}
"""Parts of README's commands without which they end by themselves, on this machine."""
PLACES = {"SPEC.toml": "spec.toml", "OUT": "out", "field_day.pcap": "walk.pcap"}
"""What stands for a file of the reader, and a file of this test in its place."""
SHORT = {"accuracy": "--pulses 128", "dataset": "--workers 0"}
"""Options with which a command takes a moment, beside `--duration`."""
SPEC = """
schema = 1
layout = "pcap+truth"
stands = [{ name = "hall", scene = "static_bench", set = ["duration_s=0.3"] }]
seeds = [1]
paths = [{ name = "as_it_is" }]
sensors = [{ name = "puck" }]
"""


def readme_commands():
    """Return the commands of README's tables of verbs in their order, without the page, which has no end."""
    table = DOCUMENTS["README.md"].partition("## Commands\n")[2].partition("\n`--help`")[0]
    commands = re.findall(r"`vlp16emu ([^`]+)`", table)
    return [command for command in commands if not command.startswith("view ") and "--view" not in command]


def in_a_moment(command):
    """Return the words of a command in the hall, for three tenths of a second."""
    for part, other in ENDLESS.items():
        command = command.replace(part, other)
    words = [PLACES.get(word, word) for word in shlex.split(command)]
    words = ["static_bench" if word in scene_files() else word for word in words]
    if "--duration" in words:
        words[words.index("--duration") + 1] = "0.3"
    elif any(leaf.name == "--duration" for leaf in options_of_function(door(words[0], "verbs"))):
        words += ["--duration", "0.3"]
    return words + SHORT.get(words[0], "").split()


def test_the_commands_of_the_readme_run(tmp_path, monkeypatch, capfd):
    """The commands of README's tables run one after the other, in the hall for a moment."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "spec.toml").write_text(SPEC, encoding="utf-8")
    for command in readme_commands():
        words = in_a_moment(command)
        if words[0] == "score":
            shutil.copy("truth/trajectory.tum", "estimate.tum")
        code = run(words)
        printed = capfd.readouterr()
        # This machine may have a problem, and a bag without inertial unit is not fit for all programs.
        may_find = words[0] == "doctor" or words[-2:] == ["--for", "all"]
        assert code <= int(may_find), (words, *printed)
        if "--json" in words:
            (tmp_path / "report.json").write_text(printed.out, encoding="utf-8")


def test_the_python_of_the_readme_runs(capsys, tmp_path, monkeypatch):
    """The examples in Python run as printed, and the capture is clean."""
    monkeypatch.chdir(tmp_path)
    for code in re.findall(r"```python\n(.*?)```", DOCUMENTS["README.md"], re.DOTALL):
        exec(code, {})
    assert " True\n" in capsys.readouterr().out


@pytest.mark.parametrize("command", COMMANDS)
def test_the_commands_of_the_documents_are_understood(command, capsys):
    """Verbs and options in the documents and in the help's examples exist: with --help behind them they
    are accepted."""
    assert run([*shlex.split(command)[1:], "--help"]) == 0
    assert capsys.readouterr().err == ""


def settings_of(command):
    """Return the scene and the settings of a command with `--set`."""
    words = shlex.split(command)
    scene = next((word for word in words if word in scene_files()), "birch_walk")
    return scene, [words[i + 1] for i, word in enumerate(words) if word == "--set"]


@pytest.mark.parametrize("command", [one for one in COMMANDS if "--set" in one])
def test_the_settings_of_the_documents_are_taken(command, tmp_path, monkeypatch):
    """Each setting of a command in the documents is one of its scene; files of the reader may be missing."""
    monkeypatch.chdir(tmp_path)
    try:
        load(*settings_of(command))
    except InputError as error:
        # A file of the reader; the text is the program's or the system's.
        assert "no such file" in str(error).lower()  # noqa: PT017


def test_the_page_of_the_paper_has_the_commands_of_its_tool(tool_named):
    """`tools/results/paper.md` has the rows of `tools/paper`, in their order, each with a result."""
    lines = [
        line for line in DOCUMENTS["tools/results/paper.md"].splitlines() if re.match(r"\|.*`vlp16emu", line)
    ]
    cells = [line.strip("| ").split(" | ") for line in lines]
    rows = [(row.part, row.what, f"`{row.command}`") for row in tool_named("paper").ROWS]
    assert [tuple(line[:3]) for line in cells] == rows
    assert all(len(line) == 4 for line in cells)


@pytest.fixture(scope="module")
def keys(tool_named):
    """Return all keys of a scene file, with the path of their table."""
    tables = tool_named("settings_table").tables().values()
    paths = [(path.replace("[]", ""), table) for table in tables for path in table.paths]
    return {f"{path}.{key}".lstrip(".") for path, table in paths for key in table.node["properties"]}


@documents
def test_the_keys_of_the_documents_exist(document, keys):
    """Keys of a scene file that a document names in full are keys of the program."""
    sections = "|".join(sorted({key.partition(".")[0] for key in keys if "." in key}))
    named = set(re.findall(rf"`((?:{sections})\.[a-z0-9_.]+)[^`/]*`", DOCUMENTS[document]))
    assert {key for key in named if not key.endswith((".csv", ".json", ".npy"))} <= keys


@documents
def test_the_places_of_the_documents_exist(document):
    """Files and folders that a document names are there."""
    places = re.findall(r"`((?:protocol|tools|scenes|tests|vlp16emu)/[\w./-]*)[` ]", DOCUMENTS[document])
    assert [place for place in places if not (ROOT / place).exists()] == []


@documents
def test_the_links_of_the_documents_lead_somewhere(document):
    """Each link to a file of the project, and to a heading in it, has its target."""
    for target, _, fragment in (
        link.partition("#") for link in re.findall(r"\]\(([^):]+)\)", DOCUMENTS[document])
    ):
        path = (ROOT / document).parent / target if target else ROOT / document
        assert path.exists(), target
        assert not fragment or fragment in anchors(path.read_text(encoding="utf-8")), f"{target}#{fragment}"
