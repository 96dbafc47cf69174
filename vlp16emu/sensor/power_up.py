"""State of a unit when a run begins: time since power-up, rotor angle, and clock rate."""

from dataclasses import dataclass
from typing import TypeVar

from vlp16emu.elementary import power
from vlp16emu.random import Purpose, normal, uniform
from vlp16emu.sensor.laws import law
from vlp16emu.sensor.settings import Lidar

_POWERED_S = 60.0, 6 * 3600.0
"""Shortest and longest time since power-up (assumption: captures of real units do not begin with
power-up)."""
_STEADY = {"powered_for_s": 0.0, "start_azimuth_deg": 0.1, "clock_error_ppm": 0.0}
"""State of a unit with `preset = "steady"`: power-up is the start of the run, and the first revolution is
complete."""
_VENDOR = "607688"
_SERIES = ("10", "38")
"""First bytes of MAC addresses: vendor, and units from before and after 2017."""

_Section = TypeVar("_Section", bound=Lidar)


def with_start_state(section: _Section, seed: int) -> _Section:
    """Return the section with the state of its unit at the start of a run.

    Keys that are not set are random with `unit`, fixed with `steady`.
    """
    draws = uniform(seed, Purpose.POWER_UP, 0, 4).tolist()
    low_s, high_s = _POWERED_S
    if draws[2] < law("clock.off_share"):
        error_ppm = law("clock.most_off_ppm") * draws[3]
    else:
        error_ppm = law("clock.spread_ppm") * float(normal(seed, Purpose.POWER_UP, 0, 1, 1)[0])
    drawn = {
        "powered_for_s": round(low_s * power(high_s / low_s, draws[0]), 9),
        "start_azimuth_deg": 360.0 * draws[1],
        "clock_error_ppm": error_ppm,
    }
    values = _STEADY if section.preset == "steady" else drawn
    return section.model_copy(
        update={key: value for key, value in values.items() if getattr(section, key) is None}
    )


@dataclass(frozen=True, slots=True)
class Counters:
    """Identity of a unit on the network, and its counters when a run begins."""

    mac: bytes  # 6 bytes
    identification: int  # identification in the IPv4 header of its first position packet
    position_phase: float  # phase in the repeating pattern of position packets, 0 to 1


def counters_of(section: Lidar, seed: int, number: int) -> Counters:
    """Return the counters of unit `number` of a rig.

    They are random with `unit`; with `steady` they are 0, and MAC addresses are consecutive.
    """
    if section.preset == "steady":
        return Counters(bytes.fromhex(f"{_VENDOR}{_SERIES[1]}{number + 1:04x}"), 0, 0.0)
    series, mac_draw, identification, phase = uniform(seed, Purpose.POWER_UP, 0, 4, 2).tolist()
    mac = f"{_VENDOR}{_SERIES[int(series < 0.7)]}{int(mac_draw * 2**16):04x}"
    return Counters(bytes.fromhex(mac), int(identification * 2**16), phase)
