"""Walks made by the workers of a Dask scheduler, on any number of machines.

Dask sends walks to workers, and sends the walk of a worker that dies to another one. This process opens no
port: it connects to the scheduler, through which everything goes. A worker that finds the mark that this
process puts into the folder of the dataset writes there; files of other workers are fetched in pieces.
"""

import hashlib
import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from platform import node, python_version_tuple
from shutil import rmtree
from typing import TYPE_CHECKING, Any

from vlp16emu.errors import InputError, RunError
from vlp16emu.extras.dataset.manifest import Entry, identity, is_list_of_files, read_list, write_list
from vlp16emu.extras.dataset.parts import is_marked
from vlp16emu.extras.dataset.processes import MOST_DEATHS, died_too_often
from vlp16emu.extras.dataset.spec import DatasetWalk
from vlp16emu.extras.dataset.walk import Made, forget_worlds, make_walk
from vlp16emu.inputs import parse_json, read_text
from vlp16emu.libraries import of_extra
from vlp16emu.trees import Table

if TYPE_CHECKING:
    from distributed import Client, Future, Worker

_EXPECTED = "tcp://HOST:PORT of a Dask scheduler, or its scheduler file"
_REACHED_WITHIN_S = 10.0
_FIRST_WORKER_WITHIN_S = 60.0
_MOST_AT_ONCE = 1_000  # walks that the scheduler knows at a time
_PIECE_BYTES = 8_000_000  # of a file that is fetched; larger pieces are not faster (tools/results/dataset.md)

_MadeBy = tuple[str | None, Path, Entry]
"""Address of the worker that has the folder, None for one inside the dataset; the folder; entry of the
walk."""


@dataclass(frozen=True, slots=True)
class Cluster:
    """Workers of a Dask scheduler, all with this version of vlp16emu."""

    address: str
    client: "Client"

    @property
    def threads(self) -> int:
        """Number of walks that its workers make at a time."""
        with self._lost_on_error():
            threads: int = sum(self.client.nthreads().values())
        return threads

    def make(self, walks: Sequence[DatasetWalk], parts: Path) -> Iterator[Made]:
        """Make walks, and yield each when its folder is complete inside `parts`.

        Raises RunError if the scheduler is lost, if workers die too often over one walk, or if files that are
        fetched cannot be written; and the errors of `make_walk`.
        """
        from distributed import as_completed

        scratch = f"vlp16emu-{hashlib.sha256(f'{node()}:{parts.parent}'.encode()).hexdigest()[:16]}"
        left = iter(walks)
        tries = dict[str, tuple[DatasetWalk, int]]()

        def submit(walk: DatasetWalk, number: int = 1) -> "Future":
            """Submit a walk for the first, second ... time."""
            # Dask's dashboard shows the part of a key before the first dash.
            key = f"vlp16emu_walk-{parts.name}-{walk.number}-{number}"
            tries[key] = walk, number
            return self.client.submit(_make_on_worker, walk, parts, scratch, key=key, pure=False)

        with self._lost_on_error():
            self.client.run(_clear, scratch)  # files of an earlier run that was killed
            futures = as_completed(map(submit, islice(left, _MOST_AT_ONCE)), loop=self.client.loop)
            for future in futures:
                walk, number = tries.pop(future.key)
                place, source, entry = self._result(future, walk)
                folder = parts / source.name if place is None else self._fetch(place, source, entry, parts)
                if folder is not None:
                    yield walk, folder, entry
                    futures.update(map(submit, islice(left, 1)))
                elif number < MOST_DEATHS:
                    futures.add(submit(walk, number + 1))
                else:
                    raise RunError(died_too_often(walk))
            self.client.run(_clear, scratch)

    @contextmanager
    def _lost_on_error(self) -> Iterator[None]:
        """Raise RunError if the connection to the scheduler is lost within the block."""
        try:
            yield
        except (CancelledError, OSError):
            raise RunError(f"{self.address}: the scheduler is lost; what is made so far is kept") from None

    def _result(self, future: "Future", walk: DatasetWalk) -> _MadeBy:
        """Return what a worker has made; RunError if it is not that walk, or workers die over it."""
        from distributed import KilledWorker

        try:
            made: _MadeBy = future.result()
        except KilledWorker:
            raise RunError(died_too_often(walk)) from None
        except ImportError as error:  # workers that came later
            raise RunError(f"walk {walk.name}: a worker has no {error.name}") from None
        _, _, entry = made
        if not (entry.items() >= identity(walk).items() and is_list_of_files(entry["files"])):
            raise RunError(f"walk {walk.name}: a worker has made another one, with {entry['written_by']}")
        return made

    def _fetch(self, place: str, source: Path, entry: Entry, parts: Path) -> Path | None:
        """Copy the files of a walk from a worker into a folder inside `parts`; None if the worker is gone."""
        folder = parts / source.name
        pieces = self._pieces(place, source)
        held = memoryview(b"")
        try:
            folder.mkdir()
            for file in entry["files"]:
                path = folder / file["path"]
                path.parent.mkdir(parents=True, exist_ok=True)
                digest = hashlib.sha256()
                with path.open("wb") as opened:
                    left = file["bytes"]
                    while left and (held := held or memoryview(next(pieces, b""))):
                        taken = held[:left]
                        digest.update(taken)
                        left -= opened.write(taken)
                        held = held[len(taken) :]
                if digest.hexdigest() != file["sha256"]:
                    rmtree(folder)
                    return None
            write_list(folder, entry)
        except OSError as error:
            where = error.filename or folder
            raise RunError(f"{where}: {error.strerror}; what is made so far is kept") from None
        self._call(place, rmtree, source)
        return folder

    def _pieces(self, place: str, source: Path) -> Iterator[bytes]:
        """Yield the content of all files of a walk, one after the other, until the worker is gone."""
        begin = 0
        while piece := self._call(place, _read_piece, source, begin):
            yield piece
            begin += len(piece)

    def _call(self, place: str, function: Callable[..., Any], *arguments: object) -> Any:
        """Call a function in a worker, beside its walks; None if the worker or the file is gone."""
        with self._lost_on_error():
            if place not in self.client.nthreads():
                return None
        with suppress(OSError):
            return self.client.run(function, *arguments, workers=[place]).get(place)
        return None


