"""The `[motion.gait]` table: how the trunk of the person moves."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field

from vlp16emu.settings import Fraction, Preset

__all__ = ["Gait"]

_STILL = dict.fromkeys(
    (
        "vertical_m",
        "second_harmonic_m",
        "heel_strike_m",
        "sideways_m",
        "fore_aft_m",
        "roll_deg",
        "pitch_deg",
        "yaw_deg",
        "variation",
    ),
    0.0,
)

_PRESETS: Mapping[str, Mapping[str, float]] = {
    "none": _STILL,
    # Two plain sines (Lu et al., LiDAR-Forest, module 4).
    "paper": {**_STILL, "step_hz": 1.8, "vertical_m": 0.025, "sideways_m": 0.02},
    "natural": {},
    # A heavy pack on rough ground: about twice the natural, an assumption.
    "strong": {
        "vertical_m": 0.04,
        "second_harmonic_m": 0.006,
        "heel_strike_m": 0.003,
        "sideways_m": 0.045,
        "fore_aft_m": 0.02,
        "roll_deg": 4.0,
        "pitch_deg": 4.5,
        "yaw_deg": 7.0,
        "variation": 0.08,
    },
}

Angle = Annotated[float, Field(ge=0, le=45)]
Amplitude = Annotated[float, Field(ge=0, le=1)]


class Gait(Preset):
    """Amplitudes of the trunk's motion at walking speed; they fade as the person slows down.

    Defaults are those of `natural`.
    """

    presets = _PRESETS

    preset: Literal["none", "paper", "natural", "strong"] = "natural"
    """Values of the keys that are not given beside it; `natural` is their defaults."""
    step_hz: Annotated[float, Field(gt=0, le=5)] | None = None
    """Steps per second; from the walking speed where it is left out."""
    vertical_m: Amplitude = 0.023
    """Rise and fall, once per step; 4.6 cm from end to end (assumption)."""
    second_harmonic_m: Amplitude = 0.0015
    """Rise and fall, twice per step (assumption)."""
    heel_strike_m: Amplitude = 0.0007
    """Depth of the dip of 40 ms at each heel strike, 0.2 g at the trunk (assumption)."""
    sideways_m: Amplitude = 0.022
    """Sway, once per stride; 4.4 cm from end to end (assumption)."""
    fore_aft_m: Amplitude = 0.01
    """Lead and lag, once per step (assumption)."""
    roll_deg: Angle = 1.65
    """Once per stride; range 3.3 degrees (Chung et al., J NeuroEng Rehabil 7:9, 2010, global obliquity)."""
    pitch_deg: Angle = 2.0
    """Once per step; range 4.0 degrees (Chung et al., 2010, global tilt)."""
    yaw_deg: Angle = 3.45
    """Once per stride; range 6.9 degrees (Chung et al., 2010, global rotation)."""
    variation: Fraction = 0.04
    """Standard deviation of stride times, and of amplitudes, as a share of them; a healthy walker's stride times
    varied by 4 % in nine minutes (PhysioNet, Fractal mechanisms in neural control, figure 9)."""
