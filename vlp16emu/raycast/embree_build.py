"""What Embree scenes are built of: shapes with their buffers, and instances of them."""

import weakref
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import RunError
from vlp16emu.raycast import embree_library as rtc
from vlp16emu.raycast.embree_sway import set_steps
from vlp16emu.raycast.quads import Faces, faces_of
from vlp16emu.types import Mesh

__all__ = ["Grown", "Solid", "placed"]


class Grown:
    """The meshes of a shape, as Embree takes them."""

    def __init__(self, meshes: tuple[Mesh, ...]) -> None:
        self.faces = tuple(faces_of(mesh) for mesh in meshes)
        """Of each mesh."""
        self.quads = sum(len(quads) for _, quads in self.faces)
        """In all."""


class Solid:
    """A committed scene of quads, and the buffers that it shares with numpy.

    Parameters
    ----------
    faces : by the number that hits shall tell
    made_of : is kept as long as the scene is

    Raises
    ------
    RunError
        where Embree fails
    """

    def __init__(self, faces: Mapping[int, Faces], made_of: Sequence[Grown]) -> None:
        lib, device = rtc.library(), rtc.device()
        self._faces, self._made_of = faces, made_of
        self.scene = lib.rtcNewScene(device)
        weakref.finalize(self, lib.rtcReleaseScene, self.scene)
        lib.rtcSetSceneFlags(self.scene, rtc.SCENE_ROBUST)
        lib.rtcSetSceneBuildQuality(self.scene, rtc.BUILD_QUALITY_HIGH)
        for number, (vertices_m, quads) in faces.items():
            if not len(quads):
                continue
            geometry = lib.rtcNewGeometry(device, rtc.GEOMETRY_QUAD)
            for kind, layout, bytes_, rows in (
                (rtc.BUFFER_VERTEX, rtc.FORMAT_FLOAT3, 12, vertices_m[:-1]),
                (rtc.BUFFER_INDEX, rtc.FORMAT_UINT4, 16, quads),
            ):
                lib.rtcSetSharedGeometryBuffer(
                    geometry, kind, 0, layout, rows.ctypes.data, 0, bytes_, len(rows)
                )
            lib.rtcCommitGeometry(geometry)
            lib.rtcAttachGeometryByID(self.scene, geometry, number)
            lib.rtcReleaseGeometry(geometry)
        lib.rtcCommitScene(self.scene)
        rtc.check("build a shape")


def placed(
    solids: Sequence[Solid],
    transforms: NDArray[np.float32],
    moving: Mapping[int, NDArray[np.float32]],
) -> int:
    """Build the scene of instances of solids at `transforms` (n, 3, 4), numbered in their order; give its address.

    Those that are `moving` have their own transforms (k, 3, 4), evenly over ray times 0 to 1.

    Raises
    ------
    RunError
        where Embree fails
    """
    lib, device = rtc.library(), rtc.device()
    scene: int = lib.rtcNewScene(device)
    lib.rtcSetSceneFlags(scene, rtc.SCENE_ROBUST)
    first = transforms.ctypes.data
    for number, solid in enumerate(solids):
        geometry = lib.rtcNewGeometry(device, rtc.GEOMETRY_INSTANCE)
        lib.rtcSetGeometryInstancedScene(geometry, solid.scene)
        if number in moving:
            set_steps(geometry, moving[number])
        else:
            lib.rtcSetGeometryTransform(geometry, 0, rtc.FORMAT_FLOAT3X4_ROW_MAJOR, first + number * 48)
        lib.rtcCommitGeometry(geometry)
        lib.rtcAttachGeometryByID(scene, geometry, number)
        lib.rtcReleaseGeometry(geometry)
    lib.rtcCommitScene(scene)
    try:
        rtc.check("build the window")
    except RunError:
        lib.rtcReleaseScene(scene)
        raise
    return scene
