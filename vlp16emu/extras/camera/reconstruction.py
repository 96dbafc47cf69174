"""Poses and intrinsics for programs that reconstruct from images: COLMAP and nerfstudio.

Both count pixels from the corner of the first one: its middle is (0.5, 0.5).
"""

import json
from collections.abc import Sequence

import numpy as np

from vlp16emu.elementary import matvec
from vlp16emu.extras.camera.lens import Lens
from vlp16emu.types import F8

_CORNER = 0.5  # from the middle of a pixel to its corner
_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])  # nerfstudio's cameras: x right, y up, z backward


def reconstruction_files(lens: Lens, poses: Sequence[F8], depth_suffix: str) -> dict[str, str]:
    """Return the texts of the files by their paths in a folder of images.

    Parameters
    ----------
    poses : world_T_camera (4, 4) of each image
    depth_suffix : of the files of depth
    """
    return {
        "sparse/0/cameras.txt": _colmap_camera(lens),
        "sparse/0/images.txt": "".join(_colmap_image(number, pose) for number, pose in enumerate(poses)),
        "sparse/0/points3D.txt": "# no points\n",
        "transforms.json": _transforms(lens, poses, depth_suffix),
    }


def _colmap_camera(lens: Lens) -> str:
    """Return the line of one camera.

    COLMAP, "Output format", and the parameters of its models in src/colmap/sensor/models.h.
    """
    k1, k2, p1, p2, k3 = lens.distortion
    numbers = [lens.fx, lens.fy, lens.cx + _CORNER, lens.cy + _CORNER]
    model = "PINHOLE"
    if k3:
        model = "FULL_OPENCV"
        numbers += [k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]
    elif any(lens.distortion):
        model = "OPENCV"
        numbers += [k1, k2, p1, p2]
    return f"1 {model} {lens.width} {lens.height} {' '.join(map(repr, numbers))}\n"


def _colmap_image(number: int, world_T_camera: F8) -> str:
    """Return the two lines of an image: camera_T_world, and no points."""
    from scipy.spatial.transform import Rotation

    turn = world_T_camera[:3, :3].T
    x, y, z = (-matvec(turn, world_T_camera[:3, 3])).tolist()
    qx, qy, qz, qw = Rotation.from_matrix(turn).as_quat(canonical=True).tolist()
    pose = " ".join(f"{value:.12f}" for value in (qw, qx, qy, qz, x, y, z))
    return f"{number + 1} {pose} 1 {number:06d}.png\n\n"


def _transforms(lens: Lens, poses: Sequence[F8], depth_suffix: str) -> str:
    k1, k2, p1, p2, k3 = lens.distortion
    frames = [
        {
            "file_path": f"rgb/{number:06d}.png",
            "depth_file_path": f"depth/{number:06d}{depth_suffix}",
            "transform_matrix": (pose * np.diag(_OPENGL)).tolist(),
        }
        for number, pose in enumerate(poses)
    ]
    tree = {
        "camera_model": "OPENCV",
        "w": lens.width,
        "h": lens.height,
        "fl_x": lens.fx,
        "fl_y": lens.fy,
        "cx": lens.cx + _CORNER,
        "cy": lens.cy + _CORNER,
        "k1": k1,
        "k2": k2,
        "k3": k3,
        "p1": p1,
        "p2": p2,
        "frames": frames,
    }
    return json.dumps(tree, indent=1) + "\n"
