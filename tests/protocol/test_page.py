"""Statements of `protocol/README.md` about packets, as packets have them."""

import re
from pathlib import Path

import numpy as np
import pytest
from kit import data_payloads

from vlp16emu import Emulator
from vlp16emu.packets import decode_data

PAGE = (Path(__file__).parents[2] / "protocol" / "README.md").read_text(encoding="utf-8")


def answer(question):
    """Return what the table of open questions says that this program does."""
    (row,) = re.findall(rf"(?m)^\| {question} \|.*\|$", PAGE)
    return row.strip("| ").split(" | ")[-1]


def no_return_codes(preset):
    """Return the codes of records without a return in the hall, and the distances of the others in metres."""
    emulator = Emulator("static_bench", {"noise.preset": preset, "sensor.max_range_m": 6.0})
    points = decode_data(data_payloads(emulator.packets(0.0, 0.05)), keep_no_returns=True)
    is_empty = points.distance_m == 0
    return points.reflectivity[is_empty], points.distance_m[~is_empty]


@pytest.mark.parametrize("preset", ["unit", "ideal", "typical", "datasheet"])
def test_codes_of_no_returns_are_as_the_page_says(preset):
    """No-returns have a code with the preset that the page names first, and 0 with the others."""
    with_code, without = answer("Reflectivity where there is no return").split("; 0 with ")
    codes, _ = no_return_codes(preset)
    assert len(codes) > 1000
    assert (np.mean(codes > 0) > 0.5) == (f'"{preset}"' in with_code)  # a laser of a unit may have codes of 0
    assert (codes == 0).all() == (f"`{preset}`" in without)


def test_the_least_distance_is_as_the_page_says():
    """No record has a distance code from 1 to 249, below half a metre."""
    assert answer("Least distance") == "codes 1 to 249 never occur"
    _, distance_m = no_return_codes("unit")
    assert distance_m.min() >= 0.5
