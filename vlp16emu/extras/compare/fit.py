"""Settings of the unit that made a capture."""

import math

import numpy as np
from pydantic import ValidationError

from vlp16emu.errors import InputError
from vlp16emu.explain import explain
from vlp16emu.extras.compare.losses import records_lost, spots_lost
from vlp16emu.extras.compare.sequences import Sequences
from vlp16emu.extras.compare.statistics import (
    Statistics,
    Stretches,
    beat_of,
    commonest,
    local,
    statistics_of,
    stretches_of,
    turning_of,
)
from vlp16emu.extras.compare.steps import far_factor
from vlp16emu.packets.layout import BLOCK_PERIOD_NS
from vlp16emu.returns import Noise
from vlp16emu.returns.noise import range_noise_parts
from vlp16emu.sensor.settings import MOST_OFF_RPM, RPM_STEP, Sensor, set_rpm

_EVEN_CDEG2 = 0.111
_PER_RATE_CDEG2 = 3.55
"""Local variance of encoder readings without rate error, and the variance that the error adds: from our own
packets at 540 to 660 rpm."""
_LEVEL = 80.0  # middle of the reflectivities whose neighbours are compared
_EQUAL_STEPS = 3.1
_COARSEST = 5.0
_FROM = 30.0
_TOP = 90.0
"""Step of bright codes over the product of their scatter and the share of equal neighbours, from our own
packets; greatest step; reflectivities at which the step is 1 and at which the key gives it."""
_STEPS = (1.0, 1.25, 1.5, 1.95, 2.5, 3.5)
_RUGGEDNESS = (1.24, 1.74, 1.98, 2.46, 3.0, 3.73)
"""Steps at 90, and the ruggedness of bright codes that they give, from our own packets."""
_OTHER_MM = (
    2.1  # white error from the detector and the codes of a range, beside the setting; from our packets
)
_EVEN_SCATTER = 0.06  # greatest scatter over the level of even surfaces
_LEAST_EVEN = 10.0  # their levels
_MOST_EVEN = 90.0
_SET_AT = 20.0  # level of the setting
_FREE_SHARE = 15.0 / 11.0  # pulses of a stretch over those less the parameters of a cubic
_COUNTS_EVEN = 0.65  # 0.5 where each range has its own code of 2 mm, 0.77 to 0.95 on real units
_CONSTANT_GAIN = 0.36
_GAIN_BY_RANGE = 1.18
"""Shares of the spread of gains over lasers, as both kinds of sectors show it: keys of our own packets over
their statistic. One capture does not separate them."""
_LEAST_SILENT = 50
_MOST_LOST = 2.0
_MOST_IN_SPOTS = 4.0
_HALF_DEG_PER_US = 0.0018  # half of the turn of a rotor at 600 rpm in a microsecond


def fit_settings(sequences: Sequences) -> dict[str, dict[str, object]]:
    """Return the `[noise]` and `[sensor]` keys of the unit that made a capture, within the limits of a scene.

    For quantities that a unit draws with its seed, such as the gain of each laser and the rates of lost
    records, the keys are spreads. Biases of the lasers are not included: they need a target at a known place.
    InputError if a value is beyond the limits of a unit.
    """
    found = statistics_of(sequences)
    noise = _noise(sequences, found)
    sensor = _rotor(sequences, found)
    for section, table in ((Noise, noise), (Sensor, sensor)):
        try:
            section.model_validate(table)
        except ValidationError as error:
            raise InputError(*explain(error, section.model_json_schema())) from None
    return {"noise": noise, "sensor": sensor}


