"""Samples of an inertial measurement unit on the moving body."""

import math
from functools import lru_cache

import numpy as np

from vlp16emu.elementary import exp, matmul, matvec, norm
from vlp16emu.extras.imu.settings import Imu
from vlp16emu.kernels.compiler import array_kernel
from vlp16emu.motion.pose import Motion
from vlp16emu.random import Purpose, normal, normal_pair, uniform
from vlp16emu.rotation import rotations
from vlp16emu.scenario.model import InertialSection
from vlp16emu.types import F8, I8, Inertial
from vlp16emu.units import S_NS

GRAVITY_M_S2 = 9.80665  # standard gravity, downwards (3rd CGPM, 1901)
_CHUNK = 4096  # samples of a random walk that are drawn together
_HORIZON = 1 << 32  # length of the random walk in chunks: centuries
_GYRO_WARM_UP_RAD_S = 2.6e-3
_ACCEL_WARM_UP_M_S2 = 0.02
_WARM_UP_S = 200.0
"""Change of the biases by 10 K of warming up, one sigma: 0.015 deg/s and 0.2 mg per K (Bosch
BST-BMI088-DS001, tables 4 and 5); and the time after which 63 % of it is done: it takes 5 to 10 minutes
(Xsens, Bias repeatability of gyroscopes)."""
_AXIS_ERROR = 0.005
"""Error of sensitivity and of alignment of an axis, one sigma: half of the tolerance of 1 % each (Bosch
BNO055; assumption)."""
_HEADING = 6  # lane of the heading's random walk; the six axes have lanes 0 to 5


def sampler_of(motion: Motion, imu: InertialSection, *, start_ns: int, seed: int) -> "ImuSampler":
    """Return the samples of a scene's inertial unit; parameters as in `ImuSampler`."""
    assert isinstance(imu, Imu)  # the only section of an inertial unit
    return ImuSampler(motion, imu, start_ns=start_ns, seed=seed)


