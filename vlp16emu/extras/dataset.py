"""Datasets: their file, their walks and the manifest. Walks are made by this process or by workers on this machine.

The folder of each walk lists its own files with their sha256, and the manifest joins these lists. Unlisted files are
never removed.
"""

import hashlib
import json
import multiprocessing
import os
import signal
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from itertools import pairwise, product
from pathlib import Path
from shutil import rmtree
from threading import Thread
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, ValidationError, model_validator

from vlp16emu.cores import usable_cores
from vlp16emu.engine import in_one_world
from vlp16emu.errors import OutputError, RunError, ScenarioError, readable
from vlp16emu.explain import explain
from vlp16emu.extras.clouds.cloud import label_scheme
from vlp16emu.extras.clouds.points import write_points
from vlp16emu.extras.options import DatasetOptions
from vlp16emu.output import OutputFile, lock
from vlp16emu.random import Purpose, generator
from vlp16emu.run.emulator import Emulator
from vlp16emu.scenario import Scenario, find, load
from vlp16emu.sensor.settings import require_packets
from vlp16emu.settings import Fraction, Section, toml
from vlp16emu.types import U4
from vlp16emu.units import S_NS

_SPLITS = ("train", "val", "test")
_ONE = 1e-9


def _each_once(values: list[Any]) -> list[Any]:
    if len({getattr(value, "name", value) for value in values}) < len(values):
        raise ValueError("each name and each number once")
    return values


_OnceEach = Field(min_length=1), AfterValidator(_each_once)
_Seed = Annotated[int, Field(ge=0, lt=2**63)]


class _Variant(Section):
    """A name and settings of a scene."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,60}$")]  # part of the names of walks
    set: Annotated[list[str], Field(default_factory=list)]
    """Settings, each `key.path=value` as in `--set`; paths of files are relative to the current folder."""


class _Stand(_Variant):
    """A stand: a scene, in which paths and sensors may change settings."""

    scene: Annotated[str, Field(min_length=1)]
    """Name of a scene, or path of a scene file, which is relative to the folder of the dataset's file."""


class _Splits(Section):
    """Shares of the stands; all walks of a stand are in one split."""

    train: Fraction = 0.7
    val: Fraction = 0.15
    test: Fraction = 0.15

    @model_validator(mode="after")
    def _check_shares(self) -> Self:
        if abs(self.train + self.val + self.test - 1) > _ONE:
            raise ValueError("train, val and test that sum to 1")
        return self


class DatasetSpec(Section):
    """The file of a dataset: each combination of stand, seed, path and sensor is a walk."""

    schema_version: Annotated[Literal[1], Field(alias="schema")]  # version of this format
    layout: Literal["semantickitti", "pcap+truth", "las-plots"]  # files that are written
    seed: _Seed = 1  # seed of the assignment of stands to splits
    seeds: Annotated[list[_Seed], *_OnceEach] = [1]  # noqa: RUF012  # pydantic copies it
    """Seeds of the scenes."""
    stands: Annotated[list[_Stand], *_OnceEach]  # scenes to walk in
    paths: Annotated[list[_Variant], *_OnceEach]  # paths through each stand
    sensors: Annotated[list[_Variant], *_OnceEach]  # sensors on each path
    splits: _Splits = _Splits()  # shares of the stands in train, val and test


@dataclass(frozen=True, slots=True)
class DatasetWalk:
    """One sensor on one path through one stand."""

    number: int  # from 0, in the order of stands, seeds, paths and sensors
    stand: str
    path: str
    sensor: str
    split: str
    layout: str
    scenario: Scenario

    @property
    def seed(self) -> int:
        """Seed of the scene."""
        return self.scenario.seed

    @property
    def name(self) -> str:
        """Unique name within the dataset."""
        return f"{self.stand}.{self.seed}.{self.path}.{self.sensor}"

    @property
    def folder(self) -> str:
        """Folder within the dataset."""
        return f"sequences/{self.number:02d}" if self.layout == "semantickitti" else f"walks/{self.number:04d}"


