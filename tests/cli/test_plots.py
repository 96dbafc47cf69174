"""`--plot`, `vlp16emu plot` and `score --out` from the command line."""

import sys

import pytest

pytest.importorskip("matplotlib", reason="the extra plot is not installed")


@pytest.mark.parametrize(
    "words",
    [
        ("accuracy", "static_bench", "--pulses", "128"),
        ("compare", "{bench}", "{bench}"),
        ("forest", "static_bench"),
        ("plan", "static_bench", "--sample", "0.1", "--repeats", "1"),
    ],
    ids=lambda words: words[0],
)
def test_a_report_can_be_drawn_at_once_or_later(cli, bench, tmp_path, words):
    """`--plot` writes a file, and the printed JSON gives the same bytes to `vlp16emu plot`."""
    outcome = cli(*(word.format(bench=bench) for word in words), "--json", "--plot", tmp_path / "now.svg")
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.tree["report"] == words[0]
    (tmp_path / "a.json").write_text(outcome.out)
    later = cli("plot", tmp_path / "a.json", tmp_path / "later.svg")
    assert later.out.startswith(f"wrote {tmp_path / 'later.svg'}, ")
    assert (tmp_path / "later.svg").read_bytes() == (tmp_path / "now.svg").read_bytes()


def test_lists_of_numbers_are_printed_on_one_line(cli, bench):
    """Long lists do not fill a terminal with a number per line, and the object stays the same."""
    outcome = cli("compare", bench, bench, "--json")
    (edges,) = [line for line in outcome.out.splitlines() if '"edges": [-30.0' in line]
    assert edges.rstrip().endswith("],")
    assert len(outcome.tree["histograms"][0]["edges"]) == 41


def test_a_missing_matplotlib_is_named_before_any_work(cli, tmp_path, monkeypatch):
    """Without matplotlib one line names it and the extra, for plots and pages."""
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setattr("vlp16emu.cli.about.compile_first", None)
    for words in (
        ("accuracy", "static_bench", "--plot", "a.png"),
        ("score", "t", "--map", "m.ply", "--out", "a.html"),
    ):
        monkeypatch.chdir(tmp_path)
        outcome = cli(*words)
        assert outcome.code == 2
        assert outcome.err == "error: a plot needs matplotlib: pip install 'vlp16emu[plot]'\n"
        assert not list(tmp_path.iterdir())


def test_a_plot_replaces_no_file_that_is_read(cli, bench, tmp_path):
    """A plot onto one of the captures, by a link with the right ending, is refused."""
    (tmp_path / "a.png").symlink_to(bench)
    before = bench.read_bytes()
    outcome = cli("compare", bench, bench, "--plot", tmp_path / "a.png")
    assert (outcome.code, bench.read_bytes()) == (2, before)
    assert "is read by this run, and would be written over" in outcome.err
