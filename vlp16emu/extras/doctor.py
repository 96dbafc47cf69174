"""Checks of this machine for all verbs, with a remedy for each failure."""

import os
import platform
import shutil
import tempfile
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

from vlp16emu.errors import Vlp16emuError
from vlp16emu.extras.readiness import Check, Condition, sending_checks
from vlp16emu.kernels.cache import kernel_names, user_kernels
from vlp16emu.store import user_store

_EXTRAS = {
    "cloud": (("laspy", "lazrs", "pypcd4"), "points in LAS and LAZ, score of PCD"),
    "data": (("pyarrow",), "--truth-returns, labels of captures"),
    "dem": (("rasterio",), "heights from GeoTIFF files (world.dem)"),
    "images": (("OpenEXR", "PIL"), "images"),
    "picture": (("matplotlib", "PIL", "imageio_ffmpeg"), "picture, forest --picture"),
    "ros": (("rosbags",), "bag, record into bags"),
    "score": (("evo", "matplotlib"), "score"),
    "viewer": (("viser", "tomlkit", "websockets"), "view"),
}
"""Libraries of each extra in pyproject.toml, and what needs them."""
_WIDEST = ("avx512f", "avx2", "avx", "sse4_2", "asimd")
"""Instruction sets that Embree has kernels for, by their names in /proc/cpuinfo, the widest first (Embree 4 manual, rtcNewDevice)."""
_FEWEST_CORES = 2
_CASTER = "raycast."  # begin of the names of compiled kernels of that room


def all_checks() -> Iterator[Check]:
    """Yield the results of all checks, one after the other."""
    yield _cores()
    yield _kernels()
    yield _embree()
    yield from sending_checks()
    for extra, (libraries, purpose) in _EXTRAS.items():
        yield _extra(extra, libraries, purpose)
    yield _disk()


def _cores() -> Check:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if cores >= _FEWEST_CORES:
        return Check("cores", Condition.OK, f"{cores}")
    return Check("cores", Condition.WARNING, f"{cores}", "stream --prepare: the engine then has it before the sender")


def _kernels() -> Check:
    folder, names = user_kernels().own, kernel_names()
    casting = any(name.startswith(_CASTER) for name in names)
    if folder is None and not casting:
        mend = "export NUMBA_CACHE_DIR=FOLDER, of one in which nobody else can write"
        return Check("kernel cache", Condition.WARNING, "no safe folder: each run compiles for a minute", mend)
    if not casting:
        lacking = f"{folder} lacks those of casting: the next run compiles them first"
        return Check("kernel cache", Condition.WARNING, lacking, "vlp16emu cache --compile")
    where = folder or "the package alone"
    return Check("kernel cache", Condition.OK, f"{len(names)} kernels in {where}")


def _embree() -> Check:
    from vlp16emu.raycast.embree import device

    try:
        device()
    except (Vlp16emuError, ImportError, OSError) as error:
        return Check("Embree", Condition.PROBLEM, str(error), "pip install --force-reinstall embreex")
    return Check("Embree", Condition.OK, f"loads; {_instructions()}")


def _instructions() -> str:
    """Return the widest instruction set of this processor that Embree has kernels for."""
    try:
        flags = set(Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace").split())
    except OSError:
        flags = set()
    return next((name for name in _WIDEST if name in flags), platform.machine())


def _extra(extra: str, libraries: tuple[str, ...], purpose: str) -> Check:
    missing = [library for library in libraries if find_spec(library) is None]
    if not missing:
        return Check(f"extra {extra}", Condition.OK, f"installed, for {purpose}")
    found = f"without {', '.join(missing)}: no {purpose}"
    return Check(f"extra {extra}", Condition.WARNING, found, f"pip install 'vlp16emu[{extra}]'")


def _disk() -> Check:
    store = user_store()
    if store.folder is None:
        return Check("world cache", Condition.WARNING, "off: each run grows its world", "unset VLP16EMU_CACHE_DIR")
    there = next(folder for folder in (store.folder, *store.folder.parents) if folder.is_dir())
    free = shutil.disk_usage(there).free
    found = f"{free / 1e9:.1f} GB free for at most {store.most_bytes / 1e9:.1f} GB in {store.folder}"
    if not os.access(there, os.W_OK):
        mend = f"export VLP16EMU_CACHE_DIR={tempfile.gettempdir()}/vlp16emu-worlds"
        return Check("world cache", Condition.WARNING, f"{there} cannot be written", mend)
    if free >= store.most_bytes:
        return Check("world cache", Condition.OK, found)
    return Check("world cache", Condition.WARNING, found, "export VLP16EMU_CACHE_MB=100, or another VLP16EMU_CACHE_DIR")
