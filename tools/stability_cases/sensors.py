"""Heads at their limits: rotor speeds, turning bodies, steep beams, and angles after days."""

import math
from collections.abc import Iterator
from fractions import Fraction

import numpy as np
from mpmath import mp, mpf

from stability_cases.case import Row, case
from vlp16emu import Emulator
from vlp16emu.engine import assemble
from vlp16emu.packets import DATA_BYTES, DISTANCE_LSB_M, LASERS, decode_data
from vlp16emu.packets.layout import BLOCK_PERIOD_NS, BLOCKS_PER_PACKET
from vlp16emu.scenario import load
from vlp16emu.sensor.beams import LASER_NS, SEQUENCE_NS
from vlp16emu.sensor.clock import ClockSpan
from vlp16emu.sensor.rotor import Encoder, Rotor, Spin
from vlp16emu.types import F8, PacketKind
from vlp16emu.units import HOUR_NS, S_NS, US_NS

_BARE = ("world.boxes=[]", "world.poles=[]", "world.spheres=[]", "motion.height_m=2.5")
_HALF_M = np.array([15.0, 9.0])
_HEIGHT_M = 6.0
_TURN_DEG_S = 500.0
_BODY = (f"motion.mount.spin_hz={_TURN_DEG_S / 360}", "motion.mount.spin_axis=[0.3, -0.2, 1.0]")
_LAST_NS = SEQUENCE_NS + (LASERS - 1) * LASER_NS
_STEPS = 1 + _LAST_NS / BLOCK_PERIOD_NS / (BLOCKS_PER_PACKET - 1)
"""Steps of the azimuth: the floored one, and what the last pulse of a block adds over its packet."""
_DAYS_NS = 7 * 86_400 * S_NS


def _off_walls_m(world_m: F8) -> tuple[F8, F8]:
    """Return distances (n,) of points to the nearest wall, floor or ceiling, and its number (n,)."""
    x, y, z = world_m.T
    gaps_m = np.abs([x - _HALF_M[0], x + _HALF_M[0], y - _HALF_M[1], y + _HALF_M[1], z, z - _HEIGHT_M])
    return gaps_m.min(axis=0), gaps_m.argmin(axis=0)


@case("closed form: the planes of a hall; the bound is that of the wire")
def turning_body() -> Iterator[Row]:
    """Rotors of 300 and 1200 rpm on a body that turns by 500 deg/s about a tilted axis, decoded from packets.

    The bound is half of 2 mm along the beam, across it the steps of the azimuth and what the body turns in a
    microsecond of the stamp, and 0.1 mm for float32.
    """
    for rpm in (300, 1200):
        scenario = load("static_bench", [*_BARE, *_BODY, f"sensor.rpm={rpm}"])
        emulator = Emulator(scenario)
        payloads = [p.payload for p in emulator.packets(0.0, 0.72) if p.kind is PacketKind.DATA]
        data = np.frombuffer(b"".join(payloads), np.uint8).reshape(-1, DATA_BYTES)
        points = decode_data(data, keep_no_returns=False)
        poses = emulator.parts.motion.poses_at(scenario.start_ns + points.time_ns)
        turned_m = np.einsum("nij,nj->ni", poses.world_R_body, points.xyz_m)
        off_m, wall = _off_walls_m(turned_m + poses.world_p_body_m)
        across_deg = 0.01 * _STEPS + _TURN_DEG_S * US_NS / S_NS
        bound_m = np.hypot(DISTANCE_LSB_M / 2, np.radians(across_deg) * points.distance_m) + 1e-4
        yield Row(f"{rpm} rpm: error over its bound, {len(off_m)} points", float((off_m / bound_m).max()), 1)
        yield Row(f"{rpm} rpm: mean error, m", float(off_m.mean()), 1e-3)
        yield Row(f"{rpm} rpm: walls, floor or ceiling not seen", 6 - len(np.unique(wall)), 0)


@case("closed form: the planes of a hall")
def rotor_speeds() -> Iterator[Row]:
    """Rotors of 60 to 3600 rpm, with steps of 0.05 and 2 degrees, on a body that turns by 500 deg/s."""
    for rpm, step_deg in ((60, 2.0), (61, 0.05), (601, 0.2), (3599, 2.0), (3600, 0.05)):
        keys = f"rpm={rpm},azimuth_resolution_deg={step_deg},max_range_m=60.0"
        scenario = load("static_bench", [*_BARE, *_BODY, f'sensor={{model="free",preset="steady",{keys}}}'])
        # Truth before the wire: each point with the pose of its own pulse.
        returns = list(Emulator(scenario).returns(0.0, 0.02))
        origin = np.concatenate([r.firings.origin_m for r in returns])
        direction = np.concatenate([r.firings.direction for r in returns])
        distance_m = np.concatenate([r.distance_m[..., 0] for r in returns])
        off_m, _ = _off_walls_m((origin + distance_m[..., None] * direction).reshape(-1, 3))
        yield Row("points off the walls, m", float(off_m.max()), 1e-5)
        turned = np.concatenate([r.firings.azimuth_deg[:, 0] for r in returns])
        first = returns[0].firings.t_ns[0, 0]
        sequence_ns = round(step_deg / (6 * rpm) * S_NS)
        times = np.concatenate([r.firings.t_ns[:, 0] for r in returns])
        yield Row("time of a firing sequence, ns", int(np.ptp((times - first) % sequence_ns)), 0)
        turns = [Fraction(6 * rpm * int(t - first), S_NS) for t in times.tolist()]
        exact = [float((Fraction(1, 10) + turn) % 360) for turn in turns]
        yield Row("azimuth, deg", _apart_deg(turned, np.array(exact)), 1e-10)


