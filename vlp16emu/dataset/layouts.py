"""Files of one walk, in the layouts that people read."""

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vlp16emu.emulator import Emulator
from vlp16emu.errors import RunError
from vlp16emu.extras.clouds.points import write_points
from vlp16emu.extras.truth.truth import write_truth
from vlp16emu.scan import Labels, Scan
from vlp16emu.types import PlantPart, Semantic
from vlp16emu.units import S_NS, seconds_to_ns

_SEMANTIC_KITTI = {
    Semantic.NONE: 0,  # unlabeled
    Semantic.GROUND: 72,  # terrain
    Semantic.TREE: 70,  # vegetation; its stem below
    Semantic.SHRUB: 70,
    Semantic.STONE: 99,  # other-object
    Semantic.DEADWOOD: 99,
    Semantic.GRASS: 72,
    Semantic.OTHER: 99,
}
"""Numbers of the classes in `config/semantic-kitti.yaml` of the SemanticKITTI API."""
_TRUNK = 71
_TRUNK_PARTS = (PlantPart.STEM, PlantPart.ROOT_FLARE)
_MOST_INSTANCES = 0xFFFF
"""The upper 16 bits of a label hold the instance (SemanticKITTI, "Data")."""
_BEFORE_S = 0.01
"""So much earlier the cast of a stretch begins, so that the reading before its first revolution is known."""
_CAPTURE = "walk.pcap"
_PCAP_HEADER_BYTES = 24
"""Of the file header of classic pcap (draft-ietf-opsawg-pcap, section 4)."""
_AT_ONCE = 500_000
"""Points of a plot in memory."""
_IDENTITY = " ".join(f"{value:g}" for value in np.eye(3, 4).ravel())


def walk_folder(layout: str, number: int) -> str:
    """Name the folder of a walk within the dataset."""
    return f"sequences/{number:02d}" if layout == "semantickitti" else f"walks/{number:04d}"


def _scans(emulator: Emulator, span_s: tuple[float, float], folder: Path) -> None:
    """Write the revolutions that begin in a span, each deskewed to the pose of its first pulse."""
    begin_ns, end_ns = (emulator.scenario.start_ns + seconds_to_ns(s) for s in span_s)
    for scan in emulator.scans(start_s=max(span_s[0] - _BEFORE_S, 0.0), truth=True):
        if scan.start_ns >= end_ns:
            break
        if scan.start_ns >= begin_ns:
            assert scan.labels is not None
            assert scan.world_T_sensor is not None
            np.savez(
                folder / f"{scan.start_ns}.npz",
                rows=np.column_stack([_deskewed(emulator, scan), scan.reflectivity / 255]).astype("<f4"),
                classes=_classes(scan.labels),
                instances=scan.labels.instance,
                pose=scan.world_T_sensor[:3],
            )


def _semantic_kitti(_emulator: Emulator, stretches: Sequence[Path], folder: Path) -> None:
    """Write a sequence: one scan per revolution.

    Poses take scans to the world of the scene; camera and lidar are one, so `calib.txt` holds identities. Instances are
    numbered from 1 in the order in which the sequence first sees them.
    """
    for name in ("velodyne", "labels"):
        (folder / name).mkdir()
    files = sorted(
        (file for stretch in stretches for file in stretch.iterdir()), key=lambda file: int(file.stem)
    )
    known, poses = dict[int, int](), list[str]()
    for number, file in enumerate(files):
        with np.load(file) as scan:
            (folder / "velodyne" / f"{number:06d}.bin").write_bytes(scan["rows"].tobytes())
            labels = scan["classes"] | _numbers(scan["instances"], known) << np.uint32(16)
            (folder / "labels" / f"{number:06d}.label").write_bytes(labels.astype("<u4").tobytes())
            poses.append(" ".join(f"{value:.9e}" for value in scan["pose"].ravel()))
    times = [f"{(int(file.stem) - int(files[0].stem)) / S_NS:.9f}" for file in files]
    calibration = [f"{name}: {_IDENTITY}" for name in ("P0", "P1", "P2", "P3", "Tr")]
    for name, lines in (("poses.txt", poses), ("times.txt", times), ("calib.txt", calibration)):
        (folder / name).write_text("".join(f"{line}\n" for line in lines), encoding="ascii")


