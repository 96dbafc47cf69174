"""Help, version, and what becomes of errors."""

import os
import subprocess
import sys
from itertools import product
from pathlib import Path

import pytest

from vlp16emu.scenario import scene_files, schema

HEAVY = {"numpy", "numba", "scipy", "pydantic", "dpkt", "rich", "vlp16emu.run.emulator", "vlp16emu.scenario"}
VERBS = ["record", "stream", "decode", "points", "truth", "verify", "scenes", "schema"]


def test_help_loads_nothing_heavy():
    """The package imports no library, and `--help` no numerical one, no validation and no emulator: it
    answers at once."""
    code = (
        "import sys, vlp16emu\n"
        f"print(*sorted({HEAVY | {'typer'}!r} & set(sys.modules)), file=sys.stderr)\n"
        "from vlp16emu.cli.app import run\n"
        f"for verb in {['', *VERBS]!r}:\n"
        "    code = run([*verb.split(), '--help'])\n"
        f"    print(verb, code, *sorted({HEAVY!r} & set(sys.modules)), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    # typer itself looks at a verb's options with pydantic
    assert done.stderr.splitlines() == ["", " 0", *(f"{verb} 0 pydantic" for verb in VERBS)]
    assert done.stdout.count("Usage: vlp16emu") == 1 + len(VERBS)


def test_help_fits_the_terminal(cli, monkeypatch):
    """Help is no wider than the terminal, apart from example lines that must not be broken."""
    for width, verb in product((80, 120), VERBS):
        monkeypatch.setenv("COLUMNS", str(width))
        text, _, _ = cli(verb, "--help").out.partition("Examples:")
        assert max(map(len, text.splitlines())) <= width, (verb, width)


def test_no_arguments_means_help(cli):
    """Called without arguments the program shows its verbs."""
    outcome = cli()
    assert outcome.code == 0
    assert all(f"\n  {verb}  " in outcome.out for verb in VERBS)


def test_the_version_is_that_of_the_package(cli):
    """`--version` prints the name and the version that pip knows."""
    from importlib.metadata import version

    assert cli("--version").out == f"vlp16emu {version('vlp16emu')}\n"


def test_a_reader_that_has_had_enough_is_no_error(main_here):
    """Output into a pipe that is closed early ends without a word."""
    end, pipe = os.pipe()
    os.close(end)
    with os.fdopen(pipe, "w", buffering=1) as stdout:
        assert main_here("schema", stdout=stdout) == (1, "")


@pytest.mark.parametrize(
    ("line", "more"),
    [
        *((line, "") for line in ("--help", "schema", "stream static_bench --duration 0.1")),
        ("record static_bench - --duration 0.1", " at packet 1; no file is written"),
    ],
)
def test_output_that_cannot_be_written_is_one_line(main_here, line, more):
    """A full disk under stdout is reported in one line: at the first word, midway or at the end,
    and the run has failed."""
    with Path("/dev/full").open("w") as full:
        said = f"error: standard output: No space left on device{more}\n"
        assert main_here(*line.split(), stdout=full) == (1, said)


def test_warnings_are_lines_on_stderr(main_here, tmp_path):
    """What a run goes on with, but its user may not expect, is one line on stderr, a warning."""
    settings = "--set", "motion.x_m=100.0", "--set", "duration_s=0.1"
    with (tmp_path / "out").open("w") as stdout:
        code, said = main_here("plan", "static_bench", *settings, "--repeats", "1", stdout=stdout)
    assert (code, said.count("\n")) == (0, 1)
    assert said.startswith(
        "warning: hall: the path of the sensor leaves it at (100, 0) m; expected x between"
    )


@pytest.mark.parametrize(
    "error", [MemoryError("Unable to allocate 9 EiB"), RuntimeError("can't start new thread")]
)
def test_memory_that_runs_out_is_reported(cli, monkeypatch, error):
    """A run that finds no memory or no thread left ends with code 1 and one line."""

    def greedy(*_arguments, **_options):
        raise error

    monkeypatch.setattr("vlp16emu.scenario.load", greedy)
    outcome = cli("plan", "static_bench")
    lacking = "memory" if isinstance(error, MemoryError) else "memory or threads"
    assert (outcome.code, outcome.err) == (1, f"error: out of {lacking}: {error}\n")


def test_what_a_terminal_cannot_show_is_reported_all_the_same(main_here, tmp_path):
    """A name that standard output has no letters for is written with their numbers, and the run ends well."""
    out = tmp_path / "f\N{LATIN SMALL LETTER O WITH DIAERESIS}n.pcap"
    with (tmp_path / "said").open("w", encoding="ascii") as stdout:
        assert main_here("record", "static_bench", out, "--duration", "0.01", stdout=stdout) == (0, "")
    assert "f\\xf6n.pcap" in (tmp_path / "said").read_text()


def test_scenes_are_listed(cli):
    """Each scene that can be called by name has a line with its duration and title; the JSON list has its
    kinds and the path of its file."""
    lines, rows = cli("scenes").out.splitlines(), cli("scenes", "--json").tree["scenes"]
    assert lines[0] == "scenes"
    assert [line.split()[0] for line in lines[1:]] == list(scene_files())
    assert lines[1].endswith("60 s  A walk through a stand of silver birch")
    assert {row["name"]: row["file"] for row in rows} == {n: str(p) for n, p in scene_files().items()}
    assert (rows[0]["motion"], rows[0]["world"]) == ("walk", "forest")


def test_the_schema_is_printed_whole(cli):
    """`schema` prints one JSON object, the schema of the scene file."""
    assert cli("schema").tree == schema()


def test_a_scene_that_cannot_be_read_is_left_out_of_the_list(cli, tmp_path, monkeypatch, caplog):
    """`scenes` names a wrong file of the user's folder in one warning, and lists the others."""
    (tmp_path / "bad.toml").write_text("bogus = 3\n")
    monkeypatch.setenv("VLP16EMU_SCENES", str(tmp_path))
    outcome = cli("scenes", "--json")
    assert outcome.code == 0
    names = {row["name"] for row in outcome.tree["scenes"]}
    assert "static_bench" in names
    assert "bad" not in names
    assert [record.message.endswith("; left out") for record in caplog.records] == [True]


@pytest.mark.parametrize("text", ["0", "-3"])
def test_a_number_of_threads_that_numba_refuses_is_one_line(cli, monkeypatch, text):
    """Without the check `import numba` raises ValueError."""
    monkeypatch.setenv("NUMBA_NUM_THREADS", text)
    outcome = cli("plan", "static_bench")
    expected = f"error: NUMBA_NUM_THREADS: found {text}; expected 1 or more, or no such variable\n"
    assert (outcome.code, outcome.err) == (2, expected)
