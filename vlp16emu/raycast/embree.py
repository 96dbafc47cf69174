"""Binding to the Embree library inside the embreex wheel.

`embreex` itself has no instances, quads or ray packets; the complete Embree 4 library in
its wheel has all three. Constants and signatures: Embree 4.4, `rtcore_*.h`.
"""

import ctypes
import os
import sys
import threading
from ctypes import c_char_p, c_int, c_size_t, c_uint, c_void_p
from functools import cache
from importlib import metadata
from pathlib import Path

from vlp16emu.errors import RunError, Vlp16emuError

GEOMETRY_TRIANGLE = 0
GEOMETRY_INSTANCE = 121
BUFFER_INDEX = 0
BUFFER_VERTEX = 1
FORMAT_UINT3 = 0x5003
FORMAT_FLOAT3 = 0x9003
FORMAT_FLOAT3X4_ROW_MAJOR = 0x9134
SCENE_FLAGS = 1 << 2 | 1 << 3
"""Scene flags: robust, so that no box is missed by rounding, and with the filter of a query's arguments."""
FLAG_COHERENT = 1 << 16
"""Coherent rays: nearly doubles the speed for neighbouring azimuths of one laser."""
FLAG_FILTER = 1 << 1  # the filter of a query's arguments is called for each candidate of any geometry

_SIGNATURES: dict[str, tuple[object, list[object]]] = {
    "rtcNewDevice": (c_void_p, [c_char_p]),
    "rtcGetDeviceError": (c_int, [c_void_p]),
    "rtcNewScene": (c_void_p, [c_void_p]),
    "rtcSetSceneFlags": (None, [c_void_p, c_int]),
    "rtcCommitScene": (None, [c_void_p]),
    "rtcReleaseScene": (None, [c_void_p]),
    "rtcNewGeometry": (c_void_p, [c_void_p, c_int]),
    "rtcCommitGeometry": (None, [c_void_p]),
    "rtcReleaseGeometry": (None, [c_void_p]),
    "rtcAttachGeometryByID": (None, [c_void_p, c_void_p, c_uint]),
    "rtcSetSharedGeometryBuffer": (
        None,
        [c_void_p, c_int, c_uint, c_int, c_void_p, c_size_t, c_size_t, c_size_t],
    ),
    "rtcSetGeometryInstancedScene": (None, [c_void_p, c_void_p]),
    "rtcSetGeometryTimeStepCount": (None, [c_void_p, c_uint]),
    "rtcSetGeometryTransform": (None, [c_void_p, c_uint, c_int, c_void_p]),
    "rtcIntersect8": (None, [c_void_p, c_void_p, c_void_p, c_void_p]),
}

_MMAP_THRESHOLD = -3
_LARGE_BYTES = 1 << 22
"""Parameter of glibc's `mallopt`, and its value: larger arrays have pages of their own, huge ones, as numpy
asks for from this size on. By default the limit grows to 32 MB, and arrays of that size leave holes: a tenth
of the memory of a recording of `scenes/reference_forest`."""

_MAKING = threading.Lock()
_ERRORS = {
    1: "unknown error",
    2: "invalid argument",
    3: "invalid operation",
    4: "out of memory",
    5: "unsupported CPU",
}


class EmbreeMissingError(Vlp16emuError):
    """The Embree library is missing in the embreex wheel, or lacks a function."""


def library_path() -> Path:
    """Return the path of the library in the wheel.

    Raises EmbreeMissingError if embreex is not installed or has no such file.
    """
    try:
        files = metadata.files("embreex") or []
    except metadata.PackageNotFoundError:
        raise EmbreeMissingError("embreex is not installed") from None
    for file in files:
        if file.name.startswith(("libembree4", "embree4.dll")):
            return Path(str(file.locate()))
    raise EmbreeMissingError("embreex carries no Embree 4 library")


@cache
def library() -> ctypes.CDLL:
    """Load the library once, for kernels too, and declare its functions.

    Raises EmbreeMissingError if it cannot be loaded or a function is missing.
    """
    import embreex.rtcore_scene  # noqa: F401  # loads the libraries that Embree itself needs
    from llvmlite import binding

    path = library_path()
    give_memory_back()
    try:
        lib = ctypes.CDLL(str(path))
        for name, (result, arguments) in _SIGNATURES.items():
            function = getattr(lib, name)
            function.restype = result
            function.argtypes = arguments
        binding.load_library_permanently(str(path))
    except (OSError, RuntimeError, AttributeError) as error:
        raise EmbreeMissingError(f"{path.name}: {error}") from None
    return lib


def device() -> int:
    """Return the only device of the process; with a second one Embree would keep a thread busy for ever.

    Raises RunError if Embree gives none.
    """
    with _MAKING:  # the cache alone would let two threads each make one
        return _new_device()


@cache
def _new_device() -> int:
    """Make a device; tests extend its configuration with `VLP16EMU_EMBREE`: `isa=sse4.2`, `verbose=1`."""
    # One thread per build: our own workers build shapes in parallel.
    settings = ("threads=1", "set_affinity=0", os.environ.get("VLP16EMU_EMBREE", ""))
    handle: int | None = library().rtcNewDevice(",".join(filter(None, settings)).encode())
    if handle is None:
        raise RunError(f"Embree gave no device: {_meaning(library().rtcGetDeviceError(None))}")
    return handle


def give_memory_back() -> None:
    """Return freed memory to the system, from now on that of large arrays at once.

    It has an effect if the allocator is glibc, whose fragmentation would grow for ever.
    """
    if sys.platform == "linux" and hasattr(libc := ctypes.CDLL(None), "malloc_trim"):
        libc.mallopt(_MMAP_THRESHOLD, _LARGE_BYTES)
        libc.malloc_trim(0)


def check(doing: str) -> None:
    """Raise `RunError` if Embree, which reports errors per thread, has failed on this thread."""
    if error := library().rtcGetDeviceError(device()):
        raise RunError(f"Embree could not {doing}: {_meaning(error)}")


def _meaning(error: int) -> str:
    return _ERRORS.get(error, f"error {error}")
