"""Files of users that compiled libraries read, in a child process of bounded memory.

Such a library may end its process in place of raising an exception: by a Rust panic, or an abort of C++.
"""

import json
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from math import prod
from pathlib import Path
from threading import Thread
from typing import IO

import numpy as np

from vlp16emu.errors import InputError
from vlp16emu.inputs import LARGEST_BYTES, readable
from vlp16emu.types import AnyArray

Arrays = Mapping[str, AnyArray]
MOST_MEMORY_BYTES = 8_000_000_000  # of addresses: a LAZ of 1 GB has some 150 million points
_LEAST_CPU_S = 30
_BYTES_PER_S = 1_000_000
"""Time for a file: a LAZ is unpacked ten times as fast on one core of 2020."""
_LONGEST_HEAD = 1_000_000


def read_in_child(
    read: Callable[[Path], Arrays], path: Path, expected: str, error: type[InputError]
) -> dict[str, AnyArray]:
    """Read a file of a user by a compiled library, whatever the file does to it.

    Parameters
    ----------
    read : function of a module that returns arrays of numbers by name; what it raises is an error of the file
    path : a regular file of at most `LARGEST_BYTES`
    expected : description of the file, for messages
    error : class of error for a file that cannot be read
    """
    # -P: no module of the current folder. A session of its own: Ctrl-C is for the parent.
    command = [sys.executable, "-P", "-m", __name__, f"{read.__module__}:{read.__qualname__}", str(path)]
    with readable(path, expected, error, most_bytes=LARGEST_BYTES):
        child = subprocess.Popen(  # noqa: S603  # a module of ours
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        )
        with child:
            try:
                assert child.stdout is not None
                return _received(child.stdout)
            except EOFError:
                raise error(str(path), f"cannot be read: {_end_of(child.wait())}", expected) from None
            finally:
                child.kill()  # it has nothing to finish, and may hang


def _end_of(code: int) -> str:
    """Return how a child ended that sent no result, by its exit code."""
    if code == -signal.SIGXCPU:
        return "its reader comes to no end"
    return f"its reader ended {f'by {signal.Signals(-code).name}' if code < 0 else f'with {code}'}"


def _received(file: IO[bytes]) -> dict[str, AnyArray]:
    """Return the arrays that a child sends; ValueError with its reason, EOFError if it ends before."""
    line = file.readline(_LONGEST_HEAD)
    if not line.endswith(b"\n"):
        raise EOFError
    head = json.loads(line)
    if "error" in head:
        raise ValueError(head["error"])
    arrays = dict[str, AnyArray]()
    for name, kind, shape in head["arrays"]:
        dtype = np.dtype(kind)
        content = file.read(dtype.itemsize * prod(shape))
        if len(content) < dtype.itemsize * prod(shape):
            raise EOFError
        arrays[name] = np.frombuffer(content, dtype).reshape(shape)
    return arrays


def _send(arrays: Arrays, file: IO[bytes]) -> None:
    kept = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    head = [[name, array.dtype.str, array.shape] for name, array in kept.items()]
    file.write(json.dumps({"arrays": head}).encode() + b"\n")
    for array in kept.values():
        file.write(array.data)
    file.flush()


def _end_with_parent() -> None:
    sys.stdin.buffer.read()  # until the parent is gone
    os._exit(1)


def main(reader: str, path: str) -> None:
    """Read a file in this process, and send the arrays to the parent."""
    Thread(target=_end_with_parent, daemon=True).start()
    resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY_BYTES, MOST_MEMORY_BYTES))
    seconds = _LEAST_CPU_S + Path(path).stat().st_size // _BYTES_PER_S
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    module, _, name = reader.partition(":")
    out = sys.stdout.buffer
    try:
        arrays = getattr(import_module(module), name)(Path(path))
    except MemoryError:
        out.write(json.dumps({"error": "needs more memory than its reader may have"}).encode() + b"\n")
    except BaseException as fault:  # noqa: BLE001  # a Rust panic is no `Exception`
        reason = next(iter(str(fault).splitlines()), "") or type(fault).__name__
        out.write(json.dumps({"error": reason}).encode() + b"\n")
    else:
        _send(arrays, out)


if __name__ == "__main__":
    main(*sys.argv[1:])
