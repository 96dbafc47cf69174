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
    """The package imports no library, and `--help` no numerical one, no validation and no emulator: it answers at once."""
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


RECORD, STREAM = "record static_bench {tmp}/x.pcap", "stream static_bench"
WRONG = [
    # command line, option, what it is given, what is expected
    *(
        (RECORD, "--duration", found, "a number above 0 and at most 604800")
        for found in ("-1", "nan", "inf", "ten")
    ),
    (RECORD, "--start", "-1", "a number from 0 to 604800"),
    (RECORD, "--start", "11", "less than the scene's 10 s, or a --duration"),
    (RECORD, "--threads", "1.5", "a whole number from 0 to 1024"),
    (RECORD, "--threads", "9" * 350, "a whole number from 0 to 1024"),
    (RECORD, "--truth-rate", "0", "a whole number from 1 to 10000"),
    (STREAM, "--data-port", "-1", "a whole number from 0 to 65535"),
    (STREAM, "--position-port", "65536", "a whole number from 0 to 65535"),
    (STREAM, "--to", "10.0.0.1:x", "HOST or HOST:PORT, with a port from 1 to 65535"),
    *((STREAM, "--speed", found, "a number at least 0.001") for found in ("0", "1e-300", "inf")),
    (STREAM, "--late", "burst", "pace or skip"),
    (STREAM, "--gps-pps", "cts", "dtr, rts or off"),
    ("points static_bench {tmp}/x.npz", "--unit", "0", "a whole number at least 1"),
    ("decode {tmp}/x.pcap", "--frame", "ned", "sensor or manual"),
    ("forest birch_walk", "--radius", "0", "a number from 1 to 300"),
    ("accuracy static_bench", "--pulses", "5", "a whole number from 128 to 1000000"),
]
BAD = [
    # command line, exit code, the line after "error: "; {tmp} is an empty folder
    ("bogus", 2, "No such command 'bogus'; see `vlp16emu --help`"),
    ("record static_bench", 2, "Missing argument 'OUT'; see `vlp16emu record --help`"),
    ("record static_bench x --bad", 2, "No such option: --bad; see `vlp16emu record --help`"),
    ("record nope {tmp}/x.pcap", 2, "scene 'nope': unknown name; expected birch_walk, "),
    ("record {tmp}/no.toml {tmp}/x.pcap", 2, "{tmp}/no.toml: no such file or directory; expected a scene file"),
    ("record static_bench {tmp}/no/x.pcap", 2, "{tmp}/no/x.pcap: No such file or directory; expected a file that can be "),
    ("record static_bench /dev/full --duration 1", 1, "/dev/full: No space left on device at packet 1; no file is written"),
    *(
        (f"{line} {option} {found}", 2, f"{option}: found {found if len(found) < 99 else found[:111] + '...'}; expected {expected}\n")
        for line, option, found, expected in WRONG
    ),
    *(
        (f"{RECORD} --set {setting}", 2, f"--set {setting}: {said}")
        for setting, said in (
            ("sensor.rpm=250", "found 250; expected a whole number from 300 to 1200 in steps of 60"),
            ("sensor.rpn=600", "unknown key; expected rpm, the nearest known one"),
            ("start_utc=2200-01-01T00:00:00Z", "found 2200-01-01T00:00:00+00:00; expected a time from 1970 to 2105"),
        )
    ),
    *(
        (f"stream static_bench --json {options}", 2, said)
        for options, said in (
            ("--prepare-to -", "-: no file that can be read again; expected the name of a file"),
            ("--prepare-to x.mcap", "x.mcap: found the ending .mcap; expected .pcap"),
            ("--prepare --http 127.0.0.1:0", "--http: found beside --prepare"),
            ("--http 127.0.0.1:0 --truth {tmp}/t --truth-returns", "--truth-packets or --truth-returns: found beside --http"),
            ("--gps-in {tmp}/ttyUSB9", "--gps-in {tmp}/ttyUSB9: No such file"),
            ("--gps-in {tmp}/ttyUSB9 --now", "--gps-in: found beside --now"),
            ("--interface sensor9", "interface sensor9: No such device; expected one of "),
            ("--gps-out loop://", "gps.connected: found false; expected true"),
            ("--imu-out udp://127.0.0.1:9", "imu: no such table in the scene; expected [imu]"),
            ("--set imu.rate_hz=100 --imu-out tcp://127.0.0.1:9", "--imu-out: found tcp://127.0.0.1:9; expected udp://HOST:PORT"),
        )
    ),
    *(
        (f"{line} {options}", 2, said)
        for line in (RECORD, STREAM)
        for options, said in (
            ("--truth-packets", "--truth-packets: found no --truth; expected --truth DIR beside it\n"),
            ("--set sensor.model=free", 'sensor.model: found "free", which has no packets; expected "vlp-16", '),
        )
    ),
    ("record birch_walk {tmp}/x.pcap --duration 1000", 2, "duration: found 1000 s; expected at most "),
    ("replay x.pcap --to 10.0.0.1:2369 --data-port 2368", 2, "--to: found 10.0.0.1:2369 beside --data-port 2368; expected one port for data packets"),
    *(
        (
            f"record static_bench {{tmp}}/x{ending} --duration 0.1",
            2,
            f"{{tmp}}/x{ending}: found the ending {ending}; expected .pcap, or - for standard output{way}",
        )
        for ending, way in (
            (".pcapng", ", which `editcap -F pcapng` converts\n"),
            (".db3", "; a name that ends in / is a bag of ROS 2, a folder with SQLite\n"),
            (".las", "; `vlp16emu points` writes points\n"),
            (".txt", "\n"),
        )
    ),
    ("stream birch_walk --as-sensor", 2, "192.168.1.201:"),  # before any forest is grown
    ("stream static_bench --to nobody.invalid", 2, ""),  # RFC 6761, section 6.4: never exists
    ("verify /dev/zero", 2, "/dev/zero: no capture, it begins with 00 00 00 00"),
    ("decode /dev/null", 2, "/dev/null: no capture, it begins with nothing; expected a pcap or pcapng file"),
    *(
        (f"{verb} {{tmp}}/x", 2, "{tmp}/x: No such file or directory; expected a pcap or pcapng file")
        for verb in ("decode", "verify", "fit", "compare {tmp}/x")
    ),
]  # fmt: skip