@contextmanager
def connect(scheduler: str) -> Iterator[Cluster]:
    """Connect to a Dask scheduler, given by its address or scheduler file.

    Raises MissingExtraError without Dask; InputError if no scheduler answers, it has no workers, or one of
    them has no vlp16emu or Python of this version.
    """
    with of_extra("cluster", "a dataset made by Dask"):
        import dask

        dask.config.set({"logging.distributed": "critical"})  # read when distributed is imported
        from distributed import Client
        from distributed.versions import VersionMismatchWarning
    address = _address(scheduler)
    _reach(address)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", VersionMismatchWarning)  # a table; see `check_versions`
        try:
            client = Client(address, timeout=_REACHED_WITHIN_S, set_as_default=False)
        except Exception as error:  # noqa: BLE001  # whatever a server of another kind or version answers
            raise InputError(address, f"no Dask scheduler answers ({error})", _EXPECTED) from None
        with client:
            try:
                client.wait_for_workers(1, timeout=_FIRST_WORKER_WITHIN_S)
            except TimeoutError:
                found = f"has no workers after {_FIRST_WORKER_WITHIN_S:.0f} s"
                raise InputError(address, found, f"at least one: `dask worker {address}`") from None
            check_versions(address, client.get_versions(packages=["vlp16emu"]))
            yield Cluster(address, client)


def check_versions(address: str, versions: Table) -> None:
    """Raise InputError if scheduler or workers have no vlp16emu or Python of this version.

    Parameters
    ----------
    address : of the scheduler
    versions : result of `distributed.Client.get_versions` with the package vlp16emu
    """
    major, minor, _ = python_version_tuple()
    here = version("vlp16emu"), f"{major}.{minor}"
    places = {"the scheduler": versions["scheduler"]}
    places |= {f"worker {worker}": installed for worker, installed in versions["workers"].items()}
    others = list[str]()
    for place, installed in places.items():
        package = installed["packages"]["vlp16emu"]
        python = ".".join(installed["host"]["python"].split(".")[:2])
        if (package, python) != here:
            found = f"vlp16emu {package}" if package else "no vlp16emu"
            others.append(f"{place} has {found} on Python {python}")
    if others:
        more = f" (and {len(others) - 1} more)" if others[1:] else ""
        raise InputError(address, f"{others[0]}{more}", f"vlp16emu {here[0]} on Python {here[1]}, as here")


def _address(scheduler: str) -> str:
    """Return the address of a scheduler; from its file if `scheduler` is no address."""
    from distributed.comm import parse_host_port

    path = Path(scheduler)
    if not scheduler or "://" in scheduler or not os.path.lexists(path):
        address = scheduler
    else:
        text = read_text(path, "a scheduler file", InputError)
        try:
            address = str(parse_json(text)["address"])
        except (ValueError, KeyError, TypeError):
            raise InputError(scheduler, "is no scheduler file", _EXPECTED) from None
    try:
        host, _ = parse_host_port(address.partition("://")[2] or address)
    except ValueError:
        host = ""
    if not host:
        raise InputError("scheduler", f"found {scheduler!r}", _EXPECTED)
    return address


def _reach(address: str) -> None:
    """Raise InputError if nothing answers at an address.

    A `Client` that cannot connect prints a traceback when it is collected.
    """
    from distributed import Security
    from distributed.comm import connect as connect_comm
    from distributed.utils import LoopRunner

    async def reach() -> None:
        arguments = Security().get_connection_args("client")
        comm = await connect_comm(address, timeout=_REACHED_WITHIN_S, **arguments)
        await comm.close()

    try:
        LoopRunner(asynchronous=False).run_sync(reach)
    except (OSError, ValueError, RuntimeError, ImportError) as error:
        raise InputError(address, f"no Dask scheduler answers ({error})", _EXPECTED) from None


def _make_on_worker(walk: DatasetWalk, parts: Path, scratch: str) -> _MadeBy:
    """Make a walk in the folder of the dataset if this worker sees it, else in a folder of its own."""
    from distributed import get_worker

    worker = get_worker()
    if is_marked(parts):
        _, folder, entry = make_walk(walk, parts, threads=1)
        return None, folder, entry
    place = Path(worker.local_directory) / scratch
    try:
        place.mkdir(exist_ok=True)
    except OSError as error:
        raise RunError(f"{worker.address}: {place}: {error.strerror}; what is made so far is kept") from None
    _, folder, entry = make_walk(walk, place, threads=1)
    return worker.address, folder, entry


def _read_piece(folder: Path, begin: int) -> bytes:
    """Return a piece of the files of a walk, joined in the order of its list, that starts at a byte."""
    piece = bytearray()
    for file in read_list(folder)["files"]:
        if len(piece) < _PIECE_BYTES and begin < file["bytes"]:
            with (folder / file["path"]).open("rb") as opened:
                opened.seek(begin)
                piece += opened.read(_PIECE_BYTES - len(piece))
        begin = max(begin - file["bytes"], 0)
    return bytes(piece)


def _clear(scratch: str, dask_worker: "Worker") -> None:
    """Remove what a worker keeps of a dataset: its files, and the world of the latest walk."""
    rmtree(Path(dask_worker.local_directory) / scratch, ignore_errors=True)
    forget_worlds()
