"""From the tables of the sensor to the head, the receiver of its light, and what is wired to it."""

from vlp16emu.device import GpsInput
from vlp16emu.packets import FACTORY_LINK, Link
from vlp16emu.random import Purpose, generator
from vlp16emu.raycast import LINE, BeamModel, Footprint
from vlp16emu.returns import Detector, Noise, make_law, threshold_of
from vlp16emu.scenario import Scenario
from vlp16emu.scenario.sensor import FreeSensor, Sensor
from vlp16emu.sensor import BEAM_TABLES, BeamTable, Clock, Head, Rotor, free_beams, with_angle_errors
from vlp16emu.types import ReturnMode, SensorModel
from vlp16emu.units import S_NS, seconds_to_ns

__all__ = ["beam_of", "detector_of", "gps_of", "head_of", "link_of", "seed_of"]


def seed_of(scenario: Scenario, unit: int) -> int:
    """Seed of all that is random in a unit; that of the scene for unit 0."""
    if unit == 0:
        return scenario.seed
    own = scenario.rig[unit - 1].seed
    return int(generator(scenario.seed, Purpose.UNIT, unit).integers(2**63)) if own is None else own


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


def head_of(scenario: Scenario, section: Sensor | FreeSensor, seed: int) -> Head:
    """Make a sensor proper."""
    rotor = Rotor(
        rpm=section.rpm,
        start_azimuth_deg=_start_azimuth_deg(section, scenario.start_ns),
        eccentricity_deg=section.eccentricity_deg,
        eccentricity_phase_deg=section.eccentricity_phase_deg,
        noise_deg=section.azimuth_noise_deg,
        seed=seed,
    )
    clock = Clock(
        locked=scenario.gps.connected,
        power_up_ns=scenario.start_ns - seconds_to_ns(section.powered_for_s),
        error_ppm=section.clock_error_ppm,
    )
    beams = with_angle_errors(
        _beams(section),
        elevation_error_deg=scenario.noise.elevation_error_deg,
        azimuth_error_deg=scenario.noise.azimuth_error_deg,
        seed=seed,
    )
    return Head(beams, rotor, clock, scenario.start_ns)


def _start_azimuth_deg(section: Sensor | FreeSensor, start_ns: int) -> float:
    """Where the rotor stands at the first pulse, also where it is where it must be at each UTC second."""
    if not isinstance(section, Sensor) or section.phase_lock_deg is None:
        return section.start_azimuth_deg
    # Speeds are multiples of 60 rpm, so there are whole turns in a second.
    turned_ns = start_ns % S_NS * (section.rpm // 60) % S_NS
    return (section.phase_lock_deg + 360.0 * turned_ns / S_NS) % 360.0


def _beams(section: Sensor | FreeSensor) -> BeamTable:
    """Take the beam table of a model, or make the one that the scene describes."""
    if isinstance(section, Sensor):
        return BEAM_TABLES[SensorModel(section.model)]
    return free_beams(
        section.beam_elevations_deg,
        lens_radius_m=section.lens_radius_m,
        azimuth_resolution_deg=section.azimuth_resolution_deg,
        rpm=section.rpm,
    )


def beam_of(scenario: Scenario, seed: int) -> Footprint:
    """Make the light of a pulse; light without width where the scene wants no more."""
    section = scenario.beam
    if section.model == "none":
        return LINE
    detector = scenario.detector
    seen, noise = 0.0, 0.0
    if scenario.noise.weak_echoes_lost:
        seen, noise = threshold_of(detector.range_at_10_percent_m, detector.threshold_snr)
    return Footprint(
        model=BeamModel(section.model),
        rays=section.rays,
        target_m=section.target_m,
        resolution_m=detector.resolution_m,
        spot_m=(1e-3 * section.spot_mm[0], 1e-3 * section.spot_mm[1]),
        divergence_rad=(1e-3 * section.divergence_mrad[0], 1e-3 * section.divergence_mrad[1]),
        seed=seed,
        threshold=seen,
        amplitude_noise=noise,
    )


def detector_of(scenario: Scenario, sensor: Sensor | FreeSensor, seed: int, lasers: int) -> Detector:
    """Make the receiver of a sensor, in the weather of the run."""
    noise = Noise(**scenario.noise.model_dump(exclude={"preset", "elevation_error_deg", "azimuth_error_deg"}))
    law = make_law(
        seed=seed,
        mode=ReturnMode(sensor.return_mode),
        min_range_m=sensor.min_range_m,
        max_range_m=sensor.max_range_m,
        **scenario.detector.model_dump(),
        **scenario.weather.model_dump(),
        noise=noise,
    )
    power_up_ns = scenario.start_ns - seconds_to_ns(sensor.powered_for_s)
    return Detector.of_unit(law, noise, lasers=lasers, power_up_ns=power_up_ns)


def gps_of(scenario: Scenario) -> GpsInput:
    """Make what is wired to the sensor."""
    return GpsInput(scenario.gps.connected, seconds_to_ns(scenario.gps.sentence_delay_s))
