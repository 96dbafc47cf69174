"""Tests grow their worlds themselves, unless they are about what is kept; and what order they come in."""

import os
import tempfile
from pathlib import Path

os.environ["VLP16EMU_CACHE_DIR"] = "off"
# Hypothesis keeps paths of the machine beside the examples that it found: not in the checkout.
os.environ.setdefault(
    "HYPOTHESIS_STORAGE_DIRECTORY", str(Path(tempfile.gettempdir()) / "vlp16emu-hypothesis")
)

WITHOUT_CASTING = ("device", "motion", "packets", "protocol", "report", "scenario", "sensor", "world")
"""Rooms whose tests cast no ray."""


def pytest_sessionstart():
    """Compile one small kernel, so that no program that a test calls says that it is the first to compile."""
    from vlp16emu.trig import in_quarter

    in_quarter(1.0, 0.5)


def pytest_collection_modifyitems(items):
    """Let one of two workers compile the caster's kernels while the other is at tests that need none of them.

    Files are handed out whole and in order, so that what a file has set up serves all of its tests.
    """
    rooms = Path(__file__).parent
    light = [item for item in items if item.path.relative_to(rooms).parts[0] in WITHOUT_CASTING]
    casting = [item for item in items if item not in set(light)]
    first = [item for item in casting if item.path == casting[0].path] if casting else []
    items[:] = first + light + casting[len(first) :]
