"""What the documents show can be done, and what they name exists."""

import json
import re
import shlex
import tomllib
from pathlib import Path

import pytest

from vlp16emu.cli.app import run
from vlp16emu.scenario import load

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
    | {f"vlp16emu {line}" for line in (ROOT / "vlp16emu/cli/examples.txt").read_text(encoding="utf-8").splitlines()}
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


def test_the_python_of_the_readme_runs(capsys, tmp_path, monkeypatch):
    """The examples in Python run as printed, and the capture is clean."""
    monkeypatch.chdir(tmp_path)
    for code in re.findall(r"```python\n(.*?)```", DOCUMENTS["README.md"], re.DOTALL):
        exec(code, {})
    assert " True\n" in capsys.readouterr().out


@pytest.mark.parametrize("command", COMMANDS)
def test_the_commands_of_the_documents_are_understood(command, capsys):
    """Verbs and options in the documents and in the help's examples exist: with --help behind them they are accepted."""
    assert run([*shlex.split(command)[1:], "--help"]) == 0
    assert capsys.readouterr().err == ""


@documents
def test_the_places_of_the_documents_exist(document):
    """Files and folders that a document names are there."""
    places = re.findall(r"`((?:protocol|tools|scenes|tests|vlp16emu)/[\w./-]*)[` ]", DOCUMENTS[document])
    assert [place for place in places if not (ROOT / place).exists()] == []


@documents
def test_the_links_of_the_documents_lead_somewhere(document):
    """Each link to a file of the project, and to a heading in it, has its target."""
    for target, _, fragment in (link.partition("#") for link in re.findall(r"\]\(([^):]+)\)", DOCUMENTS[document])):
        path = (ROOT / document).parent / target if target else ROOT / document
        assert path.exists(), target
        assert not fragment or fragment in anchors(path.read_text(encoding="utf-8")), f"{target}#{fragment}"
