"""The `[detector]`, `[noise]` and `[weather]` tables: detection of echoes, errors, and fog and rain.

Also the constants for the kernels of this package, which are computed from them.
"""

from collections.abc import Mapping
from typing import Annotated, Literal, NamedTuple, Self

from pydantic import Field

from vlp16emu.settings import Preset, Section

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
    # Measured on captures of real units: protocol/README.md, "The character of a unit".
    "unit": {
        "range_noise_m": 0.0038,
        "range_beat_m": 0.006,
        "reflectivity_noise": 0.2,
        "reflectivity_noise_share": 0.031,
        "reflectivity_step": 1.95,
        "unit_spread": 0.15,
        "reflectivity_far_step": 1.45,
        "range_counts": True,
        "no_return_reflectivity": True,
        "no_return_wander": 1.5,
        "records_lost": 1.0,
        "gain_spread": 0.04,
        "gain_by_range": 0.13,
    },
}


class Detector(Section):
    """Properties of the receiver, the same for all units."""

    pulse_ns: Annotated[float, Field(ge=1, le=20)] = 6.0
    """Full width of a pulse at half maximum; not in the data sheet (assumption, 5 ns in other simulators)."""
    resolution_m: Annotated[float, Field(ge=0, le=10)] = 1.4
    """Echoes closer to each other are merged; gaps of a VLP-16 begin here: protocol/README.md, "The character
    of a unit"."""
    range_at_10_percent_m: Annotated[float, Field(ge=1, le=500)] = 40.0
    """Range at which a perpendicular target of 10 % that fills the beam is detected every second time.
    Assumption: a white wall is then detected up to 126 m, a leaf of 50 % up to 89 m; the data sheet gives 100
    m without a reflectivity."""
    threshold_snr: Annotated[float, Field(ge=3, le=20)] = 6.0
    """Signal over noise at the detection threshold. Assumption: noise alone passes it once in some 1e9
    samples."""