def _noise(sequences: Sequences, found: Statistics) -> dict[str, object]:
    """Return the `[noise]` keys."""
    out: dict[str, object] = {"preset": "unit", "unit_spread": 0.0}
    if (stretches := stretches_of(sequences)) is not None:
        sine, _ = beat_of(stretches)
        if (own_mm := _own_white_mm(stretches)) is None:
            own_mm = math.sqrt(max(found["range.white_at_20_mm"] ** 2 - _OTHER_MM**2, 0.0))
        out["range_noise_m"] = round(own_mm * 1e-3, 5)
        out["range_beat_m"] = round(float(abs(sine)) * 1e-3, 5)
        out["range_beat_phase_deg"] = round(float(np.degrees(np.angle(sine))) % 360.0, 1) % 360.0
    if scatter := found.get("reflectivity.scatter_60_99"):
        counts = Noise().reflectivity_noise
        out["reflectivity_noise_share"] = round(max(scatter - counts, 0.0) / _LEVEL, 4)
        out["reflectivity_step"] = round(_step_of_bright_codes(found, scatter), 2)
    if "residue.even_at_equal_codes" in found:
        out["range_counts"] = found["residue.even_at_equal_codes"] > _COUNTS_EVEN
    if "reflectivity.gain_spread" in found:
        spread = found["reflectivity.gain_spread"]
        out["gain_spread"] = round(min(_CONSTANT_GAIN * spread, 0.3), 3)
        out["gain_by_range"] = round(min(_GAIN_BY_RANGE * spread, 0.5), 3)
    if (lost := records_lost(sequences, _MOST_LOST)) is not None:
        out["records_lost"] = round(lost, 2)
    if (spots := spots_lost(sequences, _MOST_IN_SPOTS)) is not None:
        out["spots_lost"] = round(spots, 2)
    if (factor := far_factor(sequences)) is not None:
        out["reflectivity_far_step"] = round(factor, 2)
    if "no_return.above_0" in found:
        out["no_return_reflectivity"] = found["no_return.above_0"] > 0.5
        silent = sequences.distance_lsb == 0
        enough = silent.sum(axis=0) >= _LEAST_SILENT
        if enough.any():  # median over the lasers of the commonest no-return code; codes are clipped
            level = float(np.median(commonest(silent, sequences.reflectivity)[enough])) + 0.5
            out["no_return_level"] = round(level, 1)
    return out


def _step_of_bright_codes(found: Statistics, scatter: float) -> float:
    """Return the step of codes at 90: from their histogram, with few ones from equal neighbours."""
    if (ruggedness := found.get("reflectivity.comb")) is not None:
        return float(np.interp(ruggedness, _RUGGEDNESS, _STEPS))
    # The share of equal neighbours after rounding depends on the step over the scatter.
    step = _EQUAL_STEPS * scatter * found["reflectivity.equal_60_99"]
    at_top = 1.0 + (step - 1.0) * (_TOP - _FROM) / (_LEVEL - _FROM)
    return min(max(at_top, 0.0), _COARSEST)


def _own_white_mm(stretches: Stretches) -> float | None:
    """Return the white range noise on surfaces of even brightness, at code 20; None without such surfaces."""
    level = stretches.level
    scatter = np.sqrt((stretches.code_residual**2).mean(axis=1)) / np.maximum(level, 1.0)
    chosen = (scatter < _EVEN_SCATTER) & (level >= _LEAST_EVEN) & (level < _MOST_EVEN)
    if not chosen.any():
        return None
    variance = (stretches.white_mm[chosen] ** 2).mean(axis=1) * _FREE_SHARE
    bright, dark = range_noise_parts(0, Noise(preset="unit", unit_spread=0.0))
    darker = _SET_AT / level[chosen]
    over_set = bright * np.sqrt(np.sqrt(darker)) + dark * darker
    return float(np.median(np.sqrt(np.maximum(variance - _OTHER_MM**2, 0.0) / over_set)))


def _rotor(sequences: Sequences, found: Statistics) -> dict[str, object]:
    """Return the `[sensor]` keys; InputError if the speed is not that of a unit."""
    turning = turning_of(sequences)
    rpm = set_rpm(sequences.rpm)
    once = turning.once_cdeg
    twice = turning.twice_cdeg
    off_rpm = (sequences.rpm - rpm) * 600.0 / rpm
    if abs(off_rpm) > MOST_OFF_RPM:
        expected = f"a speed of a unit within {MOST_OFF_RPM:g} rpm at 600"
        raise InputError("speed_error_rpm", f"a mean speed of {sequences.rpm:.1f} rpm", expected)
    model = sequences.layout.model.name
    out: dict[str, object] = {
        **({} if model == Sensor().model else {"model": model}),
        "preset": "unit",
        "rotation_spread": 0.0,
        "rpm": rpm,
        "return_mode": "dual" if sequences.is_dual else "strongest",
        "eccentricity_deg": round(abs(once) / 100, 4),
        "eccentricity_phase_deg": round(math.degrees(math.atan2(-once.real, once.imag)) % 360.0, 1) % 360.0,
        "twice_per_turn_deg": round(abs(twice) / 100, 4),
        "hum_deg": round(max(found["rotation.tick_us"], 0.0) * _HALF_DEG_PER_US, 5),
    }
    if abs(rpm - 600) <= RPM_STEP and sequences.layout.reading_ns == BLOCK_PERIOD_NS:
        excess_cdeg2 = max(local(turning.rest_cdeg).var() - _EVEN_CDEG2, 0.0)
        out["encoder_rate_error"] = round(min(math.sqrt(excess_cdeg2 / _PER_RATE_CDEG2), 0.5), 3)
    out["speed_error_rpm"] = round(off_rpm, 3)
    if "clock.error_ppm" in found:
        out["clock_error_ppm"] = round(found["clock.error_ppm"], 2)
    return out
