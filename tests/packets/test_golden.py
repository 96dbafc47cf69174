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
    sequences = 2 * len(meaning["input"]["reading_deg"])
    distance_m, reflectivity = np.zeros((2, sequences, 16, 3))
    for pulse in meaning["pulse"]:
        for axis, which in enumerate(("strongest", "last", "second")):
            at = pulse["sequence"], pulse["laser"], axis
            distance_m[at], reflectivity[at] = pulse.get(which, (0, 0))
    returns = make_returns(
        sequences,
        clock_ns=meaning["input"]["clock_ns"],
        reading_deg=np.repeat(meaning["input"]["reading_deg"], 2),
        distance_m=distance_m.astype(np.float32),
        reflectivity=reflectivity.astype(np.uint8),
    )
    payloads = data_payloads(returns, ReturnMode(meaning["return_mode"]), SensorModel(meaning["model"]))
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
    subprocess.run([sys.executable, ROOT / "tools" / "golden", tmp_path], check=True, stdout=subprocess.DEVNULL)
    written = {path.name: path.read_text() for path in tmp_path.glob("*.hex")}
    assert written == {path.name: path.read_text() for path in GOLDEN.glob("*.hex")}
    assert len(written) == len(MEANINGS)


def test_by_hand():
    """Bytes worked out with pencil and paper stand where the manual says."""
    payload = golden("strongest")
    assert payload[0:4] == b"\xff\xee\x39\x30"  # 123.45 deg = 12345 = 0x3039
    assert payload[4:7] == b"\xfa\x00\x00"  # 0.500 m = 250 = 0x00FA, reflectivity 0
    assert payload[49:52] == b"\xff\xff\xff"  # laser 15: 131.070 m = 65535, reflectivity 255
    # Sequence 11, laser 8: block 5, record 24, at 500 + 4 + 72; 12.346 m = 6173 = 0x181D, 55 = 0x37.
    assert payload[576:579] == b"\x1d\x18\x37"
    assert payload[1197:1200] == b"\x50\xc3\x64"  # last record: 100 m = 50000 = 0xC350, reflectivity 100
    assert payload[1200:] == b"\xf3\x34\x83\x40\x37\x22"  # 1 082 340 595 us = 0x408334F3, 0x37, 0x22
    dual = golden("dual")
    assert dual[2:4] == dual[102:104] == b"\x94\x11"  # 45.00 deg = 4500 = 0x1194 in both blocks of the pair
    assert dual[16:19] == b"\x74\x0e\x0a"  # laser 4, even block: last at 7.400 m = 3700 = 0x0E74, 10
    assert dual[116:119] == b"\x34\x08\x3c"  # odd block: strongest at 4.200 m = 2100 = 0x0834, 60
    assert dual[1204] == 0x39
    assert golden("position_gps")[198:213] == b"\x71\x3a\x83\x40\x02\0\0\0$GPRMC,"  # 1 082 342 001 = 0x40833A71


def test_coverage():
    """Between them the golden packets use every laser, every firing sequence, every mode and every dual case."""
    strongest, dual = MEANINGS["strongest"]["pulse"], MEANINGS["dual"]["pulse"]
    assert {pulse["laser"] for pulse in strongest} == set(range(16))
    assert {pulse["sequence"] for pulse in strongest} == set(range(24))
    assert {MEANINGS[name]["return_mode"] for name in DATA} == set(ReturnMode)
    assert {(p["strongest"] == p["last"], "second" in p) for p in dual} == {
        (True, False),
        (True, True),
        (False, False),
        (False, True),
    }