class Noise(Preset):
    """Errors of range and reflectivity, and the detection threshold."""

    presets = _PRESETS

    preset: Literal["ideal", "typical", "datasheet", "unit"] = "unit"
    """Values of all keys that are not set: `typical` has only white errors and constant errors per laser.
    `unit` draws a unit like the measured ones, and has two more of their properties: heavy tails of white
    errors of reflectivity, and ranges that depend slightly on reflectivity."""
    range_noise_m: _Metres = 0.0065
    """White range noise, one sigma, at a reflectivity of 20 on an even surface; it falls with the eighth root
    of the reflectivity, as on four real units. With `preset = "unit"` it is 1.8 to 2.6 times as large at 2 as
    at 20, by unit, and up to 2.4 times as large where the brightness changes from pulse to pulse."""
    range_beat_m: Annotated[float, Field(ge=0, le=0.02)] = 0.0
    """Amplitude of the error that repeats every five pulses of 2.304 us, the same for all lasers and ranges;
    4 to 7 mm on real units. Units differ by a third, and in phase. 0 switches it off."""
    range_beat_phase_deg: Annotated[float, Field(ge=0, lt=360)] | None = None
    """Phase of that error at the first pulse, for a unit whose amplitude is exactly `range_beat_m`; random if
    not set."""
    range_bias_m: _Metres = 0.010
    """Constant range error per laser, one sigma; assumption within the 3 cm of the data sheet, to which it is
    clipped."""
    elevation_error_deg: _Degrees = 0.02
    """Elevation error of each laser of a unit, one sigma; assumption."""
    azimuth_error_deg: _Degrees = 0.02
    """Azimuth error of each laser of a unit, one sigma; assumption."""
    warm_up_m: Annotated[float, Field(ge=-0.1, le=0.1)] = 0.0
    """Range error at power-up; 37 % of it remains after 900 s. No measurement is known."""
    reflectivity_noise: Annotated[float, Field(ge=0, le=20)] = 1.5
    """White reflectivity noise, one sigma, in counts; real units show 1 to 2."""
    reflectivity_noise_share: Annotated[float, Field(ge=0, le=0.2)] = 0.0
    """White noise as a share of the reflectivity, added to `reflectivity_noise`; 0.03 to 0.04 on real
    units."""
    reflectivity_step: Annotated[float, Field(ge=0, le=10)] = 0.0
    """Spacing of reflectivity codes at 90, less for darker ones; 2 to 2.5 on real units. Up to 1 sends every
    code."""
    unit_spread: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Unit-to-unit spread of the white errors, one sigma of the logarithm. 0 for exactly the set values."""
    reflectivity_far_step: Annotated[float, Field(ge=0, le=8)] = 0.0
    """Median over lasers of the spacing of reflectivity codes beyond 8 m: 1.2 to 1.8 on real units, whose
    codes are strengths of echoes, as integers, times eighths that depend on laser and range, 1 to 2.75
    there. It is about 1 at 1 to 3 m, and up to 4 at 0.5 m; the gain of a laser follows it. 0 sends every code
    at all ranges, without that gain."""
    range_counts: bool = False
    """True if ranges are counts of 4 mm plus a correction in steps of 2 mm by laser and count of the
    receiver, as on real units: neighbours of one count then differ by a multiple of 4 mm."""
    gain_spread: Annotated[float, Field(ge=0, le=0.3)] = 0.03
    """Relative error of reflectivity per laser at all ranges, one sigma, as far as neighbours in elevation
    differ; with what changes with range 0.057 to 0.097 on real units at 1 to 2.5 m."""
    gain_by_range: Annotated[float, Field(ge=0, le=0.5)] = 0.0
    """Relative error of reflectivity per laser that changes with range, one sigma, beside what follows the
    spacing of codes; both together have 0.18 on real units."""
    records_lost: Annotated[float, Field(ge=0, le=2)] = 0.0
    """Factor on the loss of records at steps of brightness or range; 1 for the random rates of real units, 0
    for none. With a `unit_spread` of 0 the rates are those of a median unit."""
    spots_lost: Annotated[float, Field(ge=0, le=4)] | None = None
    """The same for places that lose the same records in each revolution: dark, near and uneven ones;
    `records_lost` if not set."""
    weak_echoes_lost: bool = True
    """True to apply the detection threshold of `[detector]`."""
    no_return_reflectivity: bool = False
    """True if records without a return carry a constant of their laser, as on real units; the manual gives
    0."""
    no_return_level: Annotated[float, Field(gt=0, le=100)] | None = None
    """Median of that constant over the lasers; random from 1.5 to 20 if not set."""
    no_return_wander: Annotated[float, Field(ge=0, le=20)] = 0.0
    """Number of multiples of that constant that records take, for a median real unit; 0 for none."""

    @property
    def is_real(self) -> bool:
        """True if the unit has those errors of real units that have no key."""
        return self.preset == "unit"

    @property
    def in_spots(self) -> float:
        """Factor on the loss of records at places of a surface."""
        return self.records_lost if self.spots_lost is None else self.spots_lost

    def of_model(self, values: Mapping[str, object]) -> Self:
        """Return the noise of a model with other values in the preset `unit`; what a scene sets stays."""
        unit = self.presets["unit"]
        still = {key: value for key, value in values.items() if getattr(self, key) == unit[key]}
        return self.model_copy(update=still) if self.is_real else self

    @property
    def _scatter(self) -> str:
        share = [f"{100 * self.reflectivity_noise_share:g} % white"] if self.reflectivity_noise_share else []
        counts = [f"{self.reflectivity_noise:g} counts"] if self.reflectivity_noise or not share else []
        return ", ".join(counts + share)

    @property
    def summary(self) -> str:
        """Active model in one line."""
        parts = [
            f"{1e3 * self.range_noise_m:g} mm white",
            f"{1e3 * self.range_bias_m:g} mm bias per laser",
            f"{max(self.elevation_error_deg, self.azimuth_error_deg):g} deg",
            *([f"{1e3 * self.range_beat_m:g} mm beat"] if self.range_beat_m else []),
            f"{self._scatter} and {100 * self.gain_spread:g} % on reflectivity",
            "weak echoes lost" if self.weak_echoes_lost else "every echo seen",
        ]
        if self.warm_up_m:
            parts.append(f"{1e3 * self.warm_up_m:g} mm warm-up")
        if self.no_return_reflectivity:
            parts.append("reflectivity on no-returns")
        return f"{self.preset}: " + ", ".join(parts)


class Weather(Section):
    """Fog and rain; the air is clear without these keys."""

    visibility_m: Annotated[float, Field(ge=10, le=100_000)] | None = None
    """Meteorological visibility; fog below 1000 m, haze below 10 km."""
    rain_mm_h: Annotated[float, Field(ge=0, le=200)] = 0.0
    """Rate of rain: 2.5 light, 10 heavy, 50 violent."""

    @property
    def summary(self) -> str | None:
        """Fog and rain in one line; None in clear air."""
        parts = []
        if self.visibility_m is not None:
            parts.append(f"visibility {self.visibility_m:g} m")
        if self.rain_mm_h:
            parts.append(f"rain of {self.rain_mm_h:g} mm/h")
        return ", ".join(parts) or None


class LossRates(NamedTuple):
    """Rates at which a unit loses records, see `vlp16emu.returns.lost`; 0 for none."""

    step: float
    up: float
    down: float
    dark: float
    gloss: float  # of records at places of uneven brightness
    raise_code: float  # code of a return next to which half of the no-returns are raised; 0 for none
    bright: float  # at a step up by 100 codes, for any factor
    again: float  # of records that follow a lost one


class DetectorConstants(NamedTuple):
    """Constants of a unit's receiver in the weather of a run, in the form that compiled code takes.

    Amplitudes of a waveform are reflectance times cosine of incidence over the square of the range, in m-2.
    """

    seed: int
    strongest_only: bool
    min_range_m: float
    max_range_m: float
    sigma_m: float  # standard deviation of a pulse, in range
    resolution_m: float
    threshold: float  # amplitude that is detected with probability one half; 0 if every echo is detected
    amplitude_noise: float  # one sigma; 0 if every echo is detected
    extinction_per_m: float  # 0 in clear air
    clutter: float  # reflectance of the air that a pulse fills
    least_clutter: float  # amplitude below which the echo of the air is ignored
    range_noise_m: float
    bright_noise: float  # parts of its variance, as in `range_noise_parts`
    dark_noise: float
    reflectivity_noise: float
    reflectivity_noise_share: float
    heavy_tails: bool  # of reflectivity
    range_walk_m: float  # per code of reflectivity
    lost: LossRates
