"""Files of one walk, by layout."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from vlp16emu.emulator import Emulator
from vlp16emu.errors import RunError
from vlp16emu.extras.clouds.labels import label_scheme
from vlp16emu.extras.clouds.points import write_points
from vlp16emu.types import F8, U4, Scan
from vlp16emu.units import S_NS

_MOST_INSTANCES = 0xFFFF
"""The upper 16 bits of a label hold the instance (SemanticKITTI, "Data")."""
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
