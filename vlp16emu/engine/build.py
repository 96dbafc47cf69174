"""Assembly of an emulator's parts, from the sections of a scenario.

Parts are heads, receivers, carrier and world. No geometry is built here.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from vlp16emu.doors import Part
from vlp16emu.elementary import norm
from vlp16emu.engine.gps_input import GpsInput
from vlp16emu.engine.state import SensorState
from vlp16emu.engine.timeline import Timeline, stretches_of
from vlp16emu.motion.mount import device_motion, true_mount
from vlp16emu.motion.pose import Motion
from vlp16emu.motion.settings import Gps, Mount
from vlp16emu.packets import FACTORY_LINK, Link, positions_from_ns
from vlp16emu.random import Purpose, generator, uniform
from vlp16emu.raycast.beam import LINE, Footprint
from vlp16emu.raycast.caster import Geometry
from vlp16emu.returns.detector import UnitDetector, threshold_of
from vlp16emu.scenario import Scenario
from vlp16emu.scenario.model import InertialSection
from vlp16emu.sensor.beams import with_angle_errors
from vlp16emu.sensor.clock import clock_of
from vlp16emu.sensor.head import Head
from vlp16emu.sensor.operation import spins
from vlp16emu.sensor.power_up import counters_of, with_start_state
from vlp16emu.sensor.rotor import Encoder, Rotor, Swing
from vlp16emu.sensor.settings import Lidar, Sensor, require_packets
from vlp16emu.types import F8, I8, HeightField, Inertial, MovingTrees, ReturnMode, SensorModel, World
from vlp16emu.units import seconds_to_ns
from vlp16emu.world.settings import People

if TYPE_CHECKING:
    from vlp16emu.engine.engine import Engine

_IMU = 1000  # device number of the inertial unit's mount, above all sensors
_LEAST_DELAY_S = 0.001  # of a sentence after its second, and before the next one
_STRAY_M = 1.0
"""Greatest distance of a laser from the carrier's path on the ground: sway, and lasers off the centre."""


@dataclass(frozen=True, slots=True)
class Unit:
    """One sensor on the carrier."""

    number: int  # Place in the rig, from 0
    section: Lidar
    mount: Mount  # Mount on the carrier
    seed: int  # Seed of its random numbers
    head: Head
    motion: Motion  # Motion of the sensor's frame
    beam: Footprint
    detector: UnitDetector
    state: SensorState  # Its settings, power and GPS input over the run
    timeline: Timeline  # Pulses that are sent, and their packets; empty for a sensor without packets

    @property
    def link(self) -> Link:
        """Addresses, ports and counters of its frames.

        Raises ScenarioError if it has no packets.
        """
        section = require_packets(self.section)
        counters = counters_of(self.section, self.seed, self.number)
        return replace(
            FACTORY_LINK,
            source_mac=counters.mac,
            source=section.address,
            data_port=section.data_port,
            position_port=section.position_port,
            identification=counters.identification,
        )

    def world_T_sensor(self, t_ns: I8) -> F8:
        """Return the poses (n, 4, 4) of the sensor in the world, at instants (n,) UTC."""
        poses = self.motion.poses_at(t_ns)
        T = np.zeros((len(t_ns), 4, 4))
        T[:, :3, :3] = poses.world_R_body
        T[:, :3, 3] = poses.world_p_body_m
        T[:, 3, 3] = 1.0
        return T

    @property
    def positions_from_ns(self) -> int:
        """UTC from which its position packets are counted; no later than the first pulse."""
        phase = counters_of(self.section, self.seed, self.number).position_phase
        return positions_from_ns(require_packets(self.section).position_rate, self.head.start_ns, phase)


class Sampler(Protocol):
    """Samples of an inertial unit."""

    def read(self, first: int, count: int) -> Inertial:
        """Return samples, numbered from the start of the run."""

    def late_ns(self, first: int, count: int) -> I8:
        """Return the delays (count,) of the arrival of samples."""


class SamplerOf(Protocol):
    """Function that makes the samples of an inertial unit from its motion."""

    def __call__(self, motion: Motion, imu: InertialSection, *, start_ns: int, seed: int) -> Sampler:
        """Return the samples from the first pulse on."""


class Bystanders(Protocol):
    """People beside the carrier."""

    def among(self, geometry: Geometry) -> Geometry:
        """Return a window of the world with the people in it."""


class BystandersOf(Protocol):
    """Function that makes the people beside a carrier."""

    def __call__(
        self, section: People, carrier: Motion, height_m: HeightField, *, start_ns: int, seed: int
    ) -> Bystanders:
        """Return the people on a carrier's path."""