def load_spec(path: Path) -> DatasetSpec:
    """Read the file of a dataset; ScenarioError if it cannot be read or is not valid."""
    with readable(path, "a file of a dataset", ScenarioError):
        text = path.read_text(encoding="utf-8-sig")
    try:
        tree = toml(text)
    except (ValueError, RecursionError) as error:
        raise ScenarioError(str(path), f"no valid TOML: {error}", "a TOML file") from None
    try:
        return DatasetSpec.model_validate(tree)
    except ValidationError as error:
        key, found, expected = explain(error, DatasetSpec.model_json_schema())
        raise ScenarioError(f"{path}: {key}", found, expected) from None


def walks_of(spec: DatasetSpec, folder: Path) -> list[DatasetWalk]:
    """Return the walks of a dataset, with scene files found from `folder`.

    ScenarioError if a scene or a setting is wrong, or a sensor has no packets and the layout needs them.
    """
    split_of, walks = _split_of(spec), list[DatasetWalk]()
    for stand, seed, path, sensor in product(spec.stands, spec.seeds, spec.paths, spec.sensors):
        settings = [*stand.set, *path.set, *sensor.set]
        if own_seed := next((one for one in settings if one.partition("=")[0].strip() == "seed"), None):
            raise ScenarioError("set", f"found {own_seed}", "no seed, as `seeds` has those of the scenes")
        settings.append(f"seed={seed}")
        scene = find(stand.scene)
        own = scene == Path(stand.scene)  # True for a path, False for a name
        names = stand.name, path.name, sensor.name
        try:
            scenario = load(folder / scene if own else scene, settings)
            if spec.layout == "pcap+truth":
                require_packets(scenario.sensor)
        except ScenarioError as error:
            where = f"walk {stand.name}.{seed}.{path.name}.{sensor.name}: {error.where}"
            raise ScenarioError(where, error.found, error.expected) from None
        walks.append(DatasetWalk(len(walks), *names, split_of[stand.name], spec.layout, scenario))
    return walks


def _split_of(spec: DatasetSpec) -> dict[str, str]:
    """Return the split of each stand: the names are shuffled, and cut at the shares."""
    names = sorted(stand.name for stand in spec.stands)
    shuffled = [names[i] for i in generator(spec.seed, Purpose.DATASET_SPLIT).permutation(len(names))]
    ends = [0, *(round(end * len(names)) for end in (spec.splits.train, 1 - spec.splits.test, 1.0))]
    return {
        name: split for split, (begin, end) in zip(_SPLITS, pairwise(ends), strict=True) for name in shuffled[begin:end]
    }


Entry = dict[str, Any]  # a walk in its list and in the manifest

PARTS = ".vlp16emu.parts"
"""Folder within the dataset in which walks are made; if it exists when a run begins, an earlier run was killed."""
_LIST = "walk.json"  # in the folder of a walk, written last: a folder that has it is complete
_WRITTEN_BY = f"vlp16emu {version('vlp16emu')}"
_LARGEST_BYTES = 10**10


def finished(out: Path, walk: DatasetWalk) -> Entry | None:
    """Return the list of a walk if all its files agree with it and the walk is the same; None if the walk must be made.

    OutputError if its folder has a file that is not listed, or differs from the list: it may be a user's file.
    """
    folder = out / walk.folder
    entry, ours = _read_list(folder), _intact_files(folder)
    if entry.items() >= identity(walk).items() and len(ours) == len(entry["files"]) + 1:
        return entry
    if strange := {path for path in (folder, *folder.rglob("*")) if path.is_symlink() or path.is_file()} - ours:
        found = f"{min(strange).relative_to(out)} is there, and no {_LIST} lists it so"
        raise OutputError(str(out), found, "a new folder, or one of an earlier run")
    return None


def take_place(made: Path, final: Path) -> None:
    """Move a complete folder to its place, after removal of the listed files of an earlier run; RunError if that fails."""
    try:
        # The list is removed last: without it, files that are left after a kill would count as a user's.
        for path in sorted(_intact_files(final), key=lambda path: path.name == _LIST):
            path.unlink()
        for folder in sorted((path for path in final.rglob("*") if path.is_dir()), reverse=True):
            folder.rmdir()
        final.parent.mkdir(exist_ok=True)
        made.rename(final)
    except OSError as error:
        raise RunError(f"{final}: {error.strerror}; what is made so far is kept") from None


