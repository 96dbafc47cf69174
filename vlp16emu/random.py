"""Counter-based random numbers, keyed by seed, purpose and counters, such as a firing number and a laser.

Any number can be drawn at any time, in any order and on any thread, so a run is independent of batches and
workers.

The generator is Philox 4x32 with 10 rounds: Salmon, Moraes, Dror, Shaw, "Parallel Random Numbers: As Easy as
1, 2, 3", SC 2011, section 3.2 and table 2. Tests compare it with the authors' known answers.
"""

import math
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import log_of_normal
from vlp16emu.kernels.compiler import array_kernel, inline_kernel, kernel
from vlp16emu.trig import in_quarter


class Purpose(IntEnum):
    """Purposes of random numbers. Values determine the output: never renumber, only append.

    Purposes of forests are in `vlp16emu.forest.purpose`.
    """

    AZIMUTH_READING = 1
    POSITION_PACKET = 6
    FOOTPRINT = 7
    BEAM_ERROR = 8
    RANGE_NOISE = 9
    RANGE_BIAS = 10
    DETECTION = 11
    REFLECTIVITY = 12
    WEATHER = 13
    NO_RETURN = 14
    ANGLE_BIAS = 15
    GAIT = 50
    IMU_NOISE = 51
    IMU_BIAS = 52
    IMU_WALK = 53
    GNSS_NOISE = 60
    GNSS_WANDER = 61
    UNIT = 70
    PACKET_FAULT = 80
    PACKET_JITTER = 81
    BIT_FLIP = 82
    SENTENCE = 83
    AUDIT = 90
    DATASET_SPLIT = 91
    RANGE_BEAT = 101
    DISTANCE_PARITY = 102
    MOTOR_SPEED = 103
    AZIMUTH_PATTERN = 104
    CAPTURE_STAMP = 105
    CAPTURE_LATE = 106
    UNIT_NOISE = 107
    CAPTURE_HOST = 110
    TEXTURE = 116
    MOUNT = 130
    IMU_MODEL = 131
    IMU_STAMP = 132
    PASSER = 133
    POWER_UP = 134
    LOSS = 135
    LOSS_SPOT = 136
    STRENGTH = 137
    RECEIVER = 140
    SCORE_DISK = 92


_Word = int | np.uint32
_Size = int | tuple[int, ...] | None
_Drawn = Any  # a number, or an array of a given size

_NORMAL_TAIL = 3.6541528853610088
_EXPONENTIAL_TAIL = 7.69711747013104972
"""Edges beyond which numbers come from logarithms (numpy/random/src/distributions/ziggurat_constants.h)."""


@inline_kernel
def philox4x32(
    c0: _Word, c1: _Word, c2: _Word, c3: _Word, k0: _Word, k1: _Word
) -> tuple[_Word, _Word, _Word, _Word]:
    """Return four random 32-bit words for counter (c0, c1, c2, c3) and key (k0, k1), all uint32.

    Source: SC 2011 paper, multipliers and Weyl constants of Philox 4x32.
    """
    mask = np.uint64(0xFFFFFFFF)
    for _ in range(10):
        p0 = np.uint64(0xD2511F53) * np.uint64(c0)
        p1 = np.uint64(0xCD9E8D57) * np.uint64(c2)
        n0 = np.uint32(p1 >> np.uint64(32)) ^ np.uint32(c1) ^ np.uint32(k0)
        n2 = np.uint32(p0 >> np.uint64(32)) ^ np.uint32(c3) ^ np.uint32(k1)
        c0 = n0
        c1 = np.uint32(p1 & mask)
        c2 = n2
        c3 = np.uint32(p0 & mask)
        k0 = np.uint32(k0 + np.uint32(0x9E3779B9))
        k1 = np.uint32(k1 + np.uint32(0xBB67AE85))
    return c0, c1, c2, c3


@inline_kernel
def uniform_pair(seed: int, purpose: int, n: int | np.int64, lane: int | np.int64) -> tuple[float, float]:
    """Draw two uniform numbers in [0, 1) of 53 bits each; for use in kernels.

    Parameters
    ----------
    n : first counter, below 2**64, for instance a firing-sequence number
    lane : second counter, below 2**32, for instance a laser
    """
    w0, w1, w2, w3 = philox4x32(
        np.uint32(n & 0xFFFFFFFF),
        np.uint32((n >> 32) & 0xFFFFFFFF),
        np.uint32(lane),
        np.uint32(purpose),
        np.uint32(seed & 0xFFFFFFFF),
        np.uint32((seed >> 32) & 0xFFFFFFFF),
    )
    a = ((np.uint64(w0) << np.uint64(21)) ^ (np.uint64(w1) >> np.uint64(11))) * 2.0**-53
    b = ((np.uint64(w2) << np.uint64(21)) ^ (np.uint64(w3) >> np.uint64(11))) * 2.0**-53
    return a, b


@inline_kernel
def box_muller(a: float, b: float) -> tuple[float, float]:
    """Convert two uniform numbers into two normal ones, by Box and Muller (1958); for use in kernels.

    Logarithm, cosine and sine use additions, products and one quotient, which round equally on all
    processors. There is no branch and no call, so that a loop over lanes processes four per step.
    """
    radius = math.sqrt(-2.0 * log_of_normal(1.0 - a))  # 1 - a is exact
    quarter = math.floor(4.0 * b + 0.5)
    cosine, sine = in_quarter(quarter, (4.0 * b - quarter) * (0.5 * math.pi))
    return radius * cosine, radius * sine


