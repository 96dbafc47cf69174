"""What all verbs have in common: a good run, one JSON object, Ctrl-C, and a line for an unknown
option."""

import io
import json
import shutil
import signal

import pytest

from vlp16emu.cli.app import run
from vlp16emu.doors import DOORS

NO_PORTS = "--data-port 9 --position-port 10"
SMALL = "--set camera.width_px=32 --set camera.height_px=24"
SPEC = """
schema = 1
layout = "pcap+truth"
seeds = [1]
stands = [{ name = "hall", scene = "static_bench", set = ["duration_s=0.1"] }]
paths = [{ name = "middle" }]
sensors = [{ name = "puck" }]
splits = { train = 1.0, val = 0.0, test = 0.0 }
"""
GOOD = {
    "record": "static_bench x.pcap --duration 0.02",
    "stream": f"static_bench --duration 0.02 --no-keep-up {NO_PORTS}",
    "replay": f"{{inputs}}/bench.pcap --speed 1000 {NO_PORTS}",
    "decode": "{inputs}/bench.pcap",
    "verify": "{inputs}/bench.pcap",
    "scenes": "",
    "schema": "",
    "plan": "static_bench --set duration_s=0.02",
    "doctor": "",
    "cache": "",
    "truth": "static_bench t --duration 0.02",
    "points": "static_bench x.npz --duration 0.02",
    "bag": "{inputs}/bench.pcap x.bag",
    "picture": "static_bench x.png --duration 0.2 --size 64x64 --view sweep",
    "images": f"static_bench images --duration 0.02 {SMALL}",
    "view": "static_bench --port 0",
    "dataset": "spec.toml out --workers 0",
    "score": "{inputs}/truth --trajectory {inputs}/truth/trajectory.tum",
    "compare": "{inputs}/bench.pcap {inputs}/bench.pcap",
    "fit": "{inputs}/bench.pcap",
    "forest": "static_bench",
    "accuracy": "static_bench --pulses 128",
    "plot": "forest.json x.svg",
}
"""Arguments of a short run of each verb."""
PLAIN = {
    "schema",
    "view",
    "fit",
    "plot",
}  # these print a schema, an address, tables of TOML, and a file's name
OF_MACHINE = {"doctor"}  # its exit code says whether the machine is fit


@pytest.fixture
def words(request, inputs, tmp_path, monkeypatch):
    """Words of the good run of a verb, in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "spec.toml").write_text(SPEC)
    verb = request.param
    if verb == "plot":
        with (tmp_path / "forest.json").open("w") as report, monkeypatch.context() as patch:
            patch.setattr("sys.stdout", report)
            assert run(["forest", "static_bench", "--json"]) == 0
    return [verb, *GOOD[verb].format(inputs=inputs).split()]


def each(verbs):
    return pytest.mark.parametrize("words", sorted(verbs), indirect=True)


def test_every_verb_is_here():
    """No verb is without its row."""
    assert GOOD.keys() == DOORS["verbs"].keys()


@each(GOOD.keys() - PLAIN)
def test_a_good_run_is_told_to_people_and_programs(cli, words):
    """Exit code 0 and nothing on stderr; with --json, which the help names, standard output is one object
    of strict JSON."""
    for options in ([], ["--json"]):
        shutil.rmtree("images", ignore_errors=True)  # must be new or empty
        outcome = cli(*words, *options)
        assert outcome.err == ""
        assert outcome.code == 0 or words[0] in OF_MACHINE
        assert outcome.out
    assert isinstance(json.loads(outcome.out, parse_constant=pytest.fail), dict)
    assert "  --json " in cli(words[0], "--help").out


@each(PLAIN - {"view"})
def test_a_good_run_without_json_is_told(cli, words):
    """Exit code 0 and nothing on stderr; no --json is in the help."""
    outcome = cli(*words)
    assert (outcome.code, outcome.err) == (0, "")
    assert "\n  --json " not in cli(words[0], "--help").out


class Interrupting(io.StringIO):
    """Standard output whose reader sends Ctrl-C at the first word."""

    def write(self, text):
        """Raise the signal."""
        signal.raise_signal(signal.SIGINT)
        return len(text)


@pytest.fixture
def ctrl_c():
    """Let Ctrl-C interrupt: a shell lets its jobs in the background ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@each(GOOD)
@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c_ends_every_verb(words, monkeypatch, capsys):
    """Ctrl-C while a verb has something to say ends it with 130, without a word on stderr."""
    monkeypatch.setattr("sys.stdout", Interrupting())
    assert run(words) == 130
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("verb", GOOD)
def test_an_unknown_option_is_one_line(cli, verb):
    """Exit code 2, and the line names the help of the verb."""
    outcome = cli(verb, "--no-such-option")
    assert (outcome.code, outcome.out) == (2, "")
    assert outcome.err == f"error: No such option: --no-such-option; see `vlp16emu {verb} --help`\n"
