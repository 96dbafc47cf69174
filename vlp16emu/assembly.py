"""From the sections of a scenario to the parts of an emulator. Builds no geometry yet."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vlp16emu.device import GpsInput
from vlp16emu.motion import Gait, Motion, Path, Standing, Walking
from vlp16emu.scenario import Scenario
from vlp16emu.scenario.motion import Static
from vlp16emu.scenario.world import Hall as HallSection
from vlp16emu.sensor import BEAM_TABLES, Clock, Head, Rotor
from vlp16emu.types import HeightField, SensorModel, World
from vlp16emu.units import seconds_to_ns
from vlp16emu.world import Box, Forest, Hall, Pole, SpeciesMix, Sphere, Terrain

__all__ = ["Parts", "assemble"]

_STRAY_M = 1.0
"""How far the sensor may be from its path over the ground: sway, and lasers off the centre."""


@dataclass(frozen=True, slots=True)
class Parts:
    """What an emulator is made of."""

    head: Head
    motion: Motion
    world: World
    gps: GpsInput


def assemble(scenario: Scenario) -> Parts:
    """Make the parts that a scenario describes.

    Raises
    ------
    InputError
        where a part cannot be made of what its section says
    """
    section = scenario.world
    if isinstance(section, HallSection):
        motion, _ = _motion(scenario, lambda x_m, _y_m: np.zeros_like(x_m))
        return Parts(_head(scenario), motion, _hall(section), _gps(scenario))
    terrain = Terrain(seed=scenario.seed, **section.terrain.model_dump())
    motion, path_xy_m = _motion(scenario, terrain.height_m)
    forest = Forest(
        seed=scenario.seed,
        terrain=terrain,
        stems_per_ha=section.stems_per_ha,
        species=[SpeciesMix(**share.model_dump()) for share in section.species],
        path_clearance_m=section.path_clearance_m,
        path_xy_m=path_xy_m,
        reach_m=scenario.sensor.max_range_m + _STRAY_M,
    )
    return Parts(_head(scenario), motion, forest, _gps(scenario))


def _hall(section: HallSection) -> Hall:
    """Make the room."""
    return Hall(
        length_m=section.length_m,
        width_m=section.width_m,
        height_m=section.height_m,
        wall_reflectance=section.wall_reflectance,
        boxes=[Box(**box.model_dump()) for box in section.boxes],
        poles=[Pole(**pole.model_dump()) for pole in section.poles],
        spheres=[Sphere(**sphere.model_dump()) for sphere in section.spheres],
    )


def _motion(scenario: Scenario, height_m: HeightField) -> tuple[Motion, NDArray[np.float64]]:
    """Motion over the given ground, and its way on the map (n, 2)."""
    section = scenario.motion
    if isinstance(section, Static):
        xy_m = np.array([[section.x_m, section.y_m]])
        position_m = np.append(xy_m[0], height_m(xy_m[:, 0], xy_m[:, 1])[0] + section.height_m)
        return Standing(position_m, section.yaw_deg, section.pitch_deg, section.roll_deg), xy_m
    path = Path(np.array(section.way_points_m), height_m)
    walking = Walking(
        path,
        start_ns=scenario.start_ns,
        speed_m_s=section.speed_m_s,
        sensor_height_m=section.sensor_height_m,
        pitch_deg=section.pitch_deg,
        roll_deg=section.roll_deg,
        gait=Gait(**section.gait.model_dump()),
    )
    return walking, path.xy_m


def _head(scenario: Scenario) -> Head:
    """Make the sensor proper."""
    section = scenario.sensor
    rotor = Rotor(
        rpm=section.rpm,
        start_azimuth_deg=section.start_azimuth_deg,
        eccentricity_deg=section.eccentricity_deg,
        eccentricity_phase_deg=section.eccentricity_phase_deg,
        noise_deg=section.azimuth_noise_deg,
        seed=scenario.seed,
    )
    clock = Clock(
        locked=scenario.gps.connected,
        power_up_ns=scenario.start_ns - seconds_to_ns(section.powered_for_s),
        error_ppm=section.clock_error_ppm,
    )
    return Head(BEAM_TABLES[SensorModel(section.model)], rotor, clock, scenario.start_ns)


def _gps(scenario: Scenario) -> GpsInput:
    """Make what is wired to the sensor."""
    return GpsInput(scenario.gps.connected, seconds_to_ns(scenario.gps.sentence_delay_s))