@pytest.mark.parametrize(("line", "code", "said"), BAD, ids=[row[0].replace("{tmp}/", "") for row in BAD])
def test_trouble_is_one_line(cli, tmp_path, line, code, said):
    """Foreseeable trouble is one line on stderr that says where, what was found and what was expected."""
    outcome = cli(*line.format(tmp=tmp_path).split())
    assert outcome.code == code
    assert outcome.out == ""
    assert outcome.err.startswith(f"error: {said.format(tmp=tmp_path)}")
    assert outcome.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


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
    """A full disk under stdout is told in one line, be it at the first word, midway or only at the end, and the run has failed."""
    with Path("/dev/full").open("w") as full:
        said = f"error: standard output: No space left on device{more}\n"
        assert main_here(*line.split(), stdout=full) == (1, said)


def test_warnings_are_lines_on_stderr(main_here, tmp_path):
    """What does not stop a run but will surprise is told on stderr, as a warning and in one line."""
    settings = "--set", "motion.x_m=100.0", "--set", "duration_s=0.1"
    with (tmp_path / "out").open("w") as stdout:
        code, said = main_here("plan", "static_bench", *settings, stdout=stdout)
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
    """Each scene that can be called by name has a line with its duration and title; the JSON list has its kinds and the path of its file."""
    lines, rows = cli("scenes").out.splitlines(), cli("scenes", "--json").tree["scenes"]
    assert lines[0] == "scenes"
    assert [line.split()[0] for line in lines[1:]] == list(scene_files())
    assert lines[1].endswith("60 s  A walk through a stand of silver birch")
    assert {row["name"]: row["file"] for row in rows} == {n: str(p) for n, p in scene_files().items()}
    assert (rows[0]["motion"], rows[0]["world"]) == ("walk", "forest")


def test_the_schema_is_printed_whole(cli):
    """`schema` prints one JSON object, the schema of the scene file."""
    assert cli("schema").tree == schema()
