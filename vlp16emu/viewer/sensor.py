"""The sensor where it is at the begin of a sweep: its axes, its beams, and the sectors in which packets are at fault."""

import numpy as np
import viser
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vlp16emu.scan import Scan
from vlp16emu.sensor.beams import BeamTable
from vlp16emu.viewer.sweeps import Mark, Sweep

_LOST_M = 30.0
"""How far a beam that meets nothing is drawn."""
_HIT, _LOST, _WRONG = (255, 70, 50), (150, 160, 175), (230, 0, 60)
_SECTOR_M, _STEP_DEG = 8.0, 1.0
"""Radius of a sector, and the width of its triangles."""


class DrawnSensor:
    """Nodes of a page that show the sensor."""

    def __init__(self, server: viser.ViserServer, beams: BeamTable) -> None:
        self._scene, self._beams = server.scene, beams
        self._frame = server.scene.add_frame("/sensor", axes_length=0.6, axes_radius=0.02)
        self._faults: viser.MeshHandle | None = None

    def show(self, sweep: Sweep, *, with_beams: bool) -> None:
        """Put it where a sweep begins."""
        if (world_T_sensor := sweep.scan.world_T_sensor) is not None:
            self._frame.position = world_T_sensor[:3, 3]
            self._frame.wxyz = Rotation.from_matrix(world_T_sensor[:3, :3]).as_quat(scalar_first=True)
        ends_m, is_hit = beams_of(sweep.scan, self._beams)
        self._scene.add_line_segments(
            "/sensor/beams",
            np.stack([np.zeros_like(ends_m), ends_m], axis=1),
            np.where(is_hit[:, None, None], _HIT, _LOST).repeat(2, axis=1).astype(np.uint8),
            thickness=0.015,
            visible=with_beams,
        )
        if self._faults is not None:
            self._faults.remove()
            self._faults = None
        if sweep.marks:
            vertices_m, faces = sectors_of(sweep.marks)
            self._faults = self._scene.add_mesh_simple(
                "/sensor/faults", vertices_m, faces, color=_WRONG, opacity=0.45, side="double"
            )


def beams_of(scan: Scan, beams: BeamTable) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Give the ends (L, 3) in the sensor of a scan's first beams, by rising elevation, and (L,) which of them met something."""
    rising = np.sort(beams.elevation_deg)
    first = scan.t_ns < scan.start_ns + beams.sequence_ns
    azimuth = np.radians(scan.azimuth_deg[first][0] if first.any() else 0.0)
    flat = np.cos(np.radians(rising))
    ends_m = _LOST_M * np.stack(
        [flat * np.cos(azimuth), -flat * np.sin(azimuth), np.sin(np.radians(rising))], axis=1
    )
    ring = scan.ring[first]
    ends_m[ring] = scan.xyz_m[first]
    return ends_m, np.isin(np.arange(len(rising)), ring)


def sectors_of(marks: tuple[Mark, ...]) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """Vertices (v, 3) in the sensor and triangles (f, 3) of level sectors between the azimuths of marks."""
    corners = []
    for begin_deg, end_deg, _ in marks:
        width_deg = (end_deg - begin_deg) % 360.0
        edges = np.linspace(0.0, width_deg, 2 + int(width_deg / _STEP_DEG))
        azimuth = np.radians(begin_deg + edges)
        rim_m = _SECTOR_M * np.stack([np.cos(azimuth), -np.sin(azimuth), np.zeros_like(azimuth)], axis=1)
        corners.append(np.stack([np.zeros_like(rim_m[1:]), rim_m[1:], rim_m[:-1]], axis=1))
    vertices_m = np.concatenate([np.zeros((0, 3, 3)), *corners]).reshape(-1, 3).astype(np.float32)
    return vertices_m, np.arange(len(vertices_m), dtype=np.uint32).reshape(-1, 3)
