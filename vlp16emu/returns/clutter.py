"""Echoes of the air itself, as detection meets them where it is not clear."""

from vlp16emu.elementary import log1p
from vlp16emu.kernels.compiler import array_kernel
from vlp16emu.random import Purpose, uniform_pair
from vlp16emu.returns.settings import DetectorConstants
from vlp16emu.types import F4

_NEAREST_M = 0.05  # least range of clutter: the light leaves the housing there, to a centimetre
_WEATHER = int(Purpose.WEATHER)


@array_kernel
def clutter_echo(
    constants: DetectorConstants, n: int, laser: int, start: int, stop: int, range_m: F4
) -> tuple[float, float]:
    """Return range and amplitude of the clutter echo of pulse (n, laser); the air must not be clear.

    One echo per pulse: the air scatters at a range of exponential distribution, with the brightness of the
    lidar equation times an exponential fluctuation for the random number of drops (assumption). The amplitude
    is 0 below the threshold of the detector, and behind all hits of the sub-rays start .. stop - 1.
    """
    where, how_bright = uniform_pair(constants.seed, _WEATHER, n, laser)
    air_m = max(-log1p(-where) / constants.extinction_per_m, _NEAREST_M)
    passed = 1.0 - where  # exp(-extinction * range)
    amplitude = -log1p(-how_bright) * constants.clutter * passed * passed / (air_m * air_m)
    if amplitude >= constants.least_clutter:
        for ray in range(start, stop):
            if range_m[ray] > air_m:
                return air_m, amplitude
    return air_m, 0.0
