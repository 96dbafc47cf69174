"""Cameras without distortion: rays through pixels, pixels of points, and what the rays meet."""

import math
from dataclasses import dataclass
from enum import StrEnum
from itertools import product
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vlp16emu.errors import InputError
from vlp16emu.raycast.caster import Geometry
from vlp16emu.types import F4, F8, I8, NO_SURFACE, U1, U4, Firings

Pixels = tuple[I8, I8, F8]
"""Columns, rows and nearness (n,) of points; of two points at a pixel the one of greater nearness hides the other."""

_LARGEST_PX = 16_384
_ALL_ROUND_DEG = 360.0


class CameraKind(StrEnum):
    """Projection of directions to pixels."""

    PANORAMA = "panorama"  # all around, the same angle for each column and row (equirectangular)
    PINHOLE = "pinhole"  # a plane at right angles to the optical axis, which is the sensor's azimuth 0


_DEFAULTS = {CameraKind.PANORAMA: ((2048, 512), _ALL_ROUND_DEG), CameraKind.PINHOLE: ((1024, 768), 90.0)}
"""Size in pixels, and field of view."""


@dataclass(frozen=True, slots=True)
class Camera:
    """A camera at one point, z forward, x right, y down; its principal point is the middle of its image.

    InputError if size and field of view do not suit the kind.
    """

    kind: CameraKind
    width: int  # pixels, a multiple of 8, as rows are cast eight rays at a time
    height: int
    fov_deg: float  # from the left edge to the right one; 360 of a panorama

    def __post_init__(self) -> None:
        size, is_panorama = f"found {self.width}x{self.height}", self.kind is CameraKind.PANORAMA
        if self.width % 8 or not 8 <= self.width <= _LARGEST_PX or not 1 <= self.height <= _LARGEST_PX:
            raise InputError("--size", size, f"at most {_LARGEST_PX} pixels, the width a multiple of 8")
        if is_panorama and 2 * self.height > self.width:
            raise InputError("--size", size, "a panorama at most half as high as wide, which is the sphere")
        if is_panorama != (self.fov_deg == _ALL_ROUND_DEG) or not (is_panorama or 1 <= self.fov_deg <= 170):
            expected = "360 of a panorama" if is_panorama else "a number of degrees from 1 to 170"
            raise InputError("--fov", f"found {self.fov_deg:g}", expected)

    @classmethod
    def of(cls, kind: str, size: tuple[int, int] | None = None, fov_deg: float | None = None) -> Self:
        """Make a camera of a kind, with the kind's default size and field of view for what is None."""
        if kind not in tuple(CameraKind):
            raise InputError("--kind", f"found {kind}", " or ".join(CameraKind))
        default_px, default_deg = _DEFAULTS[CameraKind(kind)]
        return cls(CameraKind(kind), *(size or default_px), default_deg if fov_deg is None else fov_deg)

    @property
    def focal_px(self) -> float:
        """Focal length: pixels per unit of X/Z of a pinhole camera, per radian of a panorama."""
        half_rad = math.radians(self.fov_deg) / 2
        return self.width / 2 / (math.tan(half_rad) if self.kind is CameraKind.PINHOLE else half_rad)

    def rays(self, rows: range) -> F8:
        """Return unit directions (rows * width, 3) in the camera's frame through the middles of pixels, row by row."""
        u = (np.arange(self.width) + 0.5 - self.width / 2) / self.focal_px
        v = (np.array(rows)[:, None] + 0.5 - self.height / 2) / self.focal_px
        u, v = np.broadcast_arrays(u, v)
        if self.kind is CameraKind.PINHOLE:
            xyz = np.stack([u, v, np.ones_like(u)], axis=-1)
            xyz /= np.linalg.norm(xyz, axis=-1, keepdims=True)
        else:
            xyz = np.stack([np.cos(v) * np.sin(u), np.sin(v), np.cos(v) * np.cos(u)], axis=-1)
        return xyz.reshape(-1, 3)


@dataclass(frozen=True, slots=True)
class Orthographic:
    """A camera of parallel rays: lengths across the view have one scale everywhere."""

    axes: F8  # (3, 3) unit vectors to the right, upwards in the image, and towards the eye
    centre_m: F8  # (3,) place at the middle of the image, along these axes; rays begin there
    px_per_m: float
    size: tuple[int, int]  # width and height in pixels

    @classmethod
    def around(cls, box_m: F8, from_deg: float, elevation_deg: float, size: tuple[int, int]) -> Self:
        """Look at a box with corners (2, 3) from a bearing, clockwise from north, and an elevation; the box fills the image."""
        a, e = math.radians(from_deg), math.radians(elevation_deg)
        right = np.array([-math.cos(a), math.sin(a), 0.0])
        back = np.array([math.sin(a) * math.cos(e), math.cos(a) * math.cos(e), math.sin(e)])
        axes = np.stack([right, np.cross(back, right), back])
        seen_m = np.array(list(product(*box_m.T))) @ axes.T
        low_m, high_m = seen_m.min(axis=0), seen_m.max(axis=0)
        scale = min(size[0] / (high_m[0] - low_m[0]), size[1] / (high_m[1] - low_m[1]))
        return cls(axes, (low_m + high_m) / 2, float(scale), size)

    def pixels(self, places_m: F8) -> Pixels:
        """Return the pixels of places (n, 3); nearness is in metres."""
        right, up, near = ((places_m @ self.axes.T) - self.centre_m).T
        column = np.floor(self.size[0] / 2 + right * self.px_per_m).astype(np.int64)
        return column, np.floor(self.size[1] / 2 - up * self.px_per_m).astype(np.int64), near

    def rays(self, rows: range) -> tuple[F8, F8]:
        """Return origins (rows * width, 3) of rays through the middles of pixels, row by row, and their direction (3,)."""
        right_m = (np.arange(self.size[0]) + 0.5 - self.size[0] / 2) / self.px_per_m
        up_m = (self.size[1] / 2 - np.array(rows)[:, None] - 0.5) / self.px_per_m
        along_m = np.stack([*np.broadcast_arrays(right_m, up_m), np.zeros((len(rows), self.size[0]))], axis=-1)
        return (along_m + self.centre_m).reshape(-1, 3) @ self.axes, -self.axes[2]


class Seen(NamedTuple):
    """Surfaces that n rays meet."""

    is_met: NDArray[np.bool_]  # (n,)
    range_m: F4  # (n,) 0 where nothing is met
    surface: U4  # (n,) row of the geometry's table; `NO_SURFACE` where nothing is met
    cos_incidence: F4  # (n,)

    def rgb(self, colours: U1, light: ArrayLike, background: ArrayLike) -> F8:
        """Return colours (n, 3): those of the surfaces (m, 3) times `light` (n,), the background where nothing is met."""
        rows = np.where(self.is_met, self.surface, 0)
        lit = colours[rows] * np.asarray(light)[..., None]
        return np.where(self.is_met[:, None], lit, background)


def look(geometry: Geometry, origin_m: F8, direction: F8, far_m: float, *, near_m: float = 0.0, t_ns: int = 0) -> Seen:
    """Cast n rays, a multiple of 8, whose origins and directions broadcast to (n, 3)."""
    rays = Firings.rays(t_ns, *(np.atleast_2d(of)[:, None] for of in (origin_m, direction)))
    hits = geometry.cast(rays, np.array([near_m]), far_m)
    is_met = hits.surface != NO_SURFACE
    return Seen(is_met, np.where(is_met, hits.range_m, np.float32(0.0)), hits.surface, hits.cos_incidence)
