"""Checks of this machine for all verbs, with a remedy for each failure."""

import os
import platform
import shutil
import socket
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np

from vlp16emu.cores import usable_cores
from vlp16emu.errors import Vlp16emuError
from vlp16emu.kernels.cache import kernel_names, user_kernels
from vlp16emu.libraries import lacking
from vlp16emu.packets.frames import DATA_PORT, FACTORY_LINK, POSITION_PORT
from vlp16emu.sinks import TOLERANCE_NS
from vlp16emu.sinks.pacing import prompt
from vlp16emu.store import user_store

_SLEEPS = 200
_SLEEP_S = (
    0.001_327  # time between two data packets in single return (VLP-16 manual 63-9243 Rev D, section 8.2)
)
_PROMPT_NS = 1_327_104  # a packet with more delay leaves after the next one is due
_COARSE_S = 1e-6
_PAUSE_S = 0.1  # a revolution at 600 rpm: pauses of receivers that share their cores are shorter
_RIG_PACKETS_HZ = 2 * 1508  # data packets of two sensors in dual return (63-9243 Rev D, section 8.2)
_HELD_BYTES = 2304
"""Bytes of a receive buffer that Linux counts for one packet: payload, headers and its own record, rounded
up."""


class Condition(StrEnum):
    """Outcome of a check."""

    OK = "ok"
    WARNING = "warning"  # some runs will suffer
    PROBLEM = "problem"  # some runs will fail


@dataclass(frozen=True, slots=True)
class Check:
    """Result of one check."""

    name: str
    finding: Condition
    found: str
    mend: str = ""  # a command or advice; empty if nothing is to be done


_PURPOSES = {
    "cloud": "points in LAS and LAZ, score of PCD",
    "cluster": "dataset --scheduler",
    "data": "--truth-returns, labels of captures",
    "dem": "heights from GeoTIFF files (world.dem)",
    "picture": "picture",
    "plot": "plot, --plot, score --out",
    "ros": "bag, record into bags",
    "score": "score",
    "viewer": "view",
}  # features that need each extra of pyproject.toml
_WIDEST = ("avx512f", "avx2", "avx", "sse4_2", "asimd")
"""Instruction sets with kernels in Embree, by their names in /proc/cpuinfo, widest first (Embree 4 manual,
rtcNewDevice)."""
_FEWEST_CORES = 2
_CASTER = "raycast."  # prefix of the names of compiled kernels for ray casting


def all_checks() -> Iterator[Check]:
    """Yield the results of all checks; takes half a second."""
    cores = usable_cores()
    few = "stream --prepare: the engine then has it before the sender" if cores < _FEWEST_CORES else ""
    yield _check("cores", f"{cores}", few)
    yield _kernels()
    yield _embree()
    for name, port in (("data port", DATA_PORT), ("position port", POSITION_PORT)):
        reason = _binding_fault("", port)
        taken = (
            f"right for a receiver here; --as-sensor needs it: ss -ulpn 'sport = :{port}' shows its program"
        )
        yield _check(name, f"{port}: {reason}" if reason else f"{port} is free", taken if reason else "")
    address = FACTORY_LINK.source
    is_ours = not _binding_fault(address, 0)
    add = f"for --as-sensor: sudo ip addr add {address}/24 dev IFACE"
    found = f"{address} is {'' if is_ours else 'not '}this machine's"
    yield _check("sensor address", found, "" if is_ours else add, bad=Condition.OK)
    yield _interface_right()
    resolution_s = time.get_clock_info("monotonic").resolution
    mend = "a kernel with high-resolution timers" if resolution_s > _COARSE_S else ""
    yield _check("clock resolution", f"{resolution_s * 1e9:.0f} ns", mend)
    yield _wake_ups()
    yield _buffer()
    for extra, purpose in _PURPOSES.items():
        faults = lacking(extra)
        found = f"without {', '.join(faults)}: no {purpose}" if faults else f"installed, for {purpose}"
        yield _check(f"extra {extra}", found, f"pip install 'vlp16emu[{extra}]'" if faults else "")
    yield _disk()


