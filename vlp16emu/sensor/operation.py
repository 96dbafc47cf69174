"""Operation of a sensor over a run, and the motion of its rotor that follows from it."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from vlp16emu.sensor.rotor import PULL, Spin
from vlp16emu.sensor.settings import SensorSettings
from vlp16emu.sensor.steps import Steps
from vlp16emu.units import S_NS

_RUN_UP_RPM_S = 300.0  # change of the rotor's speed per second (assumption: the manual has no figure)


@dataclass(frozen=True, slots=True)
class Operation:
    """Settings and power of a sensor from an instant on."""

    settings: SensorSettings
    is_powered: bool = True
    """Without power it sends nothing, and its settings are lost when the power returns."""
    motor_on: bool = True


def in_phase_deg(phase_deg: float, rpm: int, utc_ns: int) -> float:
    """Return the angle of a phase-locked rotor.

    Speeds are multiples of 60 rpm, so a second has whole revolutions.
    """
    turned_ns = utc_ns % S_NS * (rpm // 60) % S_NS
    return (phase_deg + 360.0 * turned_ns / S_NS) % 360.0


def spins(start_deg: float, operation: Steps[Operation], start_ns: int) -> tuple[Spin, ...]:
    """Return the motion of the rotor: constant speed, changes to another speed, and pulls into phase.

    Parameters
    ----------
    start_deg : angle at power-up without phase lock
    operation : since the first laser pulse
    start_ns : UTC of the first laser pulse
    """

    def steady_spin(t_ns: int, settings: SensorSettings) -> Spin:
        """Return a rotor that turns at its set speed from an instant on."""
        phase_deg = _phase_deg(settings, start_ns + t_ns)
        return Spin(t_ns, start_deg if phase_deg is None else phase_deg, float(settings.rpm))

    (_, before), *changes = operation.steps
    done = [steady_spin(0, before.settings)]
    for t_ns, now in changes:
        is_power_up = now.is_powered and not before.is_powered
        is_same = _rotor_settings(now) == _rotor_settings(before)
        before = now
        if not is_power_up and (is_same or not now.is_powered):
            continue
        # Phases of the motion that have not begun are dropped.
        while len(done) > 1 and done[-1].from_ns > t_ns:
            done.pop()
        if is_power_up:
            done.append(steady_spin(t_ns, now.settings))
        else:
            done += _steer(done[-1], t_ns, now, start_ns)
    return tuple(done)


def _rotor_settings(operation: Operation) -> tuple[object, ...]:
    return operation.settings.rpm, operation.settings.phase_lock_deg, operation.motor_on


def _phase_deg(settings: SensorSettings, utc_ns: int) -> float | None:
    """Return the angle of a rotor that is in phase; None without phase lock."""
    phase_deg = settings.phase_lock_deg
    if phase_deg == "off" or not settings.is_locked:
        return None
    return in_phase_deg(phase_deg, settings.rpm, utc_ns)


def _steer(spin: Spin, t_ns: int, wanted: Operation, start_ns: int) -> Iterator[Spin]:
    """Yield the motion of the rotor from its present state to the wanted one, from an instant on."""
    rpm = spin.rpm_at(t_ns)
    target = float(wanted.settings.rpm if wanted.motor_on else 0)
    angle_deg = _angle_deg(spin, t_ns)
    if rpm != target:
        ramp = Spin(t_ns, angle_deg, rpm, math.copysign(_RUN_UP_RPM_S, target - rpm))
        yield ramp
        t_ns += round(abs(target - rpm) / _RUN_UP_RPM_S * S_NS)
        angle_deg = _angle_deg(ramp, t_ns)
    if target and (phase_deg := _phase_deg(wanted.settings, start_ns + t_ns)) is not None:
        off_deg = (phase_deg - angle_deg + 180.0) % 360.0 - 180.0
        rate_rpm = math.copysign(max(round(PULL * target), 1), off_deg)
        pull_ns = round(abs(off_deg) / 6.0 / abs(rate_rpm) * S_NS)
        if pull_ns:
            yield Spin(t_ns, angle_deg, target + rate_rpm)
            t_ns += pull_ns
        angle_deg = _phase_deg(wanted.settings, start_ns + t_ns) or 0.0
    yield Spin(t_ns, angle_deg, target)


def _angle_deg(spin: Spin, t_ns: int) -> float:
    return float(spin.at(np.array([t_ns]))[0])