@kernel
def normal_pair(seed: int, purpose: int, n: int, lane: int) -> tuple[float, float]:
    """Draw two independent standard normal numbers for the same arguments."""
    a, b = uniform_pair(seed, purpose, n, lane)
    return box_muller(a, b)


@kernel
def normal_pairs(
    seed: int, purpose: int, n: int, first: NDArray[np.float64], second: NDArray[np.float64]
) -> None:
    """Fill two arrays (lanes,) with the numbers of `normal_pair`, in a quarter of its time."""
    for lane in range(first.shape[0]):
        a, b = uniform_pair(seed, purpose, n, lane)
        first[lane], second[lane] = box_muller(a, b)


@array_kernel
def _fill(
    out: NDArray[np.float64], gaussian: bool, seed: int, purpose: int, counters: NDArray[np.int64], lane: int
) -> None:
    """Fill (n,) with one number per counter, each computed independently."""
    for i in range(out.shape[0]):
        if gaussian:
            out[i] = normal_pair(seed, purpose, counters[i], lane)[0]
        else:
            out[i] = uniform_pair(seed, purpose, counters[i], lane)[0]


def uniform_at(
    seed: int, purpose: IntEnum, counters: NDArray[np.int64], lane: int = 0
) -> NDArray[np.float64]:
    """Draw uniform numbers in [0, 1), (n,), for counters (n,) of any order.

    Other parameters as in `uniform`.
    """
    out = np.empty(len(counters))
    _fill(out, False, seed, int(purpose), counters, lane)  # numba would process the whole enum
    return out


def normal_at(seed: int, purpose: IntEnum, counters: NDArray[np.int64], lane: int = 0) -> NDArray[np.float64]:
    """Draw standard normal numbers (n,) for the arguments of `uniform_at`.

    They are the first ones of `normal_pair`.
    """
    out = np.empty(len(counters))
    _fill(out, True, seed, int(purpose), counters, lane)
    return out


def uniform(seed: int, purpose: IntEnum, first: int, count: int, lane: int = 0) -> NDArray[np.float64]:
    """Draw uniform numbers in [0, 1), (count,), for counters first .. first + count - 1.

    Parameters
    ----------
    seed : scenario seed, 0 .. 2**63 - 1
    purpose : purpose of the numbers
    first : counter of the first number, for instance a firing-sequence number
    lane : second counter, for instance a laser
    """
    return uniform_at(seed, purpose, np.arange(first, first + count), lane)


def normal(seed: int, purpose: IntEnum, first: int, count: int, lane: int = 0) -> NDArray[np.float64]:
    """Draw standard normal numbers (count,) for the arguments of `uniform`.

    They are the first ones of `normal_pair`.
    """
    return normal_at(seed, purpose, np.arange(first, first + count), lane)


class _Generator(np.random.Generator):
    """Numpy's generator with the same bits on every processor.

    Numpy draws normal and exponential numbers by ziggurats (Marsaglia and Tsang 2000), which use products
    except in the tails, 1 number in 3700 and in 2200. There, and for beta numbers, libm computes logarithms
    and powers, and its last bit differs between processors. These numbers are rounded to steps of 2**-24:
    that bit moves fewer than 1 in 1e8 to another step. Elsewhere, also in `poisson`, libm only decides
    whether a number is redrawn: its last bit changes 1 in 1e14.
    """

    def standard_normal(self, size: _Size = None) -> _Drawn:  # type: ignore[override]  # float64 alone
        """Draw standard normal numbers."""
        return _rounded_beyond(_NORMAL_TAIL, super().standard_normal(size))

    def normal(  # type: ignore[override]
        self, loc: float = 0.0, scale: float = 1.0, size: _Size = None
    ) -> _Drawn:
        """Draw normal numbers."""
        return loc + scale * self.standard_normal(size)

    def standard_exponential(self, size: _Size = None) -> _Drawn:  # type: ignore[override]
        """Draw exponential numbers of mean 1."""
        return _rounded_beyond(_EXPONENTIAL_TAIL, super().standard_exponential(size))

    def rayleigh(self, scale: _Drawn = 1.0, size: _Size = None) -> _Drawn:  # type: ignore[override]
        """Draw Rayleigh-distributed numbers."""
        return scale * np.sqrt(2.0 * self.standard_exponential(np.shape(scale) if size is None else size))

    def beta(self, a: _Drawn, b: _Drawn, size: _Size = None) -> _Drawn:  # type: ignore[override]
        """Draw beta-distributed numbers."""
        return _rounded_beyond(0.0, super().beta(a, b, size))


def _rounded_beyond(edge: float, numbers: _Drawn) -> _Drawn:
    """Round numbers farther from 0 than an edge to steps of 2**-24."""
    return np.where(np.abs(numbers) > edge, np.rint(numbers * 16777216.0) / 16777216.0, numbers)[()]


def generator(seed: int, purpose: IntEnum, *key: int) -> np.random.Generator:
    """Return a numpy generator for a static object, identified by signed integers.

    Such objects are tiles and trees.
    """
    words = [seed & 0xFFFFFFFF, seed >> 32, int(purpose), *(k & 0xFFFFFFFFFFFFFFFF for k in key)]
    return _Generator(np.random.Philox(np.random.SeedSequence(words)))
