"""Sweeps at a time: of a scene computed when they are asked for, of a capture read as it goes."""

from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vlp16emu.emulator import Emulator
from vlp16emu.errors import InputError
from vlp16emu.scan import Scan, decode

__all__ = ["CaptureSweeps", "SceneSweeps", "Sweeps"]

_KEPT = 300
"""Sweeps of a capture that are kept, some 300 MB; one before them is read from the file's begin again."""
_TURNS = 2.2
"""Of the rotor: so long a span holds a whole revolution wherever it begins, also of a motor that is off its speed."""


class Sweeps(Protocol):
    """Where sweeps come from."""

    @property
    def last_s(self) -> float:
        """Start of the last sweep, since the first."""

    @property
    def step_s(self) -> float:
        """From sweep to sweep, about."""

    def at(self, time_s: float) -> tuple[Scan, NDArray[np.float64]]:
        """Sweep that begins first after a time, and its points (n, 3) in the world."""


class SceneSweeps:
    """Sweeps of a scene's first sensor, with labels."""

    def __init__(self, emulator: Emulator) -> None:
        self._emulator = emulator
        self.step_s = 60.0 / emulator.scenario.sensor.rpm
        end_s = min(emulator.scenario.duration_s, emulator.parts.motion.run_time_s)
        self._span_s = min(_TURNS * self.step_s, end_s)
        self.last_s = end_s - self._span_s

    def at(self, time_s: float) -> tuple[Scan, NDArray[np.float64]]:
        """See `Sweeps`.

        Raises
        ------
        InputError
            where the run is shorter than a revolution
        """
        begin_s = float(np.clip(time_s, 0.0, self.last_s))
        scans = self._emulator.scans(start_s=begin_s, duration_s=self._span_s, truth=True)
        if (scan := next(scans, None)) is None:
            raise InputError("duration_s", f"found {self._span_s:g} s", "a whole revolution of the sensor")
        world_T_sensor = self._emulator.world_T_sensor(scan.t_ns)
        turned = np.einsum("nij,nj->ni", world_T_sensor[:, :3, :3], scan.xyz_m)
        return scan, turned + world_T_sensor[:, :3, 3]


class CaptureSweeps:
    """Sweeps of a capture one after another; all of one place, as a capture has no poses."""

    def __init__(self, path: Path) -> None:
        self._path = path
        scans = decode(path)
        first = next(scans, None)
        if first is None:
            raise InputError(str(path), "no whole revolution", "a capture of at least two")
        self._start_ns, last = first.start_ns, first
        self._starts_ns = [first.start_ns]
        for last in scans:
            self._starts_ns.append(last.start_ns)
        self.last_s = (last.start_ns - first.start_ns) / 1e9
        self.step_s = self.last_s / max(len(self._starts_ns) - 1, 1) or 0.1
        self._reading: Iterator[Scan] = iter(())
        self._next = len(self._starts_ns)
        self._held = dict[int, Scan]()

    def at(self, time_s: float) -> tuple[Scan, NDArray[np.float64]]:
        """See `Sweeps`."""
        wanted = int(np.searchsorted(self._starts_ns, self._start_ns + int(time_s * 1e9)))
        wanted = min(wanted, len(self._starts_ns) - 1)
        if wanted not in self._held and wanted < self._next:
            self._reading, self._next = decode(self._path), 0
        while wanted not in self._held:
            self._held[self._next] = next(self._reading)
            self._next += 1
            if len(self._held) > _KEPT:
                del self._held[min(self._held)]
        return self._held[wanted], self._held[wanted].xyz_m.astype(np.float64)
