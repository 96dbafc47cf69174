"""A forest refuses bad options before it grows."""

import socket

import pytest
from woods import WORDS

GROWTH = "vlp16emu.engine.windows"
WALK = ("birch_walk", *WORDS)


@pytest.fixture
def taken():
    """Port of this machine that another program listens on."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server.getsockname()[1]


@pytest.mark.parametrize(
    "words",
    [
        ("record", *WALK, "{folder}/none/x.pcap", "--duration", "0.1"),
        ("record", *WALK, "{folder}", "--duration", "0.1"),
        ("record", *WALK, "{folder}/x.pcap", "--duration", "0.1", "--truth", "{folder}/file"),
        ("record", *WALK, "{folder}/x.pcap", "--duration", "1e9"),
        ("stream", *WALK, "--speed", "0"),
        ("stream", *WALK, "--http", "127.0.0.1:{port}"),
        ("stream", *WALK, "--data-port", "70000"),
        ("points", *WALK, "{folder}/x.docx", "--duration", "0.1"),
    ],
    ids=lambda words: f"{words[0]} {words[-2]} {words[-1]}",
)
def test_bad_options_of_a_forest_open_no_window(refused, caplog, tmp_path, taken, words):
    """A command line that is refused opens no window of the forest, in which trees would grow."""
    caplog.set_level("DEBUG", GROWTH)
    (tmp_path / "file").write_text("of the user", encoding="utf-8")
    refused([word.format(folder=tmp_path, port=taken) for word in words])
    assert not caplog.messages


def test_a_good_command_line_opens_its_window(cli, caplog, tmp_path):
    """The same walk, recorded, opens a window around its path."""
    caplog.set_level("DEBUG", GROWTH)
    outcome = cli("record", *WALK, tmp_path / "x.pcap", "--duration", "0.05", "--no-audit")
    assert outcome.code == 0
    assert any(message.startswith("opens a window around") for message in caplog.messages)
