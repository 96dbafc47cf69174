"""The `[noise]` table: the errors of a unit."""

from typing import Annotated, Literal

from pydantic import Field

from vlp16emu.settings import Positive, Preset

__all__ = ["Noise"]

_Degrees = Annotated[float, Field(ge=0, le=1)]
_Metres = Annotated[float, Field(ge=0, le=0.1)]
_PRESETS: dict[str, dict[str, object]] = {
    "ideal": {
        "range_noise_m": 0.0,
        "range_bias_m": 0.0,
        "elevation_error_deg": 0.0,
        "azimuth_error_deg": 0.0,
        "reflectivity_noise": 0.0,
        "gain_spread": 0.0,
        "weak_echoes_lost": False,
    },
    "typical": {},
    # Two sigmas of both together are the +-3 cm of the data sheet.
    "datasheet": {"range_noise_m": 0.011, "range_bias_m": 0.010},
}


class Noise(Preset):
    """Errors of range and reflectivity, and what is lost for want of light."""

    presets = _PRESETS

    preset: Literal["ideal", "typical", "datasheet"] = "typical"
    """Values of the keys that are not given beside it; `typical` is their defaults."""
    range_noise_m: _Metres = 0.0065
    """White, one sigma, at a reflectivity of 20; measured on a real unit."""
    range_bias_m: _Metres = 0.010
    """Constant error per laser, one sigma; assumption within the 3 cm of the data sheet, at which it is cut."""
    elevation_error_deg: _Degrees = 0.02
    """By how much each laser of a unit looks too high or low, one sigma; assumption."""
    azimuth_error_deg: _Degrees = 0.02
    """The same to the side, one sigma; assumption."""
    warm_up_m: Annotated[float, Field(ge=-0.1, le=0.1)] = 0.0
    """How much too long ranges are at power-up; no measurement is known."""
    warm_up_s: Positive = 900.0
    """Time constant with which that fades."""
    reflectivity_noise: Annotated[float, Field(ge=0, le=20)] = 1.5
    """White, one sigma, in counts; real units show 1 to 2."""
    gain_spread: Annotated[float, Field(ge=0, le=0.3)] = 0.03
    """Relative error of reflectivity per laser, one sigma; assumption."""
    weak_echoes_lost: bool = True
    """Whether there is a detection threshold, as `[detector]` has it."""
    no_return_reflectivity: bool = False
    """Whether records without a return carry a constant of their laser, as on real units; the manual has 0 there."""

    @property
    def summary(self) -> str:
        """The active model in one line."""
        parts = [
            f"{1e3 * self.range_noise_m:g} mm white",
            f"{1e3 * self.range_bias_m:g} mm bias per laser",
            f"{max(self.elevation_error_deg, self.azimuth_error_deg):g} deg",
            f"{self.reflectivity_noise:g} counts and {100 * self.gain_spread:g} % on reflectivity",
            "weak echoes lost" if self.weak_echoes_lost else "every echo seen",
        ]
        if self.warm_up_m:
            parts.append(f"{1e3 * self.warm_up_m:g} mm warm-up over {self.warm_up_s:g} s")
        if self.no_return_reflectivity:
            parts.append("reflectivity on no-returns")
        return f"{self.preset}: " + ", ".join(parts)