class ImuSampler:
    """A strapdown unit that samples at its rate from `start_ns` on; `motion` is that of the unit."""

    def __init__(self, motion: Motion, imu: Imu, *, start_ns: int, seed: int) -> None:
        self._motion = motion
        self._imu = imu
        self._start_ns = start_ns
        self._seed = seed
        drawn = (normal(seed, Purpose.IMU_MODEL, 0, 9, lane).reshape(3, 3) for lane in range(2))
        # Sensitivity and alignment (3, 3) of the gyroscopes and of the accelerometers.
        self._responses = [np.eye(3) + _AXIS_ERROR * errors for errors in drawn]
        noise = imu.gyro_noise_rad_s_sqrt_hz, imu.gyro_walk_rad_s2_sqrt_hz
        self._gyro = (imu.gyro_bias_rad_s, *noise, _GYRO_WARM_UP_RAD_S * imu.is_rough)
        self._turn = lru_cache(None)(lambda chunk: float(self._gyro_bias_angle(chunk)[-1]))

    def late_ns(self, first: int, count: int) -> I8:
        """Return the delay (count,) of the arrival of samples first .. first + count - 1."""
        (least_s, greatest_s) = self._imu.delay_s
        late_s = np.zeros(count)
        if greatest_s:
            late_s += least_s + (greatest_s - least_s) * uniform(self._seed, Purpose.IMU_STAMP, 0, 1, 0)[0]
        if self._imu.jitter_s:
            late_s += self._imu.jitter_s * uniform(self._seed, Purpose.IMU_STAMP, first, count, 1)
        return np.rint(late_s * S_NS).astype(np.int64)

    def read(self, first: int, count: int) -> Inertial:
        """Return samples first .. first + count - 1; the result does not depend on earlier calls."""
        t_ns = self._start_ns + np.arange(first, first + count, dtype=np.int64) * S_NS // self._imu.rate_hz
        truth = self._motion.kinematics_at(t_ns)
        up = truth.world_a_body_m_s2 + np.array([0.0, 0.0, GRAVITY_M_S2])
        force = matvec(truth.world_R_body.swapaxes(1, 2), up)
        e = self._imu
        w = truth.body_w_rad_s
        accel = e.accel_bias_m_s2, e.accel_noise_m_s2_sqrt_hz, e.accel_walk_m_s3_sqrt_hz
        w_errors, w_bias = self._sample_errors(self._gyro, first, count, 0)
        force_errors, force_bias = self._sample_errors(
            (*accel, _ACCEL_WARM_UP_M_S2 * e.is_rough), first, count, 3
        )
        attitude = self._attitude(truth.world_R_body, force_bias, first) if e.attitude else None
        seen_w, seen_force = map(matvec, self._responses, (w, force)) if e.is_rough else (w, force)
        gained_ns = np.rint(1e-6 * self._imu.clock_ppm * (t_ns - self._start_ns)).astype(np.int64)
        stamp_ns = t_ns + self.late_ns(first, count) + gained_ns if self._imu.is_late else None
        read = seen_w + w_errors, seen_force + force_errors
        return Inertial(t_ns, *read, w, force, w_bias, force_bias, attitude, stamp_ns)

    def _attitude(self, world_R_imu: F8, force_bias: F8, first: int) -> F8:
        """Return the reported attitude (n, 3, 3) of samples from `first` on.

        It is levelled by gravity, so the accelerometers' bias relative to 1 g tilts it. Its heading drifts
        with the integral of the gyroscopes' bias, and with the random walk of their integrated white noise.
        """
        up = matvec(world_R_imu, force_bias) + np.array([0.0, 0.0, GRAVITY_M_S2])
        up /= norm(up)[:, None]
        tilt = np.zeros((len(up), 3, 3))  # the shortest turn of `up` to the vertical, by Rodrigues' formula
        tilt[:, 2, 0] = up[:, 0]
        tilt[:, 2, 1] = up[:, 1]
        tilt[:, 0, 2] = -up[:, 0]
        tilt[:, 1, 2] = -up[:, 1]
        turn = np.eye(3) + tilt + matmul(tilt, tilt) / (1.0 + up[:, 2])[:, None, None]
        chunks = range(first // _CHUNK, (first + len(up) - 1) // _CHUNK + 1)
        parts = [sum(map(self._turn, range(chunk))) + self._gyro_bias_angle(chunk)[:-1] for chunk in chunks]
        drift_rad = np.concatenate(parts)[first - chunks.start * _CHUNK :][: len(up)]
        if noise := self._imu.gyro_noise_rad_s_sqrt_hz:
            drift_rad += (
                noise / math.sqrt(self._imu.rate_hz) * _random_walk(self._seed, first, len(up), _HEADING)
            )
        return matmul(matmul(rotations(drift_rad, 0.0, 0.0), turn), world_R_imu)

    def _gyro_bias_angle(self, chunk: int) -> F8:
        """Integrate the gyroscopes' bias (n + 1,) over a chunk, about the vertical of the first sample."""
        up = self._motion.kinematics_at(np.array([self._start_ns])).world_R_body[0, 2]
        _, bias = self._sample_errors(self._gyro, chunk * _CHUNK, _CHUNK, 0)
        return np.append(0.0, np.cumsum((bias * up).sum(axis=1))) / self._imu.rate_hz

    def _sample_errors(
        self, sizes: tuple[float, float, float, float], first: int, count: int, first_axis: int
    ) -> tuple[F8, F8]:
        """Return errors (count, 3) of three axes, noise plus bias, and the bias; none of size 0 is drawn."""
        bias, noise, walk, warm_up = sizes
        warmed = (
            1.0 - exp(-np.arange(first, first + count) / (self._imu.rate_hz * _WARM_UP_S)) if warm_up else 0.0
        )
        out = np.zeros((count, 3))
        slow = np.zeros((count, 3))
        for axis in range(3):
            lane = first_axis + axis
            if bias:
                slow[:, axis] += bias * normal(self._seed, Purpose.IMU_BIAS, 0, 1, lane)[0]
                out[:, axis] += slow[:, axis]
            if noise:
                white = normal(self._seed, Purpose.IMU_NOISE, first, count, lane)
                out[:, axis] += noise * math.sqrt(self._imu.rate_hz) * white
            if walk:
                wandered = walk / math.sqrt(self._imu.rate_hz) * _random_walk(self._seed, first, count, lane)
                slow[:, axis] += wandered
                out[:, axis] += wandered
            if warm_up:
                drifted = warm_up * normal(self._seed, Purpose.IMU_BIAS, 1, 1, lane)[0] * warmed
                slow[:, axis] += drifted
                out[:, axis] += drifted
        return out, slow


def _random_walk(seed: int, first: int, count: int, lane: int) -> F8:
    """Return the cumulative sum (count,) of normal numbers from sample `first` on; 0 at sample 0.

    Ends of chunks come from halving intervals (Levy's construction of Brownian motion), the samples between
    from a Brownian bridge: the sum costs the same after any time.
    """
    chunks = range(first // _CHUNK, (first + count - 1) // _CHUNK + 1)
    parts = [_random_walk_chunk(seed, chunk, lane) for chunk in chunks]
    begin = first - chunks.start * _CHUNK
    return np.concatenate(parts)[begin : begin + count]


def _random_walk_chunk(seed: int, chunk: int, lane: int) -> F8:
    # Lanes: two for each axis, one for the ends of chunks and one within.
    purpose = int(Purpose.IMU_WALK)
    scale = math.sqrt(_CHUNK)
    start, end = (scale * _brownian(seed, purpose, index, 2 * lane) for index in (chunk, chunk + 1))
    steps = np.cumsum(normal(seed, Purpose.IMU_WALK, chunk * _CHUNK, _CHUNK, 2 * lane + 1))
    free = np.concatenate([[0.0], steps[:-1]])
    return start + free + np.arange(_CHUNK) / _CHUNK * (end - start - steps[-1])


@array_kernel
def _brownian(seed: int, purpose: int, index: int, lane: int) -> float:
    """Brownian motion at an integer time up to 2^32, with one random number for each time."""
    low, high = 0, _HORIZON
    before, after = 0.0, math.sqrt(_HORIZON) * normal_pair(seed, purpose, _HORIZON, lane)[0]
    while low < index:
        middle = (low + high) // 2
        half = 0.5 * math.sqrt(high - low)
        at_middle = 0.5 * (before + after) + half * normal_pair(seed, purpose, middle, lane)[0]
        if index >= middle:
            low = middle
            before = at_middle
        else:
            high = middle
            after = at_middle
    return before
