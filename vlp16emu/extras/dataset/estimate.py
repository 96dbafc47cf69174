"""Size and run time of a dataset, estimated from short runs of a few of its walks."""

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from random import Random
from shutil import disk_usage
from statistics import mean
from tempfile import TemporaryDirectory
from typing import Any

from vlp16emu.cores import usable_cores
from vlp16emu.engine import in_one_world
from vlp16emu.extras.dataset.cluster import connect
from vlp16emu.extras.dataset.layouts import LAYOUTS
from vlp16emu.extras.dataset.manifest import described_files, listed
from vlp16emu.extras.dataset.run import check_options
from vlp16emu.extras.dataset.spec import DatasetWalk
from vlp16emu.extras.options import DatasetOptions
from vlp16emu.run.emulator import Emulator
from vlp16emu.run.options import Span
from vlp16emu.scenario import load
from vlp16emu.store import user_store

_MOST_PROBES = 8  # pairs of stand and sensor; each takes the growth of its stand and 7 s of a walk
_FIRST_S = 0.5  # run before the measured span: the world grows in it
_MEASURED_S = 7.0  # a window of the world, 6.8 s (engine.windows.SEGMENT): shorter spans open one or none
_HOUR_S = 3600.0


@dataclass(frozen=True, slots=True)
class Probe:
    """Cost of the walks of one sensor in one stand, measured on this machine."""

    stand: str
    sensor: str
    measured_s: float  # simulated
    grow_cpu_s: float  # CPU time until the first pulse is cast: the world grows
    cpu_s_per_s: float  # CPU time per simulated second
    bytes_per_s: float  # bytes of all files per simulated second


@dataclass(frozen=True, slots=True)
class DatasetEstimate:
    """Expected size and run time of the walks of a dataset that are not complete."""

    walks: int
    complete: int  # walks that the folder has; their files are not checked
    missing: int
    simulated_s: float  # of the missing walks
    bytes: int  # of the missing walks
    free_bytes: int  # of the file system of the folder
    cpu_hours: float  # at the speed of this machine's cores; each stand is grown once for each seed
    cores: int  # that make walks at a time
    hours: float  # if all cores are at work until the end
    kinds: int  # pairs of stand and sensor among the missing walks
    probes: tuple[Probe, ...]  # those that were measured; others are taken as their mean


def estimate_dataset(walks: Sequence[DatasetWalk], out: Path, **options: Any) -> DatasetEstimate:
    """Estimate size and run time of the missing walks of a dataset; no file is left behind.

    At most 8 pairs of stand and sensor are measured: the growth of the stand, and 7 s of a walk, written by
    the dataset's own writers into a temporary folder.

    Parameters
    ----------
    walks : of the dataset
    out : its folder, which need not exist
    options : fields of `DatasetOptions`; a scheduler is asked for the number of its workers

    Raises InputError for wrong options, a scheduler that has no fit workers, or a scene
    that cannot be made; MissingExtraError for a scheduler without Dask.
    """
    asked = DatasetOptions.from_fields(options)
    check_options(asked)
    cores = _cores(asked)
    missing = [walk for walk in walks if listed(out, walk) is None]
    kinds = {(walk.stand, walk.sensor): walk for walk in reversed(missing)}  # the first walk of each
    chosen = set(Random(0).sample(sorted(kinds), min(len(kinds), _MOST_PROBES)))  # noqa: S311  # no secret
    probes = list(_probes([walk for kind, walk in reversed(kinds.items()) if kind in chosen]))
    measured = {(probe.stand, probe.sensor): probe for probe in probes}
    size_bytes = 0.0
    cpu_s = 0.0
    worlds = set[tuple[str, int]]()
    for walk in missing:
        kind_probe = measured.get((walk.stand, walk.sensor))
        rates = [kind_probe] if kind_probe else probes
        size_bytes += walk.scenario.duration_s * mean(probe.bytes_per_s for probe in rates)
        cpu_s += walk.scenario.duration_s * mean(probe.cpu_s_per_s for probe in rates)
        if (walk.stand, walk.seed) not in worlds:
            worlds.add((walk.stand, walk.seed))
            stand_probes = [probe for probe in probes if not kind_probe or probe.stand == walk.stand]
            cpu_s += max(probe.grow_cpu_s for probe in stand_probes)
    folder = next(place for place in (out.absolute(), *out.absolute().parents) if place.is_dir())
    return DatasetEstimate(
        walks=len(walks),
        complete=len(walks) - len(missing),
        missing=len(missing),
        simulated_s=sum(walk.scenario.duration_s for walk in missing),
        bytes=round(size_bytes),
        free_bytes=disk_usage(folder).free,
        cpu_hours=cpu_s / _HOUR_S,
        cores=cores,
        hours=cpu_s / _HOUR_S / cores,
        kinds=len(kinds),
        probes=tuple(probes),
    )


def _cores(asked: DatasetOptions) -> int:
    """Return the number of walks that are made at a time."""
    if asked.scheduler is not None:
        with connect(asked.scheduler) as cluster:
            return cluster.threads
    return min(asked.workers or usable_cores(), usable_cores())


def _probes(walks: Sequence[DatasetWalk]) -> Iterator[Probe]:
    """Measure a part of each walk; walks of one stand share its grown world, as in a dataset."""
    if walks:
        _load_kernels(walks[0].layout)
    latest: Emulator | None = None
    grow_cpu_s = 0.0
    for walk in walks:
        first_s = min(_FIRST_S, walk.scenario.duration_s)
        span_s = min(_MEASURED_S, walk.scenario.duration_s)
        like = latest if latest and in_one_world(walk.scenario, latest.scenario) else None
        with _without_store():
            began_s = time.process_time()
            emulator = Emulator(walk.scenario, like=like)
            _written_bytes(emulator, walk.layout, Span(0.0, first_s))
            first_cpu_s = time.process_time() - began_s
            middle = Span((walk.scenario.duration_s - span_s) / 2, span_s)
            size_bytes = _written_bytes(emulator, walk.layout, middle)
        cpu_s_per_s = (time.process_time() - began_s - first_cpu_s) / span_s
        if like is None:
            grow_cpu_s = max(first_cpu_s - first_s * cpu_s_per_s, 0.0)
        yield Probe(walk.stand, walk.sensor, span_s, grow_cpu_s, cpu_s_per_s, size_bytes / span_s)
        latest = emulator


def _load_kernels(layout: str) -> None:
    """Run a tenth of a second of the hall, so that the first probe does not load the kernels."""
    _written_bytes(Emulator(load("static_bench", {"duration_s": 0.1})), layout, Span())


def _written_bytes(emulator: Emulator, layout: str, span: Span) -> int:
    """Write a span of a walk into a temporary folder, and return the size of its files."""
    with TemporaryDirectory(prefix="vlp16emu-") as name:
        LAYOUTS[layout](emulator, Path(name), span)
        files = described_files(Path(name))
    return sum(file["bytes"] for file in files)


@contextmanager
def _without_store() -> Iterator[None]:
    """Grow worlds as on a machine that has none in its cache."""
    store = user_store()
    folder = store.folder
    store.folder = None
    try:
        yield
    finally:
        store.folder = folder
