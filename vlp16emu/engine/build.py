"""From the sections of a scenario to the parts of an emulator: heads, receivers, carrier and world.

Builds no geometry yet.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from vlp16emu.elementary import norm
from vlp16emu.engine.changes import clock_spans, silences_ns, spans_of, spins, wobbles
from vlp16emu.engine.gps import GpsInput
from vlp16emu.engine.optics import Optics
from vlp16emu.engine.timeline import Timeline
from vlp16emu.motion import Mount
from vlp16emu.motion.carrier import make_carrier
from vlp16emu.motion.imu import ImuSampler
from vlp16emu.motion.live_settings import takes_poses
from vlp16emu.motion.mount import mounted
from vlp16emu.motion.pose import Motion
from vlp16emu.packets import FACTORY_LINK, Link
from vlp16emu.random import Purpose, generator
from vlp16emu.raycast.beam import LINE, Footprint
from vlp16emu.returns.detector import UnitDetector, threshold_of
from vlp16emu.scenario import Scenario
from vlp16emu.scenario.events import Event
from vlp16emu.sensor.beams import beams_of, with_angle_errors
from vlp16emu.sensor.head import Head
from vlp16emu.sensor.rotor import Clock, Encoder, Rotor, Swing
from vlp16emu.sensor.settings import FreeSensor, Sensor, on_the_wire
from vlp16emu.types import ReturnMode, World
from vlp16emu.units import seconds_to_ns
from vlp16emu.world.site import Sway

_OF_WORLD: tuple[Callable[[Scenario], object], ...] = (
    lambda scenario: (scenario.world, scenario.world_seed, scenario.wind),
    lambda scenario: (scenario.motion, scenario.motion_seed, scenario.gps, scenario.start_ns),
    lambda scenario: [(sensor.max_range_m, mount) for sensor, mount in _sensors(scenario)],
)
"""What decides it."""


def seed_of(scenario: Scenario, unit: int) -> int:
    """Seed of all that is random in a unit."""
    if unit == 0:
        return scenario.sensor_seed
    own = scenario.rig[unit - 1].seed
    return int(generator(scenario.sensor_seed, Purpose.UNIT, unit).integers(2**63)) if own is None else own


def link_of(section: Sensor, unit: int) -> Link:
    """Give a unit its addresses; the factory numbers its MAC addresses on."""
    return Link(
        source_mac=FACTORY_LINK.source_mac[:-1] + bytes([FACTORY_LINK.source_mac[-1] + unit]),
        destination_mac=FACTORY_LINK.destination_mac,
        source=section.address,
        destination=FACTORY_LINK.destination,
        data_port=section.data_port,
        position_port=section.position_port,
    )


def head_of(
    scenario: Scenario, section: Sensor | FreeSensor, seed: int, events: Sequence[Event], gps: GpsInput
) -> Head:
    """Make a sensor proper."""
    start_ns, held = scenario.start_ns, getattr(section, "phase_lock_deg", None) is not None
    swings = Swing.sample(seed, 0.0 if held else section.speed_error_rpm, section.speed_wander_rpm)
    rotor = Rotor(spins(section, events, start_ns), Encoder.of_unit(section, seed), wobbles(events), swings)
    beams = with_angle_errors(
        beams_of(section),
        elevation_error_deg=scenario.noise.elevation_error_deg,
        azimuth_error_deg=scenario.noise.azimuth_error_deg,
        seed=seed,
    )
    clock = Clock(clock_spans(section, events, gps, start_ns))
    return Head(beams, rotor, clock, start_ns)


def beam_of(scenario: Scenario, seed: int) -> Footprint:
    """Make the light of a pulse; light without width where the scene wants no more."""
    if scenario.beam.model == "none":
        return LINE
    detector, seen = scenario.detector, (0.0, 0.0)
    if scenario.noise.weak_echoes_lost:
        seen = threshold_of(detector)
    return Footprint(scenario.beam, seed, detector.resolution_m, *seen)


def detector_of(scenario: Scenario, sensor: Sensor | FreeSensor, seed: int, lasers: int) -> UnitDetector:
    """Make the receiver of a sensor, in the weather of the run."""
    return UnitDetector.of_unit(
        scenario.detector,
        scenario.noise,
        scenario.weather,
        seed=seed,
        mode=ReturnMode(sensor.return_mode),
        min_range_m=sensor.min_range_m,
        max_range_m=sensor.max_range_m,
        lasers=lasers,
        power_up_ns=scenario.start_ns - seconds_to_ns(sensor.powered_for_s),
    )


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
    detector: UnitDetector
    timeline: Timeline
    """Which pulses are sent, and in which packets; nothing of a sensor without packets."""
    optics: Optics
    """What its window and its lasers let through."""
    gps: GpsInput
    """What it gets of the GPS receiver."""

    @property
    def link(self) -> Link:
        """From where to where it sends.

        Raises
        ------
        ScenarioError
            where it has no packets
        """
        return link_of(on_the_wire(self.section), self.number)


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
    wind: Sway | None
    """What moves its trees."""
    gps: GpsInput
    """What the receiver sends; what each unit gets of it is the unit's."""

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