IMU = Part[SamplerOf]("vlp16emu.extras.imu.sampler:sampler_of")
PEOPLE = Part[BystandersOf]("vlp16emu.extras.people:People")
EVENTS = Part[Callable[[SensorState, Scenario, int], SensorState]](
    "vlp16emu.extras.bench.changes:with_events"
)


@dataclass(frozen=True, slots=True)
class Parts:
    """Parts of an emulator: sensors, carrier and world."""

    units: tuple[Unit, ...]  # At least one
    carrier: Motion  # Motion of the body that carries the devices
    imu: Sampler | None  # Samples of the inertial unit; None without one
    imu_mount: Mount  # True mount of the inertial unit, if there is one
    ground_m: HeightField  # Height of the ground over places
    world: World  # At rest
    wind: MovingTrees | None  # Its trees in the wind; None in still air
    people: Bystanders | None  # People beside the carrier; None without them
    gps: GpsInput  # Signals that the receiver sends; each unit holds what it gets

    @property
    def head(self) -> Head:
        """Head of the first unit, in most scenes the only one."""
        return self.units[0].head

    @property
    def motion(self) -> Motion:
        """Motion of the first unit."""
        return self.units[0].motion

    @property
    def moves(self) -> bool:
        """True if a sensor, or something that it sees, moves."""
        return (
            self.wind is not None or self.people is not None or any(unit.motion.moves for unit in self.units)
        )


def in_one_world(first: Scenario, second: Scenario) -> bool:
    """Return whether two runs follow the same path through the same world; their sensors may differ."""

    def course(scenario: Scenario) -> tuple[object, ...]:
        """Return what decides on the path and the world."""
        world = (scenario.world, scenario.world_seed, scenario.wind)
        motion = (scenario.motion, scenario.motion_seed)
        reach = [(sensor.max_range_m, mount) for sensor, mount in _sensors(scenario)]
        return *world, *motion, scenario.gps, scenario.start_ns, reach

    return not first.motion.takes_poses and course(first) == course(second)


def assemble(scenario: Scenario, like: "Engine | None" = None) -> Parts:
    """Make the parts of a scenario; carrier and world come from `like` if both are in one world.

    Raises InputError if a part cannot be made from its section.
    """
    if like and in_one_world(scenario, like.scenario):
        carrier = like.parts.carrier
        ground_m = like.parts.ground_m
        world = like.parts.world
        wind = like.parts.wind
    else:
        carrier, ground_m, world, wind = _world(scenario)
    start_ns = scenario.start_ns
    imu = scenario.imu
    seed = scenario.sensor_seed
    # A mast bends between the carrier and its sensors; the inertial unit is below it.
    top = scenario.motion.under_sensors(carrier)
    sampler = None
    imu_mount = Mount()
    people = None
    if imu:
        imu_mount = true_mount(imu.mount, seed, _IMU)
        sampler = IMU.load()(device_motion(carrier, imu_mount, start_ns), imu, start_ns=start_ns, seed=seed)
    if scenario.people:
        people = PEOPLE.load()(
            scenario.people, carrier, ground_m, start_ns=start_ns, seed=scenario.motion_seed
        )
    receiver = gps_input(scenario.gps, seed_of(scenario, 0))
    mounts = [true_mount(mount, seed, device) for device, mount in enumerate(mounts_of(scenario))]
    units = tuple(
        _unit(scenario, number, mount, device_motion(top, mount, start_ns))
        for number, mount in enumerate(mounts)
    )
    return Parts(units, carrier, sampler, imu_mount, ground_m, world, wind, people, receiver)


def with_events(parts: Parts, scenario: Scenario) -> Parts:
    """Return the parts of a run with the events of `scenario`; the carrier and the world are the same."""
    units = (_unit(scenario, unit.number, unit.mount, unit.motion) for unit in parts.units)
    return replace(parts, units=tuple(units))


def seed_of(scenario: Scenario, unit: int) -> int:
    """Seed of a unit's random numbers."""
    if unit == 0:
        return scenario.sensor_seed
    set_seed = scenario.rig[unit - 1].seed
    return (
        int(generator(scenario.sensor_seed, Purpose.UNIT, unit).integers(2**63))
        if set_seed is None
        else set_seed
    )


def beam_of(scenario: Scenario, seed: int, blank_m: float) -> Footprint:
    """Return the footprint of a unit's pulses; `LINE` if the scene's beams have no width.

    Nothing nearer than `blank_m` gives an echo.
    """
    if scenario.beam.model == "none":
        return LINE
    seen = threshold_of(scenario.detector) if scenario.noise.weak_echoes_lost else (0.0, 0.0)
    return Footprint(scenario.beam, seed, scenario.detector.resolution_m, *seen, blank_m)