def identity(walk: DatasetWalk) -> Entry:
    """Return all inputs that determine the bytes of a walk."""
    tree = walk.scenario.model_dump(mode="json", by_alias=True, exclude_none=True)
    names = ("name", "folder", "split", "stand", "seed", "path", "sensor", "layout")
    digest = hashlib.sha256(json.dumps(tree, sort_keys=True).encode()).hexdigest()
    return {name: getattr(walk, name) for name in names} | {"written_by": _WRITTEN_BY, "scenario_sha256": digest}


def _intact_files(folder: Path) -> set[Path]:
    """Return the files of a folder that agree with its list, and the list itself."""
    if not (entry := _read_list(folder)):
        return set()
    named = [(folder / file["path"], file) for file in entry["files"]]
    return {path for path, file in named if path.is_file() and _described(path, folder) == file} | {folder / _LIST}


def _read_list(folder: Path) -> Entry:
    """Return the list of a walk's folder; empty if there is none."""
    try:
        tree = _parsed_list((folder / _LIST).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    files = tree.get("files")
    is_list = isinstance(files, list) and all(isinstance(file, dict) and "path" in file for file in files)
    return tree if is_list else {}


def _parsed_list(text: str) -> Entry:
    """Return a JSON table that a dataset has written; empty for other text."""
    try:
        tree = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return tree if isinstance(tree, dict) and str(tree.get("written_by")).startswith("vlp16emu ") else {}


def _described(path: Path, folder: Path) -> Entry:
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return {"path": path.relative_to(folder).as_posix(), "bytes": path.stat().st_size, "sha256": digest}


_MOST_INSTANCES = 0xFFFF  # the upper 16 bits of a label hold the instance (SemanticKITTI, "Data")
_IDENTITY = " ".join(f"{value:g}" for value in np.eye(3, 4).ravel())


def _semantic_kitti(emulator: Emulator, folder: Path) -> None:
    """Write a sequence: one scan per revolution, each deskewed to the pose of its first pulse.

    Poses are world_T_sensor in the world of the scene; camera and lidar coincide, so `calib.txt` has identities.
    Instances are numbered from 1 in order of first appearance in the sequence.
    """
    for name in ("velodyne", "labels"):
        (folder / name).mkdir()
    scheme = label_scheme("semantickitti")
    known, poses, starts_ns = dict[int, int](), list[str](), list[int]()
    for number, scan in enumerate(emulator.scans(truth=True)):
        assert scan.labels is not None
        assert scan.world_T_sensor is not None
        pulse, first = emulator.world_T_sensor(scan.t_ns), scan.world_T_sensor
        from_first_m = np.einsum("nij,nj->ni", pulse[:, :3, :3], scan.xyz_m) + (pulse[:, :3, 3] - first[:3, 3])
        rows = np.column_stack([from_first_m @ first[:3, :3], scan.reflectivity / 255]).astype("<f4")
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


def _numbers(instances: U4, known: dict[int, int]) -> U4:
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
}  # writers of a walk into an empty folder, by layout


_DEATHS = 10  # deaths of workers without a finished walk between them that end a run: a walk causes them

Made = tuple[DatasetWalk, Path, Entry]  # a walk, the folder with its files, and its entry in the manifest


@dataclass(frozen=True, slots=True)
class DatasetResult:
    """Result of a run."""

    manifest: str
    sha256: str  # sha256 of the manifest
    walks: int
    made: int  # new walks
    bytes: int  # size of all files of all walks


