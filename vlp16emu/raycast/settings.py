"""The `[beam]` table: width of a pulse, and number of its rays."""

from typing import Annotated, Literal

from pydantic import Field

from vlp16emu.settings import Section

Millimetres = Annotated[float, Field(ge=0, le=100)]
Milliradians = Annotated[float, Field(ge=0, le=50)]


class Beam(Section):
    """The light of one pulse."""

    model: Literal["adaptive", "fixed", "none", "angle", "offset"] = "adaptive"
    """Rays of a pulse: as many sub-rays as needed (`adaptive`), always `rays` (`fixed`), or one ray along its
    centre (`none`). `angle` and `offset` are one ray with the beam errors of LiDAR-Forest (Lu et al.): a
    direction drawn from the profile, or a hit displaced inside the beam."""
    rays: Annotated[int, Field(ge=2, le=4096)] = 64
    """Sub-rays of a fixed beam, and their maximum for an adaptive one, which casts rounds of eight: best a
    multiple of eight, as an incomplete round gives the centre of the beam too much weight."""
    target_m: Annotated[float, Field(ge=0.0001, le=1)] = 0.05
    """Target of an adaptive beam for the mean error of the strongest echo's range; another echo in its place
    counts as the detector's resolution."""
    spot_mm: Annotated[tuple[Millimetres, Millimetres], Field(strict=False)] = (12.7, 9.5)
    """Beam width at the lens, horizontal and vertical, at 1/e2 of the centre."""
    divergence_mrad: Annotated[tuple[Milliradians, Milliradians], Field(strict=False)] = (3.0, 1.5)
    """Growth of that width with distance: full angle, horizontal and vertical (VLS-128 manual, table F-1)."""

    @property
    def summary(self) -> str:
        """The active model in one line."""
        followed = {
            "adaptive": f"at most {self.rays} sub-rays, error of {1e3 * self.target_m:g} mm aimed at",
            "fixed": f"{self.rays} sub-rays",
            "none": "one ray, without width",
            "angle": "one ray, its direction drawn",
            "offset": "one ray, its hit displaced",
        }
        text = f"{self.model}: {followed[self.model]}"
        if self.model == "none":
            return text
        spot, divergence = (f"{w:g} x {h:g}" for w, h in (self.spot_mm, self.divergence_mrad))
        return f"{text}, {spot} mm and {divergence} mrad wide"
