"""Where compiled kernels are kept.

Numba looks for changes in the file of a kernel only, not in those of the kernels that it calls. So what is kept belongs
to one state of all files that kernels are made of: its folder is named by their times and sizes.
"""

# pathlib takes as long to load as all else of the package's start.
# ruff: noqa: PTH103, PTH116, PTH118, PTH120, PTH208
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

__all__ = ["compiled_files", "keep_compiled"]

_PACKAGE = os.path.dirname(__file__)
_PREFIX = "kernels-"
_WITHOUT_KERNELS = frozenset(
    [
        "__init__",
        "__main__",
        "__pycache__",
        "chain",
        "cli",
        "compiled",
        "device",
        "emulator",
        "output",
        "points",
        "recording",
        "report",
        "scan",
        "scenario",
        "sinks",
        "streaming",
        "truth",
        "verify",
    ]
)
"""Folders and modules of no kernel, and of nothing that a kernel takes."""
_UNUSED_S = 86_400.0
"""Folders of other states are removed after a day."""


def keep_compiled() -> None:
    """Set where numba keeps what it compiles, before any kernel is imported.

    In `NUMBA_CACHE_DIR`, or beside the package; where that cannot be written in the user's cache, or in a folder of
    the user's own for temporary files.
    """
    name = _PREFIX + _state()
    for base in _bases():
        folder = os.path.join(base, name)
        try:
            os.makedirs(folder, mode=0o700, exist_ok=True)
            # Whoever can write there can have us run what he likes.
            if os.stat(folder).st_uid != os.getuid() or not os.access(folder, os.W_OK):
                continue
            os.utime(folder)
        except OSError:
            continue
        _remove_unused(base)
        os.environ["NUMBA_CACHE_DIR"] = folder
        if "numba" in sys.modules:  # it has looked at the environment already
            sys.modules["numba"].config.CACHE_DIR = folder
        return


def compiled_files() -> "dict[Path, list[Path]]":
    """List what numba keeps in folders of ours, of any state of the package, by folder."""
    from pathlib import Path  # here: it takes as long to load as all else of the package's start

    found = {}
    for base in map(Path, dict.fromkeys(_bases())):
        for folder in base.glob(_PREFIX + "*"):
            with suppress(OSError):
                state = folder.lstat()
                if (
                    re.fullmatch(_PREFIX + "[0-9a-f]{16}", folder.name)
                    and stat.S_ISDIR(state.st_mode)
                    and state.st_uid == os.getuid()
                ):
                    found[folder] = [
                        path
                        for end in ("nbi", "nbc")
                        for path in folder.glob(f"*/*.{end}")
                        if not path.is_symlink()
                    ]
    return found


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
        above, name = os.path.split(chosen)  # a program that called us may have set it in this manner
        bases.insert(0, above if name.startswith(_PREFIX) else chosen)
    return bases


def _remove_unused(base: str) -> None:
    """Remove folders of other states that nobody has used for long."""
    for name in os.listdir(base):
        folder = os.path.join(base, name)
        with suppress(OSError):
            if name.startswith(_PREFIX) and time.time() - os.stat(folder).st_mtime > _UNUSED_S:
                from shutil import rmtree

                rmtree(folder)
