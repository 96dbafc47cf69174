"""Footprints for casters that take rays one after the other: simple, and the twin of the fast kernel."""

from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from vlp16emu.raycast.adaptive import enough, first_round, judged_to
from vlp16emu.raycast.footprint import LINE, ROUND, BeamModel, Footprint, displace, sub_rays
from vlp16emu.types import Firings, Hits, Window

__all__ = ["Met", "SlowScene", "cast_slowly"]

Met = tuple[NDArray[np.float32], NDArray[np.uint32], NDArray[np.float32]]
"""Range, surface and cosine of incidence (n,) of n rays, as in `Hits`."""
_Cast = Callable[[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]], Met]
"""Casts rays: origin (n, 3) and direction (n, 3) in the world, near limit (n,) in metres, UTC (n,)."""


class SlowScene(ABC):
    """A window whose rays are cast one after the other."""

    def __init__(self, window: Window) -> None:
        self._origin_m = window.origin_m
        self.surfaces = window.surfaces

    def cast(
        self,
        firings: Firings,
        near_m: NDArray[np.float64],
        far_m: float,
        beam: Footprint = LINE,
        block: int | None = None,
    ) -> Hits:
        """Cast pulses; the arguments are those of `EmbreeScene.cast`."""

        def cast(
            origin_m: NDArray[np.float64],
            direction: NDArray[np.float64],
            near: NDArray[np.float64],
            t_ns: NDArray[np.int64],
        ) -> Met:
            """Cast rays from origins in the world."""
            return self._rays(origin_m - self._origin_m, direction, near, far_m, t_ns)

        return cast_slowly(cast, firings, near_m, beam, self.surfaces, block)

    @abstractmethod
    def _rays(
        self,
        origin_m: NDArray[np.float64],
        direction: NDArray[np.float64],
        near: NDArray[np.float64],
        far_m: float,
        t_ns: NDArray[np.int64],
    ) -> Met:
        """Cast rays (n, 3) from origins relative to the window's."""


def cast_slowly(
    cast: _Cast,
    firings: Firings,
    near_m: NDArray[np.float64],
    beam: Footprint,
    surfaces: NDArray[np.void],
    block: int | None = None,
) -> Hits:
    """Cast pulses of any beam model; the arguments are those of `EmbreeScene.cast`.

    Parameters
    ----------
    surfaces : (m,) the window's, as in `SURFACE`
    """
    shape = firings.t_ns.shape
    near, t_ns = np.broadcast_to(near_m, shape), firings.t_ns
    none = np.zeros(shape, np.int64)
    match beam.model:
        case BeamModel.FIXED:
            met = cast(
                *sub_rays(firings, beam, none, none + beam.rays),
                np.repeat(near, beam.rays),
                np.repeat(t_ns, beam.rays),
            )
            return Hits(np.full(shape, beam.rays, np.uint16), *met)
        case BeamModel.ANGLE:
            met = cast(*sub_rays(firings, beam, none, none + 1), near.reshape(-1), t_ns.reshape(-1))
        case _:
            lines = firings.origin_m.reshape(-1, 3), firings.direction.reshape(-1, 3)
            met = cast(*lines, near.reshape(-1), t_ns.reshape(-1))
    range_m, surface, cosine = met[0].reshape(shape), met[1].reshape(shape), met[2].reshape(shape)
    if beam.model is BeamModel.OFFSET:
        displace(range_m, beam, firings.index)
    if beam.model is BeamModel.ADAPTIVE:
        return _by_rounds(cast, firings, near, beam, surfaces, (range_m, surface, cosine), block or shape[0])
    return Hits.one_ray_each(range_m, surface, cosine)


def _by_rounds(
    cast: _Cast,
    firings: Firings,
    near: NDArray[np.float64],
    beam: Footprint,
    surfaces: NDArray[np.void],
    middle: Met,
    block: int,
) -> Hits:
    """Cast sub-rays where the rays along the middles are not enough, a round of all pulses at a time."""
    done, reflectance = np.ones(near.shape, np.int64), np.ascontiguousarray(surfaces["reflectance"])
    judged = middle[0] <= judged_to(surfaces)
    judged_m, cosine = (
        np.where(judged, middle[0], np.float32(np.inf)),
        np.where(judged, middle[2], np.float32(0)),
    )
    wanted = first_round(firings, judged_m, cosine, beam, block).astype(np.int64)
    met: dict[tuple[int, ...], Met] = {
        (i, j): (middle[0][i, j : j + 1], middle[1][i, j : j + 1], middle[2][i, j : j + 1])
        for i, j in np.ndindex(near.shape)
    }
    while (asked := wanted - done).any():
        each = asked.reshape(-1)
        lines = sub_rays(firings, beam, done, wanted)
        fresh = cast(*lines, np.repeat(near, each), np.repeat(firings.t_ns, each))
        ends = np.cumsum(asked).reshape(near.shape)
        for pulse in zip(*(axis.tolist() for axis in np.nonzero(asked)), strict=True):
            part = slice(ends[pulse] - asked[pulse], ends[pulse])
            new = fresh[0][part], fresh[1][part], fresh[2][part]
            met[pulse] = _joined(met[pulse], new)
            done[pulse] = wanted[pulse]
            room = np.empty((2, beam.rays))
            if done[pulse] < beam.rays and not enough(
                *met[pulse], reflectance, beam.target_m, beam.resolution_m, room
            ):
                wanted[pulse] = min(done[pulse] + ROUND, beam.rays)
    return Hits(
        done.astype(np.uint16),
        np.concatenate([of[0] for of in met.values()]),
        np.concatenate([of[1] for of in met.values()]),
        np.concatenate([of[2] for of in met.values()]),
    )


def _joined(a: Met, b: Met) -> Met:
    """Hits of two rounds of one pulse."""
    return np.concatenate([a[0], b[0]]), np.concatenate([a[1], b[1]]), np.concatenate([a[2], b[2]])
