"""The ground that a path leads over and the world around it: the contract of all worlds with the engine."""

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:  # scenes are read without numpy
    import numpy as np
    from numpy.typing import NDArray

    from vlp16emu.types import Window, World
    from vlp16emu.world.settings import Wind


class Sway(Protocol):
    """Moving things of a world."""

    def with_sway(self, window: "Window", track_m: "NDArray[np.float64]", start_ns: int, stop_ns: int) -> "Window":
        """Return the window of sensor positions (n, 3) with its sway between two UTC instants."""


class Site(Protocol):
    """The ground of a world, before the path that leads over it is known."""

    @property
    def name(self) -> str:
        """Digest of all that decides the ground."""

    @property
    def origin_m(self) -> tuple[float, float, float]:
        """Easting, northing and height in maps that are (0, 0, 0) in the world."""

    @property
    def obstacles(self) -> "tuple[NDArray[np.float64], NDArray[np.float64]] | None":
        """Places (n, 2) that way points lead around, and how far (n,) from each; None if paths keep their way."""

    def height_m(self, x_m: "NDArray[np.float64]", y_m: "NDArray[np.float64]") -> "NDArray[np.float64]":
        """Height of the ground over places."""

    def world(
        self, path_xy_m: "NDArray[np.float64]", *, reach_m: float, farthest_m: float, wind: "Wind | None", start_ns: int
    ) -> "tuple[World, Sway | None]":
        """Return the world around a path, and what moves in it; None in still air.

        Raises GeometryError if the world cannot be made as it is written, or ends within reach.

        Parameters
        ----------
        path_xy_m : (n, 2) path of the sensors
        reach_m : from there, how far they see
        farthest_m : range of the one that sees farthest
        start_ns : UTC of the first pulse
        """