def _world(scenario: Scenario) -> tuple[Motion, HeightField, World, MovingTrees | None]:
    """Make the carrier, the ground, the world that it goes through, and the sway of its trees."""
    sensors = _sensors(scenario)
    section = scenario.world
    seed = scenario.world_seed
    site = section.site(seed)
    carrier, path_xy_m = scenario.motion.carrier(
        site,
        gps=scenario.gps,
        reach_m=scenario.sensor.max_range_m,
        start_ns=scenario.start_ns,
        seed=scenario.motion_seed,
    )
    world, wind = site.world(
        path_xy_m,
        reach_m=reach_of_path_m(scenario),
        farthest_m=max(sensor.max_range_m for sensor, _ in sensors),
        wind=scenario.wind,
        start_ns=scenario.start_ns,
    )
    return carrier, site.height_m, world, wind


def reach_of_path_m(scenario: Scenario) -> float:
    """Return the distance from the carrier's path up to which a sensor may hit something."""
    sensors = _sensors(scenario)
    return _STRAY_M + max(
        sensor.max_range_m + float(norm(np.array(mount.lever_arm_m))) for sensor, mount in sensors
    )


def mounts_of(scenario: Scenario) -> list[Mount]:
    """Return the nominal mounts of all sensors, as their users know them."""
    return [scenario.motion.mount, *(unit.mount for unit in scenario.rig)]


def _sensors(scenario: Scenario) -> list[tuple[Lidar, Mount]]:
    return list(zip([scenario.sensor, *scenario.rig], mounts_of(scenario), strict=True))


def _unit(scenario: Scenario, number: int, mount: Mount, motion: Motion) -> Unit:
    given = [scenario.sensor, *scenario.rig][number]
    seed = seed_of(scenario, number)
    section = with_start_state(given, seed)
    state = SensorState.steady(section, gps_input(scenario.gps, seed_of(scenario, 0)))
    if scenario.events:
        state = EVENTS.load()(state, scenario, number)
    head = _head(scenario, section, seed, state)
    mode = ReturnMode(section.return_mode)
    detector = UnitDetector.of_unit(
        scenario.detector,
        scenario.noise.of_model(section.unit_noise),
        scenario.weather,
        seed=seed,
        mode=mode,
        min_range_m=section.min_range_m,
        max_range_m=section.max_range_m,
        elevation_deg=head.beams.elevation_deg,
        power_up_ns=_power_up_ns(scenario, section),
    )
    # A sensor without packets sends in one stretch.
    model = SensorModel(section.model) if isinstance(section, Sensor) else SensorModel.VLP_16
    timeline = Timeline(head, stretches_of(state.operation, model))
    beam = beam_of(scenario, seed, section.min_range_m)
    return Unit(number, section, mount, seed, head, motion, beam, detector, state, timeline)


def _power_up_ns(scenario: Scenario, section: Lidar) -> int:
    return scenario.start_ns - seconds_to_ns(section.powered_for_s or 0.0)


def gps_input(gps: Gps, seed: int) -> GpsInput:
    """Return the undisturbed input of a sensor from a receiver, as the table of the scene describes it.

    The seed is that of the first sensor, which all share a receiver with.
    """
    delay_s = gps.sentence_delay_s
    if gps.sentence_delay_spread_s:
        drawn = float(uniform(seed, Purpose.RECEIVER, 0, 1)[0])
        delay_s += gps.sentence_delay_spread_s * (2.0 * drawn - 1.0)
        delay_s = min(max(delay_s, _LEAST_DELAY_S), 1.0 - _LEAST_DELAY_S)
    return GpsInput(
        gps.connected, seconds_to_ns(delay_s), seconds_to_ns(gps.pps_window_s), gps.requires_valid
    )


def _head(scenario: Scenario, section: Lidar, seed: int, state: SensorState) -> Head:
    start_ns = scenario.start_ns
    error_rpm = section.speed_error_rpm
    swings = Swing.sample(seed, error_rpm, section.speed_wander_rpm, is_exact=section.rotation_spread == 0.0)
    drift, swings = (swings[0], swings[1:]) if error_rpm else (None, swings)
    rotor = Rotor(
        spins(section.start_azimuth_deg or 0.0, state.operation, start_ns),
        Encoder.of_unit(section, seed),
        wobbles=state.wobbles,
        swings=swings,
        drift=drift,
        locks_ns=state.operation.where(lambda operation: operation.settings.is_locked),
    )
    beams = with_angle_errors(
        section.beam_table(),
        elevation_error_deg=scenario.noise.elevation_error_deg,
        azimuth_error_deg=scenario.noise.azimuth_error_deg,
        seed=seed,
    )
    clock = clock_of(section, _power_up_ns(scenario, section), state.gps.pps, state.clock_events)
    return Head(beams, rotor, clock, start_ns)
