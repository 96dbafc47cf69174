"""The table `[motion]` of a scene whose poses arrive while it is streamed."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from vlp16emu.motion.settings import MotionSection
from vlp16emu.settings import Place, SceneFile

if TYPE_CHECKING:  # scenes are read without numpy
    from vlp16emu.motion.pose import Motion
    from vlp16emu.types import F8
    from vlp16emu.world.settings import Site

_Place = Annotated[tuple[Place, Place], Field(strict=False)]


class Live(MotionSection):
    """Poses that arrive while the run is streamed, from a simulator, motion capture or a joystick."""

    kind: Literal["live"]
    """Selects poses that arrive during the run."""
    path_m: Annotated[list[_Place], Field(min_length=1, default_factory=lambda: [(0.0, 0.0)])]
    """x and y of one or more places where the body is expected. No plant is on the line through them; the
    body may be anywhere."""
    smoothing_s: Annotated[float, Field(ge=0.005, le=1)] = 0.02
    """Time constant with which the body follows the poses. It lags by the square of this times the
    acceleration; at constant speed there is no lag."""
    flown: SceneFile | None = None
    """Table that a stream has written with `--flown`: the run is repeated byte for byte, and no poses are
    read."""

    @property
    def takes_poses(self) -> bool:
        """True if poses are read from outside, not from a table."""
        return self.flown is None

    # The body flies over any ground.
    def carrier(self, site: "Site", *, start_ns: int, **_: object) -> "tuple[Motion, F8]":  # noqa: ARG002
        """Return the motion that follows the poses, and `path_m`."""
        import numpy as np

        from vlp16emu.extras.live.flown import FlownMotion
        from vlp16emu.extras.live.motion import LiveMotion

        path_m = np.array(self.path_m)
        if self.flown is None:
            return LiveMotion(self, start_ns=start_ns), path_m
        return FlownMotion(Path(self.flown), start_ns=start_ns), path_m
