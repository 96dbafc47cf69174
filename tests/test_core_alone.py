"""The core without what stands around it."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from listening import opened, port_of

import vlp16emu
from vlp16emu import Emulator
from vlp16emu.packets import DATA_BYTES, POSITION_BYTES

ROOT = Path(vlp16emu.__file__).parents[1]
AROUND = ("forest", "foliage", "extras")
SPAN_S = 0.3


@pytest.fixture(scope="module")
def core(tmp_path_factory):
    """Run the command line of a copy of the package without forest, foliage and extras; give what it
    prints."""
    folder = tmp_path_factory.mktemp("core")
    shutil.copytree(
        ROOT / "vlp16emu", folder / "vlp16emu", ignore=shutil.ignore_patterns("__pycache__", *AROUND)
    )
    for name in ("protocol", "scenes", "pyproject.toml"):
        (folder / name).symlink_to(ROOT / name)
    env = os.environ | {"PYTHONPATH": str(folder)}

    def run(*lines):
        """Carry out command lines in one process; gives the greatest exit code, and what it printed on
        stdout and stderr."""
        program = "import sys, json; from vlp16emu.cli.app import run; "
        program += "sys.exit(max([run(line) for line in json.loads(sys.argv[1])]))"
        command = [sys.executable, "-c", program, json.dumps([[*map(str, line), "--json"] for line in lines])]
        return subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, check=False)

    assert not [name for name in AROUND if (folder / "vlp16emu" / name).exists()]
    return run


@pytest.fixture(scope="module")
def packets():
    """What the whole package sends."""
    return list(Emulator("static_bench").packets(0.0, SPAN_S))


def test_it_records_streams_and_decodes_the_same_bytes(core, packets, tmp_path):
    """`record` gives the file, and `stream` over UDP the payloads, of the whole package; `decode` reads as
    many points as were returned."""
    whole, alone = tmp_path / "whole.pcap", tmp_path / "alone.pcap"
    returns = Emulator("static_bench").record(whole, duration_s=SPAN_S).returns
    with opened(0) as data, opened(0) as position:
        kinds = ("data", data), ("position", position)
        ports = [f"--set=sensor.{kind}_port={port_of(one)}" for kind, one in kinds]
        span = "--duration", SPAN_S
        record, stream = ("record", "static_bench", alone, *span), ("stream", "static_bench", *span, *ports)
        done = core(record, stream, ("decode", alone))
        assert done.returncode == 0, done.stderr
        assert f'"points": {returns},' in done.stdout
        assert alone.read_bytes() == whole.read_bytes()
        for receiver, length in ((data, DATA_BYTES), (position, POSITION_BYTES)):
            sent = [packet.payload for packet in packets if len(packet.payload) == length]
            assert len(sent) > 20
            assert [receiver.recv(2000) for _ in sent] == sent


def test_a_scene_with_events_is_refused_in_one_line(core, tmp_path):
    """What can happen to a sensor is an extra: its absence is one clear line, and no file is made."""
    events = "--set", 'events=[{kind = "drop", at_s = 0.1}]'
    done = core(("record", "static_bench", tmp_path / "x.pcap", *events))
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert "vlp16emu.extras" in done.stderr
    assert "expected a complete installation" in done.stderr
    assert not list(tmp_path.iterdir())
