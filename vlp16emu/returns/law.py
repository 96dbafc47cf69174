"""The numbers that the kernels of this room go by."""

from typing import NamedTuple

__all__ = ["DetectorConstants"]


class DetectorConstants(NamedTuple):
    """Constants of a run, in the form that compiled code takes.

    Amplitudes are those of a waveform: reflectance times cosine of incidence over the square of the range, in m-2.
    """

    seed: int
    strongest_only: bool
    min_range_m: float
    max_range_m: float
    sigma_m: float
    """Of a pulse, in range."""
    resolution_m: float
    threshold: float
    """Amplitude that is seen with probability one half; 0 where every echo is seen."""
    amplitude_noise: float
    """One sigma; 0 where every echo is seen."""
    extinction_per_m: float
    """0 in clear air."""
    clutter: float
    """Reflectance of the air that a pulse fills."""
    least_clutter: float
    """Amplitude below which the air is not worth a look."""
    range_noise_m: float
    reflectivity_noise: float
