"""Where compiled kernels are kept.

Numba looks for changes in the file of a kernel only, not in those of the kernels that it calls. So what is kept belongs
to one state of all files that kernels are made of: its folder is named by their times and sizes.
"""

# pathlib takes as long to load as all else of the package's start.
# ruff: noqa: PTH100, PTH102, PTH103, PTH106, PTH108, PTH112, PTH113, PTH114, PTH116, PTH118, PTH120, PTH123, PTH208
import hashlib
import os
import re
import stat
import sys
import time
from contextlib import suppress

TYPE_CHECKING = False
if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["compiled_files", "keep_compiled", "remove_compiled"]

_PACKAGE = os.path.dirname(__file__)
_PREFIX = "kernels-"
_NAME = re.compile(_PREFIX + "[0-9a-f]{16}")
_MARKER = "made-by-vlp16emu"
"""Empty file in each folder of ours: others may keep something under such a name."""
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
_WITHOUT_KERNELS = frozenset(
    [
        "__init__",
        "__main__",
        "__pycache__",
        "bag",
        "chain",
        "cli",
        "compare",
        "compiled",
        "control",
        "dataset",
        "deskew",
        "device",
        "emulator",
        "flight",
        "gps_time",
        "images",
        "labels",
        "output",
        "points",
        "recording",
        "replay",
        "report",
        "run",
        "scan",
        "scenario",
        "score",
        "sinks",
        "streaming",
        "streams",
        "truth",
        "validator",
    ]
)
"""Folders and modules of no kernel, and of nothing that a kernel takes."""
_UNUSED_S = 86_400.0
"""Folders of other states are removed after a day."""


def keep_compiled() -> None:
    """Set where numba keeps what it compiles, before any kernel is imported.

    In `NUMBA_CACHE_DIR`, or beside the package; else in the user's cache, or in a folder of the user's own for temporary
    files. What was compiled is code that is run unread: a folder is taken only if nobody else can write in it. Where
    there is none, kernels are kept in a new private folder until the program ends.
    """
    name = _PREFIX + _state()
    folder = next(filter(_is_private, (os.path.join(base, name) for base in _bases())), None)
    if folder is None:
        folder = os.path.join(_for_this_run(), name)
        _is_private(folder)
    _remove_unused(os.path.dirname(folder), folder)
    os.environ["NUMBA_CACHE_DIR"] = folder
    if "numba" in sys.modules:  # it has looked at the environment already
        sys.modules["numba"].config.CACHE_DIR = folder


def compiled_files() -> "dict[Path, list[Path]]":
    """List what numba keeps in folders of ours, of any state of the package, by folder."""
    from pathlib import Path  # here: it takes as long to load as all else of the package's start

    return {
        Path(folder): list(map(Path, _files_in(folder))) for base in _bases() for folder in _folders_in(base)
    }


def remove_compiled(folder: "str | Path") -> None:
    """Remove what numba keeps in a folder of ours, and the folder if nothing else is in it."""
    for path in _files_in(folder):
        with suppress(OSError):
            os.unlink(path)
    rooms = [room.path for room in os.scandir(folder) if room.is_dir(follow_symlinks=False)]
    for room in rooms:
        with suppress(OSError):  # where something else is in it
            os.rmdir(room)
    if os.listdir(folder) == [_MARKER]:
        os.unlink(os.path.join(folder, _MARKER))
        os.rmdir(folder)


def _is_private(folder: str) -> bool:
    """Whether a folder of ours is there or could be made, where nobody else can write in it or put another in its place."""
    base = os.path.dirname(folder)
    try:
        os.makedirs(os.path.dirname(base), mode=0o700, exist_ok=True)
        above = os.stat(os.path.dirname(base)).st_mode
        if above & _OTHERS_WRITE and not above & stat.S_ISVTX:
            return False
        for level in (base, folder):
            with suppress(FileExistsError):
                os.mkdir(level, mode=0o700)
            state = os.lstat(level)
            if (
                not stat.S_ISDIR(state.st_mode)
                or state.st_uid != os.getuid()
                or state.st_mode & _OTHERS_WRITE
            ):
                return False
        if not os.access(folder, os.W_OK):
            return False
        with open(os.path.join(folder, _MARKER), "ab"):
            os.utime(folder)
    except OSError:
        return False
    return True


def _for_this_run() -> str:
    """Make a folder that goes when this program ends."""
    import atexit
    from shutil import rmtree
    from tempfile import mkdtemp

    folder, made_by = mkdtemp(prefix="vlp16emu-"), os.getpid()

    def remove() -> None:
        """Remove it, unless this is a fork."""
        if os.getpid() == made_by:
            rmtree(folder, ignore_errors=True)

    atexit.register(remove)
    return folder


def _folders_in(base: str) -> list[str]:
    """Folders of ours below a base, known by their names and by what marks them."""
    names = os.listdir(base) if os.path.isdir(base) else []
    folders = [os.path.join(base, name) for name in names if _NAME.fullmatch(name)]
    return [
        folder
        for folder in folders
        if not os.path.islink(folder)
        and os.path.isfile(os.path.join(folder, _MARKER))
        and os.stat(folder).st_uid == os.getuid()
    ]


def _files_in(folder: "str | Path") -> list[str]:
    """Files of numba in a folder of ours."""
    rooms = [room for room in os.scandir(folder) if room.is_dir(follow_symlinks=False)]
    files = [file for room in rooms for file in os.scandir(room)]
    return [
        file.path
        for file in files
        if file.name.endswith((".nbi", ".nbc")) and file.is_file(follow_symlinks=False)
    ]


def _state() -> str:
    """Name the state of the files that kernels are made of."""
    states = []
    for folder, rooms, files in os.walk(_PACKAGE):  # twice as quick as globs, at each start
        rooms[:] = [room for room in rooms if room not in _WITHOUT_KERNELS]
        if folder == _PACKAGE:
            files[:] = [file for file in files if file.removesuffix(".py") not in _WITHOUT_KERNELS]
        for path in (os.path.join(folder, file) for file in files if file.endswith(".py")):
            state = os.stat(path)
            states.append(f"{path} {state.st_mtime_ns} {state.st_size}\n")
    return hashlib.sha256("".join(sorted(states)).encode()).hexdigest()[:16]


def _bases() -> list[str]:
    """Folders to try, best first."""
    bases = [os.path.join(_PACKAGE, "__pycache__")]
    if cache := os.environ.get("XDG_CACHE_HOME"):
        bases.append(os.path.join(cache, "vlp16emu"))
    elif home := os.environ.get("HOME"):
        bases.append(os.path.join(home, ".cache", "vlp16emu"))
    temporary = os.environ.get("TMPDIR", "/tmp")  # noqa: S108 - checked to be our own
    bases.append(os.path.join(temporary, f"vlp16emu-{os.getuid()}"))
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        above, name = os.path.split(os.path.abspath(chosen))
        bases.insert(
            0, above if _NAME.fullmatch(name) else chosen
        )  # a program that called us may have set it
    return list(dict.fromkeys(map(os.path.abspath, bases)))


def _remove_unused(base: str, used: str) -> None:
    """Remove folders of other states that nobody has used for long."""
    with suppress(OSError):
        for folder in _folders_in(base):
            if folder != used and time.time() - os.stat(folder).st_mtime > _UNUSED_S:
                remove_compiled(folder)
