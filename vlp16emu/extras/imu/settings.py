"""The table `[imu]` of a scene.

No kernel is in this file, so that a scene is read without the compiler.
"""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from vlp16emu.motion.settings import Mount
from vlp16emu.settings import ExpectationError, NonNegative, Preset

_CONSUMER = {
    "gyro_bias_rad_s": 1.7e-3,
    "gyro_noise_rad_s_sqrt_hz": 2.4e-4,
    "gyro_walk_rad_s2_sqrt_hz": 7.0e-6,
    "accel_bias_m_s2": 0.049,
    "accel_noise_m_s2_sqrt_hz": 1.2e-3,
    "accel_walk_m_s3_sqrt_hz": 1.5e-4,
}
_Error = Annotated[float, Field(ge=0, le=1000)]


class Imu(Preset):
    """Rate, place and errors; densities as in IEEE Std 952-1997. The defaults are the values of `ideal`."""

    presets: ClassVar[Mapping[str, Mapping[str, object]]] = {
        "ideal": {},
        # Noise of Bosch's BMG160 and BMA280, 0.014 deg/s and 120 ug per sqrt(Hz), and a tenth of their
        # offsets of 1 deg/s and 50 mg (Bosch CISS manual, section 4.11.1); that a tenth is left by
        # calibration is an assumption. Random walks as measured on a tracker with such parts (libsurvive
        # wiki, IMU variance measurements).
        "consumer": _CONSUMER,
        # Gyroscopes of Sensonor's STIM210, 0.10 deg/sqrt(h) and 10 deg/h over temperature (maker's FAQ);
        # accelerometers of 1 mg and 0.06 m/s/sqrt(h), and the random walks, are assumptions.
        "tactical": {
            "gyro_bias_rad_s": 4.8e-5,
            "gyro_noise_rad_s_sqrt_hz": 2.9e-5,
            "gyro_walk_rad_s2_sqrt_hz": 5.0e-8,
            "accel_bias_m_s2": 9.8e-3,
            "accel_noise_m_s2_sqrt_hz": 1.0e-3,
            "accel_walk_m_s3_sqrt_hz": 1.0e-5,
        },
        # A typical robot's unit, read over USB. Noise of Bosch's BMI088, 0.014 deg/s and 160 ug per sqrt(Hz)
        # (BST-BMI088-DS001, tables 4 and 5). Reads of a USB serial line come in steps of 4 ms (ROS wiki,
        # camera_calibration/calibration_notes/Timing), and 2 to 4 ms after the sample (assumption).
        "field": _CONSUMER
        | {"accel_noise_m_s2_sqrt_hz": 1.6e-3, "delay_s": (0.002, 0.004), "jitter_s": 0.004},
    }

    preset: Literal["ideal", "consumer", "tactical", "field"] = "ideal"
    """Sets the keys that are not given beside it; the defaults are `ideal`. `field` has biases that change
    during warm-up by 0.15 deg/s and 0.02 m/s2 (one sigma, 63 % of it in 200 s), and errors of sensitivity and
    alignment of
    0.005 per axis."""
    rate_hz: Annotated[int, Field(ge=1, le=10_000)] = 200
    """Samples per second."""
    mount: Mount = Mount()
    """Mount on the pack, not on a spinning stage."""
    attitude: bool = False
    """True if the unit also reports its attitude, as programs for nine axes need it: levelled by gravity,
    with the bias of the accelerometers, and with a heading that drifts with the bias of the gyroscopes."""
    gyro_bias_rad_s: _Error = 0.0
    """At switch-on, one sigma."""
    gyro_noise_rad_s_sqrt_hz: _Error = 0.0
    """White noise."""
    gyro_walk_rad_s2_sqrt_hz: _Error = 0.0
    """Random walk of the bias."""
    accel_bias_m_s2: _Error = 0.0
    """At switch-on, one sigma."""
    accel_noise_m_s2_sqrt_hz: _Error = 0.0
    """White noise."""
    accel_walk_m_s3_sqrt_hz: _Error = 0.0
    """Random walk of the bias."""
    delay_s: Annotated[tuple[NonNegative, NonNegative], Field(strict=False)] = (0.0, 0.0)
    """Least and greatest delay of time stamps behind the samples; the delay of a run is drawn between
    them."""
    jitter_s: NonNegative = 0.0
    """Greatest additional delay, drawn for each sample; below the time between two samples."""
    clock_ppm: Annotated[float, Field(ge=-50_000, le=50_000)] = 0.0
    """Drift of its clock: microseconds that time stamps gain in each second since the first sample; negative
    if they lose. 10 000 is the variation of an MPU-6050 without a quartz (PS-MPU-6000A, section 7.15)."""

    @property
    def is_rough(self) -> bool:
        """True if the unit has the errors of `field` for which there is no key."""
        return self.preset == "field"

    @property
    def is_late(self) -> bool:
        """True if time stamps differ from the times of the samples."""
        return bool(self.delay_s[1] or self.jitter_s or self.clock_ppm)

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.jitter_s * self.rate_hz >= 1:
            raise ExpectationError("a jitter_s below 1 / rate_hz in it, so that time stamps rise")
        if not self.delay_s[0] <= self.delay_s[1] <= 1:
            raise ExpectationError("a delay_s of two rising times of at most 1 s in it")
        return self
