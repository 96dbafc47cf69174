"""A dataset from its walks to its manifest: missing walks are made by this process or by others of this machine."""

import hashlib
import multiprocessing
import os
import signal
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from shutil import rmtree
from threading import Thread
from typing import Any

import numpy as np

from vlp16emu.emulator import Emulator
from vlp16emu.engine import in_one_world
from vlp16emu.errors import OutputError, RunError
from vlp16emu.extras.clouds.labels import label_scheme
from vlp16emu.extras.clouds.points import write_points
from vlp16emu.extras.dataset.folders import (
    PARTS,
    Entry,
    check_manifest,
    finished,
    list_files,
    take_place,
    write_manifest,
)
from vlp16emu.extras.dataset.spec import DatasetWalk
from vlp16emu.extras.options import DatasetOptions
from vlp16emu.output import lock
from vlp16emu.scan import Scan
from vlp16emu.types import F8, U4
from vlp16emu.units import S_NS

_MOST_INSTANCES = 0xFFFF  # the upper 16 bits of a label hold the instance (SemanticKITTI, "Data")
_IDENTITY = " ".join(f"{value:g}" for value in np.eye(3, 4).ravel())


def _semantic_kitti(emulator: Emulator, folder: Path) -> None:
    """Write a sequence: one scan per revolution, each deskewed to the pose of its first pulse.

    Poses are those of the sensor in the world of the scene; camera and lidar coincide, so `calib.txt` holds identities.
    Instances are numbered from 1 in the order in which the sequence first sees them.
    """
    for name in ("velodyne", "labels"):
        (folder / name).mkdir()
    scheme = label_scheme("semantickitti")
    known, poses, starts_ns = dict[int, int](), list[str](), list[int]()
    for number, scan in enumerate(emulator.scans(truth=True)):
        assert scan.labels is not None
        assert scan.world_T_sensor is not None
        rows = np.column_stack([_deskewed(emulator, scan), scan.reflectivity / 255]).astype("<f4")
        (folder / "velodyne" / f"{number:06d}.bin").write_bytes(rows.tobytes())
        classes = scheme.codes(scan.labels.semantic, scan.labels.part).astype("<u4")
        labels = classes | _numbers(scan.labels.instance, known) << np.uint32(16)
        (folder / "labels" / f"{number:06d}.label").write_bytes(labels.astype("<u4").tobytes())
        poses.append(" ".join(f"{value:.9e}" for value in scan.world_T_sensor[:3].ravel()))
        starts_ns.append(scan.start_ns)
    times = [f"{(start_ns - starts_ns[0]) / S_NS:.9f}" for start_ns in starts_ns]
    calibration = [f"{name}: {_IDENTITY}" for name in ("P0", "P1", "P2", "P3", "Tr")]
    for name, lines in (("poses.txt", poses), ("times.txt", times), ("calib.txt", calibration)):
        (folder / name).write_text("".join(f"{line}\n" for line in lines), encoding="ascii")


def _deskewed(emulator: Emulator, scan: Scan) -> F8:
    """Return points (n, 3) of a scan in the sensor's frame at the scan's first pulse."""
    assert scan.world_T_sensor is not None
    pulse = emulator.world_T_sensor(scan.t_ns)
    first = scan.world_T_sensor
    world_m = np.einsum("nij,nj->ni", pulse[:, :3, :3], scan.xyz_m) + (pulse[:, :3, 3] - first[:3, 3])
    return np.asarray(world_m @ first[:3, :3])


def _numbers(instances: U4, known: dict[int, int]) -> U4:
    """Return numbers (n,) of instances; new ones become known."""
    own, index = np.unique(instances, return_inverse=True)
    for instance in own[own > 0].tolist():
        known.setdefault(instance, len(known) + 1)
    if len(known) > _MOST_INSTANCES:
        raise RunError(f"more than {_MOST_INSTANCES} instances in one sequence, which its labels cannot hold")
    return np.array([known.get(instance, 0) for instance in own.tolist()], np.uint32)[index]


LAYOUTS: dict[str, Callable[[Emulator, Path], object]] = {
    "semantickitti": _semantic_kitti,
    "pcap+truth": lambda emulator, folder: emulator.record(folder / "walk.pcap", truth=folder / "truth"),
    "las-plots": lambda emulator, folder: write_points(emulator, folder / "points.laz", truth=True),
}
"""Writers of a walk into an empty folder, by the layout's name in the file of a dataset."""


_DEATHS = 10  # deaths of workers, without a finished walk between them, that end a run: then a walk kills them

Made = tuple[DatasetWalk, Path, Entry]
"""A walk, the folder with its files, and its entry in the manifest."""