def make_dataset(
    walks: Sequence[DatasetWalk], out: Path, *, progress: Callable[[float], None] = lambda _: None, **options: Any
) -> DatasetResult:
    """Make the missing walks of a dataset, and its manifest.

    A walk is complete if its folder has a list, and its files have the sizes and sha256 of that list.

    Parameters
    ----------
    out : folder, new or from an earlier run
    progress : called with the simulated seconds so far, walk by walk
    options : fields of `DatasetOptions`

    Raises OutputError if the folder cannot be written, another run writes it, or the folder of a walk has an unlisted
    file; RunError if a walk fails, or workers die repeatedly on one walk.
    """
    out, asked = out.absolute(), DatasetOptions(**options)
    walks = walks[slice(*(asked.share or (None,)))]
    path, parts = out / "manifest{}.json".format(".{}-{}".format(*asked.share) if asked.share else ""), out / PARTS
    with _locked(out):
        _check_manifest(path)
        entries = {walk.number: entry for walk in walks if (entry := finished(out, walk))}
        missing = [walk for walk in walks if walk.number not in entries]
        done_s = sum(walk.scenario.duration_s for walk in walks if walk.number in entries)
        progress(done_s)
        try:
            rmtree(parts, ignore_errors=True)
            parts.mkdir()
            for walk, made, entry in _make_walks(missing, parts, asked.workers):
                take_place(made, out / walk.folder)
                entries[walk.number] = entry
                progress(done_s := done_s + walk.scenario.duration_s)
        finally:
            rmtree(parts, ignore_errors=True)
            listed = [entry for _, entry in sorted(entries.items())]
            text = json.dumps({"written_by": _WRITTEN_BY, "walks": listed}, indent=2) + "\n"
            with OutputFile(path) as file, file.writing() as opened:
                opened.write(text.encode())
    return DatasetResult(
        manifest=str(path),
        sha256=hashlib.sha256(text.encode()).hexdigest(),
        walks=len(walks),
        made=len(missing),
        bytes=sum(file["bytes"] for entry in entries.values() for file in entry["files"]),
    )


def _check_manifest(path: Path) -> None:
    """Refuse to overwrite a file that is no manifest."""
    if not path.exists():
        return
    expected = "the manifest of a dataset"
    with readable(path, expected, OutputError, most_bytes=_LARGEST_BYTES):
        text = path.read_text(encoding="utf-8")
    if not _parsed_list(text):
        raise OutputError(str(path), "is none of ours", expected)


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


_LAST = list[Emulator]()  # the emulator of the previous walk in this process, whose world the next walk may share


def make_walk(walk: DatasetWalk, parts: Path, threads: int) -> Made:
    """Make the files of a walk in a new folder; the world of the previous walk in this process is reused if it fits."""
    try:
        folder = Path(tempfile.mkdtemp(dir=parts))
        folder.chmod(0o755)
        if _LAST and not in_one_world(walk.scenario, _LAST[0].scenario):
            _LAST.clear()
        _LAST[:] = [emulator := Emulator(walk.scenario, threads=threads, like=next(iter(_LAST), None))]
        LAYOUTS[walk.layout](emulator, folder)
        files = [_described(path, folder) for path in sorted(folder.rglob("*")) if path.is_file()]
        beams = len(emulator.parts.units[0].head.beams.elevation_deg)
        entry = identity(walk) | {"beams": beams, "files": files}
        (folder / _LIST).write_text(f"{json.dumps(entry, indent=2)}\n", encoding="utf-8")
    except OSError as error:
        raise RunError(f"walk {walk.name}: {error.strerror}; what is made so far is kept") from None
    return walk, folder, entry


def _make_walks(walks: Sequence[DatasetWalk], parts: Path, workers: int | None) -> Iterator[Made]:
    """Make walks, and yield each when it is done; a walk whose worker dies is made again."""
    left, deaths = {walk.number: walk for walk in walks}, 0
    if workers == 0:
        yield from (make_walk(walk, parts, threads=0) for walk in walks)
        return
    cores = usable_cores()
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
    """Start worker processes; after an error they are terminated."""
    others = set(multiprocessing.active_children())
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=spawn, initializer=_start_worker) as pool:
        try:
            yield pool
        except BaseException:
            for process in set(multiprocessing.active_children()) - others:
                process.terminate()
            raise


def _start_worker() -> None:
    """Ignore Ctrl-C, which the parent process handles, and end with the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def end_with_parent() -> None:
        if parent := multiprocessing.parent_process():
            parent.join()
            os._exit(1)

    Thread(target=end_with_parent, daemon=True).start()
