"""Scenes of instanced shapes in Embree, kept from window to window."""

import ctypes
import threading
import weakref
from collections.abc import Callable
from concurrent.futures import Executor

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import RunError
from vlp16emu.raycast import embree_library as rtc
from vlp16emu.raycast.embree_kernel import PACKET, cast_packets
from vlp16emu.raycast.placement import normal_matrices, relative_to_window
from vlp16emu.types import Firings, Hits, Mesh, ShapeKey, Window

__all__ = ["EmbreeCaster", "EmbreeScene"]


class _Shape:
    """A committed scene of one shape, and the buffers that it shares with numpy."""

    def __init__(self, lib: ctypes.CDLL, device: int, meshes: tuple[Mesh, ...]) -> None:
        self.scene = lib.rtcNewScene(device)
        weakref.finalize(self, lib.rtcReleaseScene, self.scene)
        lib.rtcSetSceneFlags(self.scene, rtc.SCENE_ROBUST)
        self._buffers: list[NDArray[np.float32] | NDArray[np.uint32]] = []
        for number, mesh in enumerate(meshes):
            if len(mesh.faces):
                self._attach(lib, device, number, mesh)
        lib.rtcCommitScene(self.scene)

    def _attach(self, lib: ctypes.CDLL, device: int, number: int, mesh: Mesh) -> None:
        """Add one mesh under its number, without copying its faces."""
        corners = mesh.faces.shape[1]
        quads = corners == 4
        # Embree reads 16 bytes at the last vertex of 12.
        vertices = np.zeros((len(mesh.vertices_m) + 1, 3), np.float32)
        vertices[:-1] = mesh.vertices_m
        faces = np.ascontiguousarray(mesh.faces)
        self._buffers += [vertices, faces]
        geometry = lib.rtcNewGeometry(device, rtc.GEOMETRY_QUAD if quads else rtc.GEOMETRY_TRIANGLE)
        lib.rtcSetSharedGeometryBuffer(
            geometry, rtc.BUFFER_VERTEX, 0, rtc.FORMAT_FLOAT3, vertices.ctypes.data, 0, 12, len(vertices) - 1
        )
        lib.rtcSetSharedGeometryBuffer(
            geometry,
            rtc.BUFFER_INDEX,
            0,
            rtc.FORMAT_UINT4 if quads else rtc.FORMAT_UINT3,
            faces.ctypes.data,
            0,
            4 * corners,
            len(faces),
        )
        lib.rtcCommitGeometry(geometry)
        lib.rtcAttachGeometryByID(self.scene, geometry, number)
        lib.rtcReleaseGeometry(geometry)


class EmbreeScene:
    """A window ready to be cast against; any number of threads may cast at once."""

    def __init__(self, lib: ctypes.CDLL, device: int, window: Window, shapes: list[_Shape]) -> None:
        self._shapes = shapes
        self._origin_m = window.origin_m
        self.surfaces = window.surfaces
        self._first_surface = window.first_surface
        self._normal_matrix = normal_matrices(window)
        self._scene = lib.rtcNewScene(device)
        weakref.finalize(self, lib.rtcReleaseScene, self._scene)
        lib.rtcSetSceneFlags(self._scene, rtc.SCENE_ROBUST)
        transforms = relative_to_window(window).astype(np.float32)
        pointer = ctypes.POINTER(ctypes.c_float)
        for number, shape in enumerate(window.shape.tolist()):
            geometry = lib.rtcNewGeometry(device, rtc.GEOMETRY_INSTANCE)
            lib.rtcSetGeometryInstancedScene(geometry, shapes[shape].scene)
            transform = transforms[number].ctypes.data_as(pointer)
            lib.rtcSetGeometryTransform(geometry, 0, rtc.FORMAT_FLOAT3X4_ROW_MAJOR, transform)
            lib.rtcCommitGeometry(geometry)
            lib.rtcAttachGeometryByID(self._scene, geometry, number)
            lib.rtcReleaseGeometry(geometry)
        lib.rtcCommitScene(self._scene)

    def cast(self, firings: Firings, near_m: NDArray[np.float64], far_m: float) -> Hits:
        """Cast one ray per pulse.

        Parameters
        ----------
        firings : k sequences, k a multiple of 8
        near_m : (L,) range at which each laser's light begins
        far_m : range at which it is given up

        """
        shape = firings.t_ns.shape
        if shape[0] % PACKET:
            raise ValueError(f"cast: found {shape[0]} sequences, expected a multiple of {PACKET}")
        range_m, cos_incidence = np.empty(shape, np.float32), np.empty(shape, np.float32)
        surface = np.empty(shape, np.uint32)
        cast_packets(
            self._scene,
            self._origin_m,
            firings.origin_m,
            firings.direction,
            near_m,
            far_m,
            self._first_surface,
            self._normal_matrix,
            range_m,
            surface,
            cos_incidence,
        )
        return Hits.one_ray_each(range_m, surface, cos_incidence)


class EmbreeCaster:
    """Opens windows, building only the shapes that no open window has yet.

    Parameters
    ----------
    shape : grows the meshes of a shape
    workers : where shapes are grown and built side by side
    """

    def __init__(self, shape: Callable[[ShapeKey], tuple[Mesh, ...]], workers: Executor) -> None:
        self._grow, self._workers = shape, workers
        self._lib = rtc.library()
        # One thread per build keeps the order of primitives, and so every tie between two faces, the same.
        self._device = self._lib.rtcNewDevice(b"threads=1,set_affinity=0")
        if not self._device:
            raise RunError(f"Embree gave no device: error {self._lib.rtcGetDeviceError(None)}")
        weakref.finalize(self, self._lib.rtcReleaseDevice, self._device)
        self._built: weakref.WeakValueDictionary[ShapeKey, _Shape] = weakref.WeakValueDictionary()
        self._lock = threading.Lock()

    def open(self, window: Window) -> EmbreeScene:
        """Make a window ready for casting.

        Raises
        ------
        RunError
            where Embree reports an error, for instance that memory ran out
        """
        with self._lock:
            kept = [self._built.get(key) for key in window.shapes]
            missing = [key for key, shape in zip(window.shapes, kept, strict=True) if shape is None]
            fresh = dict(zip(missing, self._workers.map(self._build, missing), strict=True))
            self._built.update(fresh)
            shapes = [shape or fresh[key] for key, shape in zip(window.shapes, kept, strict=True)]
            scene = EmbreeScene(self._lib, self._device, window, shapes)
        if error := self._lib.rtcGetDeviceError(self._device):
            raise RunError(f"Embree could not build the window: error {error}")
        return scene

    def _build(self, key: ShapeKey) -> _Shape:
        return _Shape(self._lib, self._device, self._grow(key))