@dataclass(frozen=True, slots=True)
class DatasetResult:
    """Result of a run."""

    manifest: str
    sha256: str  # of the manifest
    walks: int
    made: int  # walks that were not there before
    bytes: int  # size of all files of all walks


def make_dataset(
    walks: Sequence[DatasetWalk], out: Path, *, progress: Callable[[float], None] = lambda _: None, **options: Any
) -> DatasetResult:
    """Make the walks of a dataset that are not there yet, and its manifest.

    A walk is there if its folder lists it, and its files have the sizes and sha256 of that list.

    Parameters
    ----------
    out : folder, new or of an earlier run
    progress : called with the simulated seconds so far, walk by walk
    options : fields of `DatasetOptions`

    Raises OutputError if the folder cannot be written, another run writes it, or a file that is not listed is in the
    place of a walk; RunError if a walk fails, or workers die over one walk again and again.
    """
    out, asked = out.absolute(), DatasetOptions(**options)
    walks = walks[slice(*(asked.share or (None,)))]
    path, parts = out / "manifest{}.json".format(".{}-{}".format(*asked.share) if asked.share else ""), out / PARTS
    with _locked(out):
        check_manifest(path)
        entries = {walk.number: entry for walk in walks if (entry := finished(out, walk))}
        missing = [walk for walk in walks if walk.number not in entries]
        done_s = sum(walk.scenario.duration_s for walk in walks if walk.number in entries)
        progress(done_s)
        try:
            rmtree(parts, ignore_errors=True)
            parts.mkdir()
            for walk, made, entry in _made(missing, parts, asked.workers):
                take_place(made, out / walk.folder)
                entries[walk.number] = entry
                progress(done_s := done_s + walk.scenario.duration_s)
        finally:
            rmtree(parts, ignore_errors=True)
            text = write_manifest(path, (entry for _, entry in sorted(entries.items())))
    return DatasetResult(
        manifest=str(path),
        sha256=hashlib.sha256(text).hexdigest(),
        walks=len(walks),
        made=len(missing),
        bytes=sum(file["bytes"] for entry in entries.values() for file in entry["files"]),
    )


@contextmanager
def _locked(out: Path) -> Iterator[None]:
    try:
        out.mkdir(parents=True, exist_ok=True)
        opened = os.open(out, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise OutputError(str(out), str(error.strerror), "a folder that can be written") from None
    try:
        lock(opened, str(out))
        yield
    finally:
        os.close(opened)
        _LAST.clear()


_LAST = list[Emulator]()  # the emulator of the walk before in this process, whose world the next one may share


def make_walk(walk: DatasetWalk, parts: Path, threads: int) -> Made:
    """Make the files of a walk in a new folder of its own; the world of the process's walk before is used again if it fits."""
    try:
        folder = Path(tempfile.mkdtemp(dir=parts))
        folder.chmod(0o755)
        if _LAST and not in_one_world(walk.scenario, _LAST[0].scenario):
            _LAST.clear()
        _LAST[:] = [emulator := Emulator(walk.scenario, threads=threads, like=next(iter(_LAST), None))]
        LAYOUTS[walk.layout](emulator, folder)
        entry = list_files(folder, walk, len(emulator.parts.units[0].head.beams.elevation_deg))
    except OSError as error:
        raise RunError(f"walk {walk.name}: {error.strerror}; what is made so far is kept") from None
    return walk, folder, entry


def _made(walks: Sequence[DatasetWalk], parts: Path, workers: int | None) -> Iterator[Made]:
    """Make walks, and yield each as it is done; one whose worker dies is made again."""
    left, deaths = {walk.number: walk for walk in walks}, 0
    if workers == 0:
        yield from (make_walk(walk, parts, threads=0) for walk in walks)
        return
    cores = os.cpu_count() or 1
    workers = max(min(workers or cores, len(walks)), 1)
    job = partial(make_walk, parts=parts, threads=max(cores // workers, 1))
    while left:
        try:
            with _processes(workers) as executor:
                for future in as_completed([executor.submit(job, walk) for walk in left.values()]):
                    made, deaths = future.result(), 0
                    del left[made[0].number]
                    yield made
        except BrokenExecutor:
            deaths += 1
            if deaths == _DEATHS:
                raise RunError(f"{deaths} workers died over one walk") from None


@contextmanager
def _processes(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Start processes of this machine, which are not waited for after an error."""
    others = set(multiprocessing.active_children())
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=spawn, initializer=_start_worker) as pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in set(multiprocessing.active_children()) - others:
                process.terminate()
            raise


def _start_worker() -> None:
    """Leave Ctrl-C to the parent process, and end with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    if parent := multiprocessing.parent_process():
        parent.join()
        os._exit(1)
