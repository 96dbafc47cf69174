"""Writers of the files of a walk, by layout."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from vlp16emu.elementary import matmul, matvec
from vlp16emu.errors import RunError
from vlp16emu.extras.clouds.cloud import label_scheme
from vlp16emu.extras.clouds.points import write_points
from vlp16emu.run.emulator import Emulator
from vlp16emu.run.options import Span
from vlp16emu.types import U4
from vlp16emu.units import S_NS

_MOST_INSTANCES = 0xFFFF  # the upper 16 bits of a label hold the instance (SemanticKITTI, "Data")
_IDENTITY = " ".join(f"{value:g}" for value in np.eye(3, 4).ravel())


def _semantic_kitti(emulator: Emulator, folder: Path, span: Span) -> None:
    """Write a sequence: one scan per revolution, each deskewed to the pose of its first pulse.

    Poses are world_T_sensor in the world of the scene; camera and lidar coincide, so `calib.txt` has
    identities. Instances are numbered from 1 in order of first appearance in the sequence.
    """
    for name in ("velodyne", "labels"):
        (folder / name).mkdir()
    scheme = label_scheme("semantickitti")
    known = dict[int, int]()
    poses = list[str]()
    starts_ns = list[int]()
    for number, scan in enumerate(emulator.scans(**vars(span), truth=True)):
        assert scan.labels is not None
        assert scan.world_T_sensor is not None
        pulse = emulator.world_T_sensor(scan.t_ns)
        first = scan.world_T_sensor
        turned_m = matvec(pulse[:, :3, :3], scan.xyz_m.astype(np.float64))
        from_first_m = turned_m + (pulse[:, :3, 3] - first[:3, 3])
        deskewed_m = matmul(from_first_m, first[:3, :3])
        rows = np.column_stack([deskewed_m, scan.reflectivity / 255]).astype("<f4")
        (folder / "velodyne" / f"{number:06d}.bin").write_bytes(rows.tobytes())
        classes = scheme.codes(scan.labels.semantic, scan.labels.part).astype("<u4")
        labels = classes | _numbers(scan.labels.instance, known) << np.uint32(16)
        (folder / "labels" / f"{number:06d}.label").write_bytes(labels.astype("<u4").tobytes())
        poses.append(" ".join(f"{value:.9e}" for value in first[:3].ravel()))
        starts_ns.append(scan.start_ns)
    times = [f"{(start_ns - starts_ns[0]) / S_NS:.9f}" for start_ns in starts_ns]
    calibration = [f"{name}: {_IDENTITY}" for name in ("P0", "P1", "P2", "P3", "Tr")]
    for name, lines in (("poses.txt", poses), ("times.txt", times), ("calib.txt", calibration)):
        (folder / name).write_text("".join(f"{line}\n" for line in lines), encoding="ascii")


def _numbers(instances: U4, known: dict[int, int]) -> U4:
    """Return the numbers of instances (n,) in a sequence, 0 for none, and add new ones to the known."""
    distinct, index = np.unique(instances, return_inverse=True)
    for instance in distinct[distinct > 0].tolist():
        known.setdefault(instance, len(known) + 1)
    if len(known) > _MOST_INSTANCES:
        raise RunError(f"more than {_MOST_INSTANCES} instances in one sequence, which its labels cannot hold")
    return np.array([known.get(instance, 0) for instance in distinct.tolist()], np.uint32)[index]


def _capture(emulator: Emulator, folder: Path, span: Span) -> None:
    """Write a capture and its ground truth."""
    emulator.record(folder / "walk.pcap", truth=folder / "truth", **vars(span))


def _plot(emulator: Emulator, folder: Path, span: Span) -> None:
    """Write all points of a walk, with labels, in the world of the scene."""
    write_points(emulator, folder / "points.laz", truth=True, **vars(span))


LAYOUTS: dict[str, Callable[[Emulator, Path, Span], None]] = {
    "semantickitti": _semantic_kitti,
    "pcap+truth": _capture,
    "las-plots": _plot,
}
"""Writers of a span of a walk into an empty folder, by the names of `DatasetSpec.layout`."""
