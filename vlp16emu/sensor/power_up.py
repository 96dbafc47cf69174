"""State of a unit when a run begins: how long it has been on, where its rotor stands, and how fast its clock is."""

from dataclasses import dataclass
from typing import TypeVar

from vlp16emu.elementary import power
from vlp16emu.random import Purpose, normal, uniform
from vlp16emu.sensor.settings import Lidar

_POWERED_S = 60.0, 6 * 3600.0
"""Shortest and longest time that a unit has been on (assumption: captures of real units do not begin with power-up)."""
_ROUND = {"powered_for_s": 0.0, "start_azimuth_deg": 0.1, "clock_error_ppm": 0.0}
"""State of a unit with `preset = "steady"`: all begins with the run, whose first revolution is whole."""
_CLOCK_PPM, _OFF_SHARE, _FAR_OFF_PPM = 0.6, 0.15, 20.0
"""Rate of the clock that stamps against that which fires: 0.27, -0.90, 0.39, -0.6 ppm on mrpt, einride, nebula and the unit of 2014. On others up to
140 ppm; no clock that stamps is more than 20 ppm off that of the host, so what is off there is the firing, which here is not. That every
seventh is of these is an assumption."""
_VENDOR, _SERIES = "607688", ("10", "38")
"""First bytes of MAC addresses: of the vendor, and of units from before and after 2017."""

_Section = TypeVar("_Section", bound=Lidar)


def powered_up(section: _Section, seed: int) -> _Section:
    """Return a section whose unit has a state at the start: what is not set is drawn by `unit`, and round with `steady`."""
    own = uniform(seed, Purpose.POWER_UP, 0, 4).tolist()
    low_s, high_s = _POWERED_S
    off = own[2] < _OFF_SHARE
    drawn = {
        "powered_for_s": round(low_s * power(high_s / low_s, own[0]), 9),
        "start_azimuth_deg": 360.0 * own[1],
        "clock_error_ppm": _FAR_OFF_PPM * own[3]
        if off
        else _CLOCK_PPM * float(normal(seed, Purpose.POWER_UP, 0, 1, 1)[0]),
    }
    values = _ROUND if section.preset == "steady" else drawn
    return section.model_copy(update={key: value for key, value in values.items() if getattr(section, key) is None})


@dataclass(frozen=True, slots=True)
class Counters:
    """Identity of a unit on the network, and how far its counters are when a run begins."""

    mac: bytes  # 6 bytes
    identification: int  # of the IPv4 header of its first position packet
    position_phase: float  # share of the repeating pattern of position packets that is over


def counters_of(section: Lidar, seed: int, number: int) -> Counters:
    """Return the counters of unit `number` of a rig, drawn by `unit`; with `steady` they begin at 0, and MAC addresses count on."""
    if section.preset == "steady":
        return Counters(bytes.fromhex(f"{_VENDOR}{_SERIES[1]}{number + 1:04x}"), 0, 0.0)
    series, own, identification, phase = uniform(seed, Purpose.POWER_UP, 0, 4, 2).tolist()
    mac = f"{_VENDOR}{_SERIES[int(series < 0.7)]}{int(own * 2**16):04x}"
    return Counters(bytes.fromhex(mac), int(identification * 2**16), phase)