def _apart_deg(a: F8, b: F8) -> float:
    """Return the largest difference of angles, over the wrap."""
    return float(np.abs((a - b + 180.0) % 360.0 - 180.0).max())


@case("exact fractions")
def rotor_after_days() -> Iterator[Row]:
    """The angle of rotors of 60 to 3600 rpm after seven days, 36 million turns, and beside north."""
    around_ns = [0, 1, _DAYS_NS - 1, _DAYS_NS, _DAYS_NS + 55_296, 123_456_789_012_345, 3_333_333_333_333]
    for rpm in (60, 61, 300, 1200, 3599, 3600):
        rotor = Rotor((Spin(0, 0.1, float(rpm)),), Encoder(seed=1))
        # The first nanoseconds at and after north near the end of the seventh day.
        turn = Fraction(60 * S_NS, rpm)
        north = math.ceil((math.floor(_DAYS_NS / turn) - Fraction(1, 3600)) * turn)
        times_ns = [*around_ns, north - 1, north, north + 1]
        exact = [float((Fraction(1, 10) + Fraction(6 * rpm * t, S_NS)) % 360) for t in times_ns]
        found = rotor.angle_deg(np.array(times_ns, np.int64))
        yield Row(f"{rpm} rpm: angle, deg", _apart_deg(found, np.array(exact)), 1e-9)
        outside = (found < 0) | (found >= 360)
        yield Row("angles out of 0 to 360", int(outside.sum()), 0)


@case("exact integers")
def clock_after_years() -> Iterator[Row]:
    """A free-running clock with an error of up to 200 ppm, 30 years after power-up, beside its wraps."""
    power_up_ns = 1_780_000_000 * S_NS - 10**9 * S_NS
    since_ns = [0, HOUR_NS - 1, HOUR_NS, HOUR_NS + 1, 10 * HOUR_NS - 1, 10**18, 10**18 + 7 * HOUR_NS]
    for ppm in (0.0, 0.3, -200.0, 200.0):
        found = ClockSpan(power_up_ns, 0, ppm).reading(np.array(since_ns, np.int64) + power_up_ns)
        exact = [(t + round(t * Fraction(round(ppm * 10), 10**7))) % HOUR_NS for t in since_ns]
        off = [a - b for a, b in zip(found.tolist(), exact, strict=True)]
        apart = [abs((a + HOUR_NS // 2) % HOUR_NS - HOUR_NS // 2) for a in off]
        # The product of 1e18 ns and the rate error is rounded to float64.
        yield Row(f"{ppm:g} ppm: reading, ns", max(apart), 1 + abs(ppm) * 1e-6 * 10**18 * 2.0**-52)
        out = (found < 0) | (found >= HOUR_NS)
        yield Row("readings out of the hour", int(out.sum()), 0)


def _range_in_hall(origin: F8, direction: F8) -> F8:
    half = np.array([*_HALF_M, 0.0])
    with np.errstate(divide="ignore", invalid="ignore"):
        plus = np.where(direction > 0, np.array([*_HALF_M, _HEIGHT_M]) - origin, -half - origin) / direction
    return np.where(np.abs(direction) < 1e-12, np.inf, plus).min(axis=-1)


@case("closed form: the planes of a hall; mpmath, 30 digits")
def steep_beams() -> Iterator[Row]:
    """From 1 to 1024 beams to 89.9 degrees up and down, also with a lens of 20 cm: origins lie 115 m off."""
    for beams, radius_m in ((1, 0.0), (2, 0.0), (1024, 0.0), (2, 0.2), (1024, 0.2)):
        angles = "elevations_deg=[89.9]" if beams == 1 else f"beams={beams},vertical_fov_deg=[-89.9,89.9]"
        keys = f"{angles},rpm=600,azimuth_resolution_deg=2.0,max_range_m=131.07,lens_radius_m={radius_m}"
        scenario = load("static_bench", [*_BARE, f'sensor={{model="free",preset="steady",{keys}}}'])
        parts = assemble(scenario)
        returns = list(Emulator(scenario).returns(0.0, 0.001))
        origin = np.concatenate([r.firings.origin_m for r in returns])
        direction = np.concatenate([r.firings.direction for r in returns])
        found_m = np.concatenate([r.distance_m[..., 0] for r in returns])
        # The light leaves the lens that far from the point of the axis from which ranges count.
        near_m = parts.head.beams.near_m
        true_m = near_m + _range_in_hall(origin + near_m[:, None] * direction, direction)
        seen = true_m <= 131.0
        name = f"{beams} beams, lens of {radius_m:g} m"
        yield Row(f"{name}: range, m", float(np.abs(found_m - true_m)[seen].max()), 4e-5)
        off = np.abs(np.linalg.norm(direction, axis=-1) - 1).max()
        yield Row("length of directions, less one", float(off), 1e-15)
    with mp.workdps(30):
        sine = float(mp.sin(mpf("89.9") * mp.pi / 180))
    top = float(direction[0, -1, 2])
    yield Row("sine of 89.9 degrees", abs(top - sine), 2.0**-52)
