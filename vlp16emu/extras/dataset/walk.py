"""The making of one walk, in any process and on any machine."""

import tempfile
from pathlib import Path
from threading import get_ident

from vlp16emu.engine import in_one_world
from vlp16emu.errors import InputError, RunError
from vlp16emu.extras.dataset.layouts import LAYOUTS
from vlp16emu.extras.dataset.manifest import Entry, described_files, identity, write_list
from vlp16emu.extras.dataset.spec import DatasetWalk
from vlp16emu.run.emulator import Emulator
from vlp16emu.run.options import Span

Made = tuple[DatasetWalk, Path, Entry]
"""A walk, the folder with its files, and its entry in the manifest."""

_LATEST: dict[int, Emulator] = {}
"""Emulator of the latest walk of each thread of this process, whose world the next walk may share."""


def make_walk(walk: DatasetWalk, parts: Path, threads: int) -> Made:
    """Make the files of a walk in a new folder inside `parts`.

    The world of the latest walk of this thread is reused if it fits; that never changes a byte.
    Raises InputError, in the name of the walk, if its scene cannot be made; RunError if its files cannot be
    written.
    """
    latest = _LATEST.pop(get_ident(), None)
    like = latest if latest and in_one_world(walk.scenario, latest.scenario) else None
    del latest  # before the next world is grown
    try:
        folder = Path(tempfile.mkdtemp(dir=parts))
        folder.chmod(0o755)
        emulator = Emulator(walk.scenario, threads=threads, like=like)
        LAYOUTS[walk.layout](emulator, folder, Span())
        beams = len(emulator.parts.units[0].head.beams.elevation_deg)
        entry = identity(walk) | {"beams": beams, "files": described_files(folder)}
        write_list(folder, entry)
    except OSError as error:
        raise RunError(f"walk {walk.name}: {error.strerror}; what is made so far is kept") from None
    except InputError as error:
        raise InputError(f"walk {walk.name}: {error.where}", error.found, error.expected) from None
    _LATEST[get_ident()] = emulator
    return walk, folder, entry


def forget_worlds() -> None:
    """Free the worlds that this process keeps from walk to walk."""
    _LATEST.clear()
