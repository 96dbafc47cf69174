"""Sweeps at a time, and those of a scene, computed when they are asked for."""

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from vlp16emu.emulator import Emulator
from vlp16emu.errors import InputError
from vlp16emu.scan import Scan
from vlp16emu.sensor.beams import BeamTable

_TURNS = 2.2
"""Of the rotor: so long a span holds a whole revolution wherever it begins, also of a motor that is off its speed."""


class Mark(NamedTuple):
    """Something wrong between two azimuths of a sweep."""

    begin_deg: float
    end_deg: float
    what: str


class Sweep(NamedTuple):
    """A revolution of the sensor."""

    scan: Scan
    world_m: NDArray[np.float64]
    """(n, 3) its points in the world."""
    marks: tuple[Mark, ...] = ()


class Sweeps(Protocol):
    """Where sweeps come from."""

    @property
    def beams(self) -> BeamTable:
        """Of the sensor."""

    @property
    def last_s(self) -> float:
        """Start of the last sweep, since the first."""

    @property
    def step_s(self) -> float:
        """From sweep to sweep, about."""

    def at(self, time_s: float) -> Sweep:
        """Sweep that begins first after a time."""


class SceneSweeps:
    """Sweeps of a scene's sensor, with labels.

    Parameters
    ----------
    unit : of a rig, from 1

    Raises
    ------
    InputError
        where there is no such unit
    """

    def __init__(self, emulator: Emulator, unit: int = 1) -> None:
        units = emulator.parts.units
        if unit > len(units):
            raise InputError("--unit", f"found {unit}", f"at most {len(units)}, the sensors of the scene")
        self._emulator, self._unit, self.beams = emulator, unit, units[unit - 1].head.beams
        self.step_s = 60.0 / emulator.scenario.sensor.rpm
        end_s = min(emulator.scenario.duration_s, emulator.parts.motion.run_time_s)
        self._span_s = min(_TURNS * self.step_s, end_s)
        self.last_s = end_s - self._span_s

    def at(self, time_s: float) -> Sweep:
        """See `Sweeps`.

        Raises
        ------
        InputError
            where the run is shorter than a revolution
        """
        begin_s = float(np.clip(time_s, 0.0, self.last_s))
        scans = self._emulator.scans(start_s=begin_s, duration_s=self._span_s, unit=self._unit, truth=True)
        if (scan := next(scans, None)) is None:
            raise InputError("duration_s", f"found {self._span_s:g} s", "a whole revolution of the sensor")
        world_T_sensor = self._emulator.world_T_sensor(scan.t_ns, unit=self._unit)
        turned = np.einsum("nij,nj->ni", world_T_sensor[:, :3, :3], scan.xyz_m)
        return Sweep(scan, turned + world_T_sensor[:, :3, 3])
