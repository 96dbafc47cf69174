"""The `[imu]` table: an inertial measurement unit on the same body."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field

from vlp16emu.scenario.harness import Mount
from vlp16emu.settings import Preset

__all__ = ["Imu"]

Error = Annotated[float, Field(ge=0, le=1000)]

_PRESETS: Mapping[str, Mapping[str, float]] = {
    "ideal": {},
    # Noise of Bosch's BMG160 and BMA280, 0.014 deg/s and 120 ug per sqrt(Hz), and a tenth of their offsets of
    # 1 deg/s and 50 mg (Bosch CISS manual, section 4.11.1); that a tenth is left by calibration is an assumption.
    # Random walks as measured on a tracker with such parts (libsurvive wiki, IMU variance measurements).
    "consumer": {
        "gyro_bias_rad_s": 1.7e-3,
        "gyro_noise_rad_s_sqrt_hz": 2.4e-4,
        "gyro_walk_rad_s2_sqrt_hz": 7.0e-6,
        "accel_bias_m_s2": 0.049,
        "accel_noise_m_s2_sqrt_hz": 1.2e-3,
        "accel_walk_m_s3_sqrt_hz": 1.5e-4,
    },
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
}


class Imu(Preset):
    """Rate, place and errors; densities as in IEEE Std 952-1997. Defaults are those of `ideal`."""

    presets = _PRESETS

    preset: Literal["ideal", "consumer", "tactical"] = "ideal"
    """Values of the keys that are not given beside it; `ideal` is their defaults."""
    rate_hz: Annotated[int, Field(ge=1, le=10_000)] = 200
    """Samples per second."""
    mount: Mount = Mount()
    """Mount on the pack, not on a spinning stage."""
    gyro_bias_rad_s: Error = 0.0
    """At switch-on, one sigma."""
    gyro_noise_rad_s_sqrt_hz: Error = 0.0
    """White noise."""
    gyro_walk_rad_s2_sqrt_hz: Error = 0.0
    """Random walk of the bias."""
    accel_bias_m_s2: Error = 0.0
    """At switch-on, one sigma."""
    accel_noise_m_s2_sqrt_hz: Error = 0.0
    """White noise."""
    accel_walk_m_s3_sqrt_hz: Error = 0.0
    """Random walk of the bias."""