class Like(Protocol):
    """Another run, whose world may be this one's too."""

    @property
    def scenario(self) -> Scenario:
        """What decides it."""

    @property
    def parts(self) -> Parts:
        """What it is made of."""


def in_one_world(one: Scenario, other: Scenario) -> bool:
    """Whether runs go the same way through the same world, so that only their sensors may differ."""
    return all(of_world(one) == of_world(other) for of_world in _OF_WORLD) and not takes_poses(one.motion)


def assemble(scenario: Scenario, like: Like | None = None) -> Parts:
    """Make the parts that a scenario describes.

    Parameters
    ----------
    like : where it is in one world with this one its carrier and world are these too

    Raises
    ------
    InputError
        where a part cannot be made of what its section says
    """
    if like and in_one_world(scenario, like.scenario):
        carrier, world, wind = like.parts.carrier, like.parts.world, like.parts.wind
    else:
        carrier, world, wind = _world(scenario)
    return Parts(
        units=tuple(
            _unit(scenario, number, mounted(carrier, mount, scenario.start_ns))
            for number, (_, mount) in enumerate(_sensors(scenario))
        ),
        carrier=carrier,
        imu=_imu(scenario, carrier),
        world=world,
        wind=wind,
        gps=GpsInput.of(scenario.gps, (), scenario.start_ns),
    )


def _world(scenario: Scenario) -> tuple[Motion, World, Sway | None]:
    """Make the carrier, the world that it goes through, and what moves its trees."""
    sensors, section, seed = _sensors(scenario), scenario.world, scenario.world_seed
    reach_m = _STRAY_M + max(sensor.max_range_m + float(norm(np.array(mount.lever_arm_m))) for sensor, mount in sensors)
    site = section.site(seed)
    carrier, path_xy_m = make_carrier(
        scenario.motion,
        site.height_m,
        site.name,
        origin_m=site.origin_m,
        gps=scenario.gps,
        reach_m=scenario.sensor.max_range_m,
        start_ns=scenario.start_ns,
        seed=scenario.motion_seed,
        obstacles=site.obstacles,
    )
    world, wind = site.world(
        path_xy_m,
        reach_m=reach_m,
        farthest_m=max(sensor.max_range_m for sensor, _ in sensors),
        wind=scenario.wind,
        start_ns=scenario.start_ns,
    )
    return carrier, world, wind


def _imu(scenario: Scenario, carrier: Motion) -> ImuSampler | None:
    if (imu := scenario.imu) is None:
        return None
    motion = mounted(carrier, imu.mount, scenario.start_ns)
    return ImuSampler(motion, imu, start_ns=scenario.start_ns, seed=scenario.sensor_seed)


def _sensors(scenario: Scenario) -> list[tuple[Sensor | FreeSensor, Mount]]:
    return [(scenario.sensor, scenario.motion.mount), *((unit, unit.mount) for unit in scenario.rig)]


def with_events(parts: Parts, scenario: Scenario) -> Parts:
    """Give the parts of a run other events, those of the scenario; the carrier and the world are the same."""
    return replace(parts, units=tuple(_unit(scenario, unit.number, unit.motion) for unit in parts.units))


def _unit(scenario: Scenario, number: int, motion: Motion) -> Unit:
    section, mount = _sensors(scenario)[number]
    events = [event for event in scenario.events if event.unit == number + 1]
    seed, gps = seed_of(scenario, number), GpsInput.of(scenario.gps, events, scenario.start_ns)
    head = head_of(scenario, section, seed, events, gps)
    return Unit(
        number=number,
        section=section,
        mount=mount,
        seed=seed,
        head=head,
        motion=motion,
        beam=beam_of(scenario, seed),
        detector=detector_of(scenario, section, seed, len(head.beams.elevation_deg)),
        timeline=Timeline(head, spans_of(section, events), silences_ns(events)),
        optics=Optics.of(events, scenario.start_ns),
        gps=gps,
    )
