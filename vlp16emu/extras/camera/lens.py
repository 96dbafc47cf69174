"""Pinhole projection with Brown's distortion, in both directions.

Axes of a camera are x right, y down, z forward (REP 103, suffix `_optical`). All is computed by sums,
products, quotients and square roots, so that every processor finds the same rays.
"""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from vlp16emu.elementary import norm, tan
from vlp16emu.errors import InputError
from vlp16emu.extras.camera.settings import Camera
from vlp16emu.types import F8

_ROUNDS = 50  # of Newton's method, which needs some ten for a lens that can be inverted
_EXACT = 1e-12  # greatest residual on the plane at a distance of 1


@dataclass(frozen=True, slots=True)
class Lens:
    """Intrinsics of a camera, in pixels; the middle of the first pixel is (0, 0)."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...]  # k1, k2, p1, p2, k3

    @classmethod
    def of(cls, section: Camera) -> Self:
        """Return the intrinsics of a scene's camera."""
        width, height = section.width_px, section.height_px
        focal_px = width / 2.0 / float(tan(math.radians(section.hfov_deg) / 2.0))
        fx, fy = section.focal_px or (focal_px, focal_px)
        cx, cy = section.principal_px or ((width - 1) / 2.0, (height - 1) / 2.0)
        return cls(width, height, fx, fy, cx, cy, section.distortion)

    @property
    def matrix(self) -> F8:
        """Camera matrix (3, 3)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def project(self, points_m: F8) -> F8:
        """Return pixels (n, 2), column and row, of points (n, 3) in the camera's axes with z above 0."""
        x, y = points_m[:, 0] / points_m[:, 2], points_m[:, 1] / points_m[:, 2]
        x, y = self._distort(x, y)[:2]
        return np.column_stack([self.fx * x + self.cx, self.fy * y + self.cy])

    def rays(self, columns: F8, rows: F8) -> F8:
        """Return unit directions (n, 3) in the camera's axes that reach places (n,), (n,) of the image.

        Raises InputError if the distortion cannot be inverted there.
        """
        goal_x, goal_y = (columns - self.cx) / self.fx, (rows - self.cy) / self.fy
        x, y = goal_x, goal_y
        if any(self.distortion):
            x, y = self._undistort(goal_x, goal_y)
        xyz = np.stack([x, y, np.ones_like(x)], axis=-1)
        return xyz / norm(xyz)[:, None]

    def _distort(self, x: F8, y: F8) -> tuple[F8, F8, F8, F8, F8]:
        """Return distorted places (n,), (n,) and the derivatives dx/dx, dx/dy = dy/dx and dy/dy.

        Brown, "Decentering distortion of lenses", Photogrammetric Engineering 32(3), 1966, in the signs of
        OpenCV (calib3d, "Camera calibration and 3D reconstruction").
        """
        k1, k2, p1, p2, k3 = self.distortion
        square = x * x + y * y
        radial = 1.0 + square * (k1 + square * (k2 + square * k3))
        growth = 2.0 * (k1 + square * (2.0 * k2 + square * (3.0 * k3)))  # of `radial`, per x and per y
        to_x = x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x)
        to_y = y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y
        x_by_x = radial + x * x * growth + 2.0 * p1 * y + 6.0 * p2 * x
        x_by_y = x * y * growth + 2.0 * p1 * x + 2.0 * p2 * y
        y_by_y = radial + y * y * growth + 6.0 * p1 * y + 2.0 * p2 * x
        return to_x, to_y, x_by_x, x_by_y, y_by_y

    def _undistort(self, goal_x: F8, goal_y: F8) -> tuple[F8, F8]:
        """Invert the distortion by Newton's method."""
        x, y = goal_x, goal_y
        for _ in range(_ROUNDS):
            to_x, to_y, x_by_x, x_by_y, y_by_y = self._distort(x, y)
            off_x, off_y = goal_x - to_x, goal_y - to_y
            determinant = x_by_x * y_by_y - x_by_y * x_by_y
            if not (determinant > 0.0).all():
                break
            if max(np.abs(off_x).max(), np.abs(off_y).max()) <= _EXACT:
                return x, y
            x = x + (y_by_y * off_x - x_by_y * off_y) / determinant
            y = y + (x_by_x * off_y - x_by_y * off_x) / determinant
        found = f"found {', '.join(f'{coefficient:g}' for coefficient in self.distortion)}"
        expected = "a distortion that maps no two rays to one place of the image"
        raise InputError("camera.distortion", found, expected)
