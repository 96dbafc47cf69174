"""What is shown of a run while it goes on, and of its error."""

import io
import json
import sys
import threading

import pytest

from vlp16emu.cli.printer import audit_text, rows_of, tree_of
from vlp16emu.cli.terminal import Progress, compile_first
from vlp16emu.extras.accuracy.audit import AuditFinding
from vlp16emu.kernels import compiler


class Terminal(io.StringIO):
    """A terminal that notes when a text is written, or is gone."""

    def __init__(self, text):
        super().__init__()
        self.text, self.has_come, self.is_gone = text, threading.Event(), False

    def isatty(self):
        """Be a terminal."""
        return True

    def write(self, text):
        """Note a text, or fail."""
        if self.is_gone:
            raise OSError(5, "Input/output error")
        if self.text in text:
            self.has_come.set()
        return super().write(text)


def test_growth_is_seen_to_go_on(monkeypatch):
    """Until there is something to show, the bar counts the seconds of the growth of the world."""
    terminal = Terminal("growing the world, 1 s")
    monkeypatch.setattr(sys, "stderr", terminal)
    with Progress(10.0) as progress:
        assert terminal.has_come.wait(30)
        progress.show("recording", 1.0)
    assert "1.0 of 10.0 s" in terminal.getvalue()


def test_a_run_has_a_bar_with_the_time_left(cli, monkeypatch, tmp_path):
    """With a terminal on stderr there is a progress bar; stdout keeps to the JSON object."""
    terminal = Terminal("left")
    monkeypatch.setattr(sys, "stderr", terminal)
    tree = cli("record", "static_bench", tmp_path / "x.pcap", "--duration", "1", "--json").tree
    assert terminal.has_come.is_set()
    assert "of 1.0 s" in terminal.getvalue()
    assert tree["packets"] == int(1e9 // 1_327_104)


def test_a_terminal_that_goes_ends_the_bar_alone(monkeypatch):
    """Where the terminal can no longer be written, what shows its progress on it goes on."""
    terminal = Terminal("recording")
    monkeypatch.setattr(sys, "stderr", terminal)
    with Progress(10.0) as progress:
        progress.show("recording", 1.0)
        terminal.is_gone = True
        progress._next_s = 0.0
        progress.show("recording", 2.0)
    assert terminal.has_come.is_set()


def test_the_first_run_says_how_far_it_has_compiled(monkeypatch, capsys):
    """Two lines on stderr, at the begin and at the end; in a terminal one that counts; none where nothing
    is compiled."""
    monkeypatch.setattr(compiler, "compile_kernels", lambda _: iter([(0, 2), (1, 2), (2, 2)]))
    compile_first("hall")
    first, last = "compiling kernels: 0 of 2, once", "compiling kernels: 2 of 2, once"
    assert capsys.readouterr() == ("", f"{first}\n{last}\n")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    compile_first("hall")
    assert capsys.readouterr() == ("", f"\r{first}\r{first.replace('0', '1')}\r{last}\n")
    monkeypatch.setattr(compiler, "compile_kernels", lambda _: iter([]))
    compile_first("hall")
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("low_m", "high_m", "said"),
    [
        (0.0131, 0.0503, "95 %: 13.1 to 50.3 mm"),
        (0.0002, 9.923, "run too short for an interval"),
        (None, None, "interval not known from so few"),
    ],
)
def test_an_interval_that_gives_no_order_of_magnitude_is_left_out(low_m, high_m, said):
    """An interval whose one end is ten times the other does not state the error."""
    assert f"RMSE 25.7 mm before noise ({said}), 0.0 % lost" in audit_text(
        AuditFinding(False, 100, 0.0257, low_m, high_m, 0.0, 0.0, 0.0)
    )


def test_a_zero_has_no_sign():
    """A small negative number rounds to 0 in rows, and a negative zero is 0.0 in JSON: `-0` is no result."""
    fit = {"rate_ppm": -0.0, "offset_s": -0.0, "median_delay_ms": 0.0, "most_delay_ms": 0.0, "parts": 1}
    assert rows_of({"host_ahead_s": -2e-4, "fit": fit}) == {
        "host ahead": "0 s",
        "host's clock": "+0 ppm, +0.000000 s from the sensor's, "
        "packets late by 0 ms in the median and 0 ms at most",
    }
    assert json.dumps(tree_of({"host_ahead_s": -0.0})) == '{"host_ahead_s": 0.0}'
