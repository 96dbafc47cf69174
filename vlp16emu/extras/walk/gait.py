"""Motion of the trunk of a walking person about the smooth path over the ground."""

import math

import numpy as np

from vlp16emu.elementary import exp, power
from vlp16emu.extras.walk.settings import Gait
from vlp16emu.kernels.compiler import array_kernel
from vlp16emu.random import Purpose, uniform
from vlp16emu.trig import cos_sin
from vlp16emu.types import F8

AXES = 6  # fore-aft, sideways, vertical in the heading frame (m), then roll, pitch, yaw (rad)
_HEEL_SHARPNESS = 20.0
"""A heel strike lasts 40 ms at 1.8 steps per second: assumption, from the look of trunk accelerations."""
_LINES = 12  # sinusoids of each slow process
_SLOWEST_HZ = 0.005
_FASTEST_HZ = 0.5
"""Equal power in each octave between these: stride times vary like 1/f noise, measured as f^-0.92 over nine
minutes (Hausdorff et al.; PhysioNet, Fractal mechanisms in neural control, figure 9)."""
_TIMING = AXES  # lane of the process that varies the step rate; those before it vary the amplitude of an axis


def step_rate_hz(speed_m_s: float) -> float:
    """Return the step rate at a walking speed, in steps per second.

    Source of the exponent: Grieve and Gear, "The relationships between length of stride, step frequency,
    time of swing and speed of walking", Ergonomics 9, 1966. The factor fits 20 adults who took 111
    steps per minute at 1.19 m/s (Chung et al., J NeuroEng Rehabil 7:9, 2010, table 1).
    """
    return 111.0 / 60.0 * power(speed_m_s / 1.19, 0.58)


class Trunk:
    """Trunk motion at a walking speed, which sets the step rate unless the gait does.

    The seed determines how strides vary.
    """

    def __init__(self, gait: Gait, speed_m_s: float, seed: int) -> None:
        self._step_hz = gait.step_hz or step_rate_hz(speed_m_s)
        self._variation = gait.variation
        lengths_m = gait.fore_aft_m, gait.sideways_m, gait.vertical_m
        turns_rad = np.radians([gait.roll_deg, gait.pitch_deg, gait.yaw_deg])
        self._amplitude = np.array([*lengths_m, *turns_rad, gait.second_harmonic_m, gait.heel_strike_m])
        self._lines = _lines(seed)

    def at(self, elapsed_s: F8, effort: F8) -> F8:
        """Return displacements (n, 6), axes as in `AXES`, at times (n,) since the first step.

        Effort (n,) is the share of the amplitudes, 0 at rest and 1 at walking speed.
        """
        out = np.empty((len(elapsed_s), AXES))
        _fill(elapsed_s, effort, self._step_hz, self._variation, self._amplitude, self._lines, out)
        return out


def _lines(seed: int) -> F8:
    """Draw angular frequency and phase (7, lines, 2) of the sinusoids of each slow process."""
    lines = np.empty((AXES + 1, _LINES, 2))
    for lane in range(AXES + 1):
        draw = uniform(seed, Purpose.GAIT, 0, 2 * _LINES, lane).reshape(2, _LINES)
        octave = (np.arange(_LINES) + draw[0]) / _LINES
        lines[lane, :, 0] = 2.0 * math.pi * _SLOWEST_HZ * power(_FASTEST_HZ / _SLOWEST_HZ, octave)
        lines[lane, :, 1] = 2.0 * math.pi * draw[1]
    return lines


@array_kernel
def _band_noise(lines: F8, t_s: float) -> float:
    """Return the value of a slow process of variance 1, a sum of sinusoids `lines`."""
    total = 0.0
    for k in range(len(lines)):
        total += cos_sin(lines[k, 0] * t_s + lines[k, 1])[1]
    return total * math.sqrt(2.0 / len(lines))


@array_kernel
def _band_noise_integral(lines: F8, t_s: float) -> float:
    """Return the integral of `_band_noise` from 0 to `t_s`."""
    total = 0.0
    for k in range(len(lines)):
        total += (cos_sin(lines[k, 1])[0] - cos_sin(lines[k, 0] * t_s + lines[k, 1])[0]) / lines[k, 0]
    return total * math.sqrt(2.0 / len(lines))


@array_kernel
def _fill(
    elapsed_s: F8, effort: F8, step_hz: float, variation: float, amplitude: F8, lines: F8, out: F8
) -> None:
    """Fill displacements (n, 6) as in `Trunk.at`, each row on its own."""
    for i in range(elapsed_s.size):
        t_s = elapsed_s[i]
        strides = 0.5 * step_hz * (t_s + variation * _band_noise_integral(lines[_TIMING], t_s))
        stride = 2.0 * math.pi * (strides - math.floor(strides))
        # The lowest point of a step and its heel strike are at 3/4 of its phase; the trunk is over the
        # standing leg at 1/4.
        step_cos, step_sin = cos_sin(2.0 * stride)
        lean_cos, lean_sin = cos_sin(stride + 0.25 * math.pi)
        sway = (step_cos, lean_sin, step_sin, -lean_sin, -step_sin, lean_cos)
        for axis in range(AXES):
            factor = effort[i] * (1.0 + variation * _band_noise(lines[axis], t_s)) if variation else effort[i]
            motion = amplitude[axis] * sway[axis]
            if axis == 2:
                motion += amplitude[6] * cos_sin(4.0 * stride)[1]
                motion -= amplitude[7] * exp(_HEEL_SHARPNESS * (-step_sin - 1.0))
            out[i, axis] = factor * motion
