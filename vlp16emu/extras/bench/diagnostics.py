"""Voltages, currents and temperatures inside the sensor, as its converters read them.

Formulas: 63-9243 Rev D, sections 10.2.3.2 and 10.2.3.3. The values are those of healthy units; how they move is an
assumption.
"""

import math

from vlp16emu.extras.bench.state import DeviceStatus
from vlp16emu.units import S_NS

_COUNTS_PER_V = 4096 / 5
_AMBIENT_C, _BOTTOM_C, _TOP_C = 25.0, 51.1, 53.1  # of the surroundings, and of the boards in the end
_WARM_UP_S = 150.0  # in which a board comes nearer to its last temperature by a factor of e
_SWAY_C = 0.2  # by which a temperature goes up and down
_REST_A, _LASER_A, _MOTOR_A_PER_RPM = 0.20, 0.10, 0.18 / 600
"""Current of the electronics, of the lasers and of the motor: together 0.48 A at 600 rpm."""


def diagnostics(status: DeviceStatus) -> dict[str, object]:
    """Make `diag.json`: counts of the converters, which follow the state; all zero if a fault has switched the sensor off."""

    def counts(volts: float, period_s: int) -> int:
        return round(volts * _COUNTS_PER_V + 0.8 * _sine(status, period_s))

    current_a = _REST_A + _LASER_A * status.laser_on + _MOTOR_A_PER_RPM * status.motor_rpm
    bottom = {
        "i_out": counts(2.5 + current_a / 10, 7),
        "pwr_1_2v": counts(1.2036, 11),
        "lm20_temp": _lm20(_warmed(_BOTTOM_C, status, 61)),
        "pwr_5v": counts(5.020 / 2, 13),
        "pwr_2_5v": counts(2.499, 17),
        "pwr_3_3v": counts(3.3032, 19),
        "pwr_v_in": counts(11.964 / 11, 23),
        "pwr_1_25v": 0,
    }
    top = {
        "hv": counts(5 - 181 / 101, 29),
        "ad_temp": counts(0.735, 31),
        "lm20_temp": _lm20(_warmed(_TOP_C, status, 53)),
        "pwr_5v": counts(5.073 / 2, 37),
        "pwr_2_5v": counts(2.499, 41),
        "pwr_3_3v": counts(3.280, 43),
        "pwr_5v_raw": counts(5.347 / 2, 47),
        "pwr_vccint": counts(1.1914, 59),
    }
    rest = {"vhv": 412, "adc_nf": 14, "ixe": 1}
    if status.disabled:
        bottom, top, rest = (dict.fromkeys(some, 0) for some in (bottom, top, rest))
    return {"volt_temp": {"bot": bottom, "top": top}, **rest}


def _lm20(temperature_c: float) -> int:
    """Read a thermometer: T = -1481.96 + sqrt(2.1962e6 + (1.8639 - V) / 3.88e-6)."""
    return round((1.8639 - 3.88e-6 * ((temperature_c + 1481.96) ** 2 - 2.1962e6)) * _COUNTS_PER_V)


def _warmed(last_c: float, status: DeviceStatus, period_s: int) -> float:
    missing = math.exp(-status.powered_for_s / _WARM_UP_S)
    return last_c - (last_c - _AMBIENT_C) * missing + _SWAY_C * _sine(status, period_s)


def _sine(status: DeviceStatus, period_s: int) -> float:
    return math.sin(2 * math.pi * (status.t_ns % (period_s * S_NS)) / (period_s * S_NS))