def _check(name: str, found: str, mend: str = "", *, bad: Condition = Condition.WARNING) -> Check:
    return Check(name, bad if mend else Condition.OK, found, mend)


def _binding_fault(address: str, port: int) -> str:
    """Return the reason why an address cannot be a source; empty if it can."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((address, port))
        except OSError as error:
            return str(error.strerror)
    return ""


def _interface_right() -> Check:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, b"lo")
        except (OSError, AttributeError) as error:
            mend = "for --interface: Linux 5.7, or sudo setcap cap_net_raw+ep on the Python that runs this"
            return _check("interface right", f"--interface is refused: {error}", mend)
    return _check("interface right", "sockets can be bound to an interface")


def _wake_ups() -> Check:
    late_ns = []
    with prompt():  # streams sleep in the same way
        for _ in range(_SLEEPS):
            until_ns = time.monotonic_ns() + round(_SLEEP_S * 1e9)
            time.sleep(_SLEEP_S)
            late_ns.append(time.monotonic_ns() - until_ns)
    median_ns, p99_ns = np.quantile(late_ns, [0.5, 0.99])
    found = f"median {median_ns * 1e-3:.0f} us, 99 % within {p99_ns * 1e-3:.0f} us late"
    mend = "fewer programs at once, or a smaller --threads, so that a core is left to the thread that sends"
    bad = Condition.WARNING if p99_ns <= TOLERANCE_NS else Condition.PROBLEM
    return _check("wake-ups", found, mend if p99_ns > _PROMPT_NS else "", bad=bad)


def _buffer() -> Check:
    """Check if a receiver here may have a buffer for one revolution of two sensors in dual return."""
    needed = round(_PAUSE_S * _RIG_PACKETS_HZ * _HELD_BYTES)
    key = "net.core.rmem_max"
    try:
        most = int(Path("/proc/sys/net/core/rmem_max").read_text(encoding="ascii"))
    except (OSError, ValueError):
        return _check("receive buffer", "not reported by this system")
    found = f"{key} is {most}; two sensors in dual return fill {needed} in {_PAUSE_S:g} s"
    mend = f"sudo sysctl -w {key}={needed}, and SO_RCVBUF in the receiver"
    # Linux doubles the value of SO_RCVBUF (socket(7)).
    return _check("receive buffer", found, mend if 2 * most < needed else "")


def _kernels() -> Check:
    folder = user_kernels().usable_folder
    names = kernel_names()
    if any(name.startswith(_CASTER) for name in names):
        return _check("kernel cache", f"{len(names)} kernels in {folder or 'the package alone'}")
    if folder is None:
        mend = "export NUMBA_CACHE_DIR=FOLDER, where nobody else can write"
        return _check("kernel cache", "no safe folder: each run compiles for a minute", mend)
    lacking = f"{folder} lacks kernels for ray casting: the next run compiles them first"
    return _check("kernel cache", lacking, "vlp16emu cache --compile")


def _embree() -> Check:
    from vlp16emu.raycast.embree import device

    try:
        device()
    except (Vlp16emuError, ImportError, OSError) as error:
        return Check("Embree", Condition.PROBLEM, str(error), "pip install --force-reinstall embreex")
    flags = set[str]()
    with suppress(OSError):
        flags = set(Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace").split())
    return _check("Embree", f"loads; {next((name for name in _WIDEST if name in flags), platform.machine())}")


def _disk() -> Check:
    store = user_store()
    if store.folder is None:
        return _check("world cache", "off: each run grows its world", "unset VLP16EMU_CACHE_DIR")
    there = next(folder for folder in (store.folder, *store.folder.parents) if folder.is_dir())
    if not os.access(there, os.W_OK):
        mend = f"export VLP16EMU_CACHE_DIR={tempfile.gettempdir()}/vlp16emu-worlds"
        return _check("world cache", f"{there} cannot be written", mend)
    free = shutil.disk_usage(there).free
    found = f"{free / 1e9:.1f} GB free for at most {store.most_bytes / 1e9:.1f} GB in {store.folder}"
    mend = "export VLP16EMU_CACHE_MB=100, or another VLP16EMU_CACHE_DIR"
    return _check("world cache", found, mend if free < store.most_bytes else "")
