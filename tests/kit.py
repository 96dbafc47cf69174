"""What tests of several rooms need: words of command lines, the table of bad input, packets and captures
of real sensors."""

import tomllib
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from vlp16emu.captures import Capture
from vlp16emu.packets import DATA_BYTES

DEFAULT_UNIT = str(Path(__file__).parent / "default_unit.toml")
CAPTURES = Path(__file__).resolve().parents[2] / "shared" / "captures"


def set_words(settings):
    """Words of a command line for settings `key=value`, or for values by key."""
    if isinstance(settings, dict):
        settings = [f"{key}={value}" for key, value in settings.items()]
    return [word for setting in settings for word in ("--set", setting)]


def data_payloads(packets):
    """Bytes (n, 1206) of the data packets among packets, or in a capture."""
    if isinstance(packets, Path):
        return data_payloads(list(Capture(packets)))
    found = [packet.payload for packet in packets if len(packet.payload) == DATA_BYTES]
    return np.frombuffer(b"".join(found), np.uint8).reshape(-1, DATA_BYTES)


def real_capture(name):
    """Path of a capture of a real sensor; the test is skipped where there is none."""
    if not (CAPTURES / name).exists():
        pytest.skip(f"the real capture {name} is not beside the repository")
    return CAPTURES / name


@cache
def refusals():
    """Tables of bad input, and the files that its command lines name."""
    return tomllib.loads((Path(__file__).parent / "refusals.toml").read_text(encoding="utf-8"))
