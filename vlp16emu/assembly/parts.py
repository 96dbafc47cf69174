"""What an emulator is made of."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from vlp16emu.assembly.sensor import beam_of, detector_of, gps_of, head_of, link_of, seed_of
from vlp16emu.device import GpsInput
from vlp16emu.motion import Mount
from vlp16emu.motion.carrier import make_carrier
from vlp16emu.motion.imu import ImuSampler
from vlp16emu.motion.mount import mounted
from vlp16emu.motion.pose import Motion
from vlp16emu.packets import Link
from vlp16emu.raycast import Footprint, Scene
from vlp16emu.returns import Detector
from vlp16emu.scenario import Scenario
from vlp16emu.scenario.sensor import FreeSensor, Sensor, on_the_wire
from vlp16emu.sensor import Head
from vlp16emu.types import Firings, Hits, World
from vlp16emu.world import Hall
from vlp16emu.world.make import ground_name, ground_of, world_of
from vlp16emu.world.stand.sway import TreeSway

__all__ = ["Look", "Parts", "Unit", "assemble"]

_STRAY_M = 1.0
"""How far the carrier may be from its path over the ground: sway, and lasers off the centre."""


@dataclass(frozen=True, slots=True)
class Unit:
    """A sensor on the carrier."""

    number: int
    """Place in the rig, from 0."""
    section: Sensor | FreeSensor
    mount: Mount
    """How it sits on the carrier."""
    seed: int
    """Of all that is random in it."""
    head: Head
    motion: Motion
    """Where it is."""
    beam: Footprint
    """How wide its pulses are."""
    detector: Detector

    @property
    def link(self) -> Link:
        """From where to where it sends.

        Raises
        ------
        ScenarioError
            where it has no packets
        """
        return link_of(on_the_wire(self.section), self.number)


Look = Callable[[Unit, Firings, Hits, Scene], None]
"""A look at a block of pulses of a unit, and at what they met."""


@dataclass(frozen=True, slots=True)
class Parts:
    """What an emulator is made of."""

    units: tuple[Unit, ...]
    """At least one."""
    carrier: Motion
    """Who carries the devices."""
    imu: ImuSampler | None
    world: World
    """At rest."""
    wind: TreeSway | None
    """What moves its trees."""
    gps: GpsInput

    @property
    def head(self) -> Head:
        """That of the first unit, in most scenes the only one."""
        return self.units[0].head

    @property
    def motion(self) -> Motion:
        """That of the first unit."""
        return self.units[0].motion

    @property
    def moves(self) -> bool:
        """Whether anything does: a sensor, or what it sees."""
        return self.wind is not None or any(unit.motion.moves for unit in self.units)


def assemble(scenario: Scenario) -> Parts:
    """Make the parts that a scenario describes.

    Raises
    ------
    InputError
        where a part cannot be made of what its section says
    """
    sensors, section, seed = _sensors(scenario), scenario.world, scenario.seed
    reach_m = _STRAY_M + max(sensor.max_range_m + math.hypot(*mount.lever_arm_m) for sensor, mount in sensors)
    ground = ground_of(section, seed)
    carrier, path_xy_m = make_carrier(
        scenario.motion,
        ground.height_m,
        ground_name(section, seed),
        origin_m=(0.0, 0.0, 0.0) if isinstance(section, Hall) else section.origin_m,
        gps=scenario.gps,
        reach_m=scenario.sensor.max_range_m,
        start_ns=scenario.start_ns,
        seed=seed,
    )
    world, wind = world_of(
        section,
        scenario.wind,
        seed=seed,
        start_ns=scenario.start_ns,
        ground=ground,
        path_xy_m=path_xy_m,
        reach_m=reach_m,
        farthest_m=max(sensor.max_range_m for sensor, _ in sensors),
    )
    return Parts(
        units=tuple(_unit(scenario, number, carrier) for number in range(len(sensors))),
        carrier=carrier,
        imu=_imu(scenario, carrier),
        world=world,
        wind=wind,
        gps=gps_of(scenario),
    )


def _imu(scenario: Scenario, carrier: Motion) -> ImuSampler | None:
    """Mount the inertial measurement unit, if there is one."""
    if (imu := scenario.imu) is None:
        return None
    motion = mounted(carrier, imu.mount, scenario.start_ns)
    return ImuSampler(motion, imu, start_ns=scenario.start_ns, seed=scenario.seed)


def _sensors(scenario: Scenario) -> list[tuple[Sensor | FreeSensor, Mount]]:
    """Give the tables of all units, and how they are mounted."""
    return [(scenario.sensor, scenario.motion.mount), *((unit, unit.mount) for unit in scenario.rig)]


def _unit(scenario: Scenario, number: int, carrier: Motion) -> Unit:
    """Make a sensor, and mount it."""
    section, mount = _sensors(scenario)[number]
    seed = seed_of(scenario, number)
    head = head_of(scenario, section, seed)
    return Unit(
        number=number,
        section=section,
        mount=mount,
        seed=seed,
        head=head,
        motion=mounted(carrier, mount, scenario.start_ns),
        beam=beam_of(scenario, seed),
        detector=detector_of(scenario, section, seed, len(head.beams.elevation_deg)),
    )
