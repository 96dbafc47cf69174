"""The golden packets in both directions, and a second writer's opinion of them."""

import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from packets.kit import make_returns

from vlp16emu.packets import data_payloads, pack_position, rmc
from vlp16emu.sensor.beams import MODELS
from vlp16emu.types import GnssFix, PpsState, ReturnMode, SensorModel

ROOT = Path(__file__).resolve().parents[2]
GOLDEN = ROOT / "protocol" / "golden"
MEANINGS = {path.stem: tomllib.loads(path.read_text()) for path in sorted(GOLDEN.glob("*.toml"))}
DATA = [name for name, meaning in MEANINGS.items() if meaning["kind"] == "data"]
POSITION = [name for name, meaning in MEANINGS.items() if meaning["kind"] == "position"]


def golden(name):
    return bytes.fromhex((GOLDEN / f"{name}.hex").read_text())


def fix_of(meaning):
    fix = dict(meaning["fix"])
    return GnssFix(t_ns=int(fix.pop("utc").timestamp()) * 10**9, **fix)


@pytest.mark.parametrize("name", DATA)
def test_pack_data(name):
    """What the sensor measured becomes exactly the golden bytes."""
    meaning = MEANINGS[name]
    model = MODELS[SensorModel(meaning["model"])]
    sequences = model.beams.per_reading * len(meaning["input"]["reading_deg"])
    distance_m, reflectivity = np.zeros((2, sequences, model.lasers, 3))
    for pulse in meaning["pulse"]:
        for axis, which in enumerate(("strongest", "last", "second")):
            at = pulse["sequence"], pulse["laser"], axis
            distance_m[at], reflectivity[at] = pulse.get(which, (0, 0))
    returns = make_returns(
        sequences,
        clock_ns=meaning["input"]["clock_ns"],
        reading_deg=np.repeat(meaning["input"]["reading_deg"], model.beams.per_reading),
        distance_m=distance_m.astype(np.float32),
        reflectivity=reflectivity.astype(np.uint8),
        lasers=model.lasers,
    )
    payloads = data_payloads(returns, ReturnMode(meaning["return_mode"]), model.name)
    assert payloads.tobytes().hex() == golden(name).hex()


@pytest.mark.parametrize("name", POSITION)
def test_pack_position(name):
    """Clock, state and sentence become exactly the golden bytes, and the sentence comes from its fix."""
    meaning = MEANINGS[name]
    sentence = rmc(fix_of(meaning)) if "fix" in meaning else b""
    payload = pack_position(meaning["input"]["clock_ns"], PpsState[meaning["pps"].upper()], sentence)
    assert payload.hex() == golden(name).hex()


def test_second_writer_agrees(tmp_path):
    """The writer in tools/golden, which shares no line with the packer, makes the same files."""
    for path in GOLDEN.glob("*.toml"):
        shutil.copy(path, tmp_path)
    subprocess.run(
        [sys.executable, ROOT / "tools" / "golden", tmp_path], check=True, stdout=subprocess.DEVNULL
    )
    written = {path.name: path.read_text() for path in tmp_path.glob("*.hex")}
    assert written == {path.name: path.read_text() for path in GOLDEN.glob("*.hex")}
    assert len(written) == len(MEANINGS)
