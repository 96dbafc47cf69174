"""Each page of results names its commands: tools run here, and `test_documents.py` reads the verbs."""

import shutil
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.usefixtures("kept_woods")

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted((ROOT / "tools/results").glob("*.md"))
PYTHON = "#!/usr/bin/env python3"  # `tests/test_packaging.py` has the shell scripts


def commands_of(page):
    """Lines of the block that begins in the third line of a page."""
    lines = page.read_text(encoding="utf-8").splitlines()[2:]
    count = next((i for i, line in enumerate(lines) if not line.startswith("    ")), len(lines))
    return [line.strip() for line in lines[:count]]


COMMANDS = {page: commands_of(page) for page in PAGES}
LINES = [line for lines in COMMANDS.values() for line in lines]
DESIGN = [str(path.relative_to(ROOT)) for path in (ROOT / "tools/design").iterdir() if not path.suffix]
NAMED = {*DESIGN, *(line.split()[0] for line in LINES if line.startswith("tools/"))}
ELSEWHERE = {"tools/dataset_speed"}
"""Tools whose output `tests/extras/dataset/test_cluster.py` compares with their page."""
TOOLS = [
    name
    for name in sorted(NAMED - ELSEWHERE)
    if (ROOT / name).is_file() and (ROOT / name).read_text("utf-8").startswith(PYTHON)
]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_begins_with_its_commands(page):
    """From its third line on, each page has an indented block of commands: tools that are there, or verbs."""
    assert COMMANDS[page], "expected an indented block from line 3 on"
    for line in COMMANDS[page]:
        first = line.split()[0]
        assert first == "vlp16emu" or (first.startswith("tools/") and (ROOT / first).is_file()), line


@pytest.mark.parametrize("name", TOOLS)
def test_the_tool_of_a_page_runs(name, tool_named, monkeypatch, capsys, tmp_path):
    """With `--shortest` it prints within seconds; programs of other projects are not installed for that."""
    if name == "tools/browser":
        pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
        if shutil.which("chromium") is None:
            pytest.skip("chromium is not installed")
    monkeypatch.chdir(tmp_path)
    stem = name.removeprefix("tools/")
    monkeypatch.setitem(sys.modules, stem, sys.modules.get(stem))  # tests have a package `forest` too
    monkeypatch.setattr(sys, "argv", [str(ROOT / name), "--shortest"])
    tool_named(stem).main()
    printed = capsys.readouterr().out
    assert len(printed.splitlines()) >= 2
    assert "nan" not in printed or name == "tools/forest"