def _deskewed(emulator: Emulator, scan: Scan) -> NDArray[np.float64]:
    """(n, 3) points of a scan in the sensor's frame at the scan's first pulse."""
    assert scan.world_T_sensor is not None
    pulse = emulator.world_T_sensor(scan.t_ns)
    first = scan.world_T_sensor
    world_m = np.einsum("nij,nj->ni", pulse[:, :3, :3], scan.xyz_m) + (pulse[:, :3, 3] - first[:3, 3])
    return np.asarray(world_m @ first[:3, :3])


def _classes(labels: Labels) -> NDArray[np.uint32]:
    """(n,) classes of points."""
    class_of = np.array([_SEMANTIC_KITTI[semantic] for semantic in Semantic], np.uint32)
    classes = class_of[labels.semantic]
    classes[(labels.semantic == Semantic.TREE) & np.isin(labels.part, _TRUNK_PARTS)] = _TRUNK
    return np.asarray(classes)


def _numbers(instances: NDArray[np.uint32], known: dict[int, int]) -> NDArray[np.uint32]:
    """(n,) numbers of instances; those that are new become known."""
    own, index = np.unique(instances, return_inverse=True)
    for instance in own[own > 0].tolist():
        known.setdefault(instance, len(known) + 1)
    if len(known) > _MOST_INSTANCES:
        raise RunError(f"more than {_MOST_INSTANCES} instances in one sequence, which its labels cannot hold")
    return np.array([known.get(instance, 0) for instance in own.tolist()], np.uint32)[index]


def _packets(emulator: Emulator, span_s: tuple[float, float], folder: Path) -> None:
    emulator.record(folder / _CAPTURE, start_s=span_s[0], duration_s=span_s[1] - span_s[0])


def _pcap_and_truth(emulator: Emulator, stretches: Sequence[Path], folder: Path) -> None:
    """Write a capture, and its ground truth in a folder beside it."""
    with (folder / _CAPTURE).open("wb") as capture:
        for stretch in stretches:
            with (stretch / _CAPTURE).open("rb") as part:
                part.seek(_PCAP_HEADER_BYTES if capture.tell() else 0)
                shutil.copyfileobj(part, capture)
    write_truth(emulator, folder / "truth")


def _points(emulator: Emulator, span_s: tuple[float, float], folder: Path) -> None:
    write_points(
        emulator, folder / "points.las", start_s=span_s[0], duration_s=span_s[1] - span_s[0], truth=True
    )


def _las_plots(_emulator: Emulator, stretches: Sequence[Path], folder: Path) -> None:
    """Write the walk as one labelled cloud in the world; its classes are those of ASPRS, the rest extra dimensions."""
    import laspy  # is there, or the stretches would not be

    with laspy.open(stretches[0] / "points.las") as first:
        header = first.header
    with laspy.open(folder / "points.laz", "w", header=header) as plot:
        for stretch in stretches:
            with laspy.open(stretch / "points.las") as part:
                for points in part.chunk_iterator(_AT_ONCE):
                    plot.write_points(points)


@dataclass(frozen=True, slots=True)
class Layout:
    """How the files of a walk are made; folders are there and empty."""

    stretch: Callable[[Emulator, tuple[float, float], Path], None]
    """Casts a span in seconds since the first pulse, into a folder of its own."""
    walk: Callable[[Emulator, Sequence[Path], Path], None]
    """Makes the files of the walk of those of its stretches."""


LAYOUTS = {
    "semantickitti": Layout(_scans, _semantic_kitti),
    "pcap+truth": Layout(_packets, _pcap_and_truth),
    "las-plots": Layout(_points, _las_plots),
}
"""By their names in the file of a dataset."""
