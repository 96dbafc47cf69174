"""Motions at the edge: hairpins, fast turns of recorded poses, straps from slack to rigid, and heads that turn while the body turns."""

from collections.abc import Sequence

import numpy as np
import pytest
from extras.walk.kit import straps

from vlp16emu import Emulator
from vlp16emu.engine import assemble
from vlp16emu.errors import InputError
from vlp16emu.extras.walk.pack import KNOTS_PER_S, Pack
from vlp16emu.motion.pose import Motion
from vlp16emu.packets import BLOCK_PERIOD_NS, BLOCKS_PER_PACKET, DATA_BYTES, DISTANCE_LSB_M, LASERS, decode_data
from vlp16emu.scenario import load
from vlp16emu.sensor.beams import LASER_NS, SEQUENCE_NS
from vlp16emu.types import F8, PacketKind
from vlp16emu.units import S_NS, US_NS

_STEP_HZ, _SWAY_M = 1.8, 0.02
_AT_S = 300  # second at which the start is forgotten: straps of 0.5 Hz and ten times critical damping need 250 s
_NODES_S = np.arange(1001) / 1000
_TURN_DEG_S = 500.0
_LAST_NS = SEQUENCE_NS + (LASERS - 1) * LASER_NS
_STEPS = 1 + _LAST_NS / BLOCK_PERIOD_NS / (BLOCKS_PER_PACKET - 1)
"""Of the azimuth: the one that is floored, and what the last pulse of a block adds to it over the gaps of a packet."""


def _sway(first: int, count: int) -> F8:
    """Sine on all axes from knot 0 on."""
    t_s = np.maximum(np.arange(first, first + count), 0) / KNOTS_PER_S
    return np.repeat((_SWAY_M * np.sin(2 * np.pi * _STEP_HZ * t_s))[:, None], 6, axis=1)


def test_stiff_straps():
    """The sway of straps of 0.5 Hz to 1 GHz, whose stiffness spans 18 decades, is that of the transfer function, to 1e-9 m."""
    s = 2j * np.pi * _STEP_HZ
    for damping in (0.1, 1.0, 10.0):
        errors = []
        for hz in np.geomspace(0.5, 1e9, 10):
            w = 2 * np.pi * hz
            answer = (2 * damping * w * s + w * w) / (s * s + 2 * damping * w * s + w * w)
            nodes = Pack(_sway, straps(hz, damping)).nodes(_AT_S)[:, 0]
            exact = [_SWAY_M * np.imag(answer * s**d * np.exp(s * (_AT_S + _NODES_S))) for d in range(2)]
            errors.append([float(np.abs(nodes[:, d] - exact[d]).max()) for d in range(2)])
        worst_m, worst_m_s = np.max(errors, axis=0)
        name = f"straps of 0.5 Hz to 1 GHz, damping {damping:g}"
        assert worst_m <= 1e-9, name  # sway off the closed form, m
        assert worst_m_s <= 1e-7, name  # its rate, m/s
    with pytest.raises(InputError, match="more damping"):
        Pack(_sway, straps(2.0, 0.0))


def test_fast_turns():
    """With rotors of 300 and 1200 rpm on a body that turns by 500 deg/s about a tilted axis, points lie on the walls of a bare hall.

    The bound is that of the wire: half of 2 mm along the beam; across it that of the azimuth, and what the
    body turns in a microsecond of the stamp; and a tenth of a millimetre for float32.
    """
    bare = ["world.boxes=[]", "world.poles=[]", "world.spheres=[]", "motion.height_m=2.5"]
    body = [f"motion.mount.spin_hz={_TURN_DEG_S / 360}", "motion.mount.spin_axis=[0.3, -0.2, 1.0]"]
    for rpm in (300, 1200):
        scenario = load("static_bench", [*bare, *body, f"sensor.rpm={rpm}"])
        emulator = Emulator(scenario)
        payloads = [p.payload for p in emulator.packets(0.0, 0.72) if p.kind is PacketKind.DATA]
        data = np.frombuffer(b"".join(payloads), np.uint8).reshape(-1, DATA_BYTES)
        points = decode_data(data, keep_no_returns=False)
        poses = emulator.parts.motion.poses_at(scenario.start_ns + points.time_ns)
        world_m = np.einsum("nij,nj->ni", poses.world_R_body, points.xyz_m) + poses.world_p_body_m
        x, y, z = world_m.T
        gaps_m = np.abs([x - 15, x + 15, y - 9, y + 9, z, z - 6])
        off_m = gaps_m.min(axis=0)
        across_deg = 0.01 * _STEPS + _TURN_DEG_S * US_NS / S_NS
        bound_m = np.hypot(DISTANCE_LSB_M / 2, np.radians(across_deg) * points.distance_m) + 1e-4
        name = f"rotor of {rpm} rpm, body 500 deg/s"
        assert (off_m / bound_m).max() <= 1, name
        assert off_m.mean() <= 1e-3, name  # mean error, m
        assert not (6 - len(np.unique(gaps_m.argmin(axis=0)))), name  # walls, floor or ceiling not seen


Points = Sequence[tuple[float, float]]

_STEP_NS = 500_000
_FALL_M = 20.0 * (_STEP_NS / S_NS) ** 2 / 2  # what twice the acceleration of a fall makes of a step


def _walk(points_m: Points, *settings: str) -> tuple[Motion, int]:
    motion = f'motion={{kind="walk",harness={{}},way_points_m={[list(point) for point in points_m]}}}'
    scenario = load("static_bench", [motion, *settings])
    return assemble(scenario).motion, scenario.start_ns


def _smooth(name: str, motion: Motion, start_ns: int, span_s: float):
    """Check that a motion is finite and without a jump; the largest of what is not a number is none either."""
    t_ns = start_ns + np.arange(0, round(span_s * S_NS), _STEP_NS, dtype=np.int64)
    poses, rates = motion.poses_at(t_ns), motion.kinematics_at(t_ns)
    hops_m = np.diff(poses.world_p_body_m, axis=0) - rates.world_v_body_m_s[:-1] * (_STEP_NS / S_NS)
    assert np.abs(hops_m).max() <= _FALL_M, name  # step of 0.5 ms less velocity, m
    jump_rad_s = np.abs(np.diff(rates.body_w_rad_s, axis=0)).max()
    assert jump_rad_s <= 0.01, name  # jump of angular rate in 0.5 ms, rad/s
    turns = poses.world_R_body
    off = np.abs(turns.swapaxes(1, 2) @ turns - np.eye(3)).max()
    assert off <= 1e-12, name  # rotation off orthonormal


def _hairpin(width_m: float, away_m: float = 0.0) -> list[tuple[float, float]]:
    half_m = width_m / 2
    way = [(0.0, 0.0), (6.0, 0.0), (6.0 + half_m, half_m), (6.0, width_m), (0.0, width_m)]
    return [(x + away_m, y + away_m) for x, y in way]


def test_hairpins():
    """A hairpin of two feet is walked without a jump, with gait and loose straps, here and 100 km away; a tighter one is refused."""
    for away_m in (0.0, 1e5):
        motion, start_ns = _walk(_hairpin(0.6, away_m))
        _smooth(f"hairpin of 0.6 m, {away_m / 1000:g} km away", motion, start_ns, motion.run_time_s)
    with pytest.raises(InputError, match=r"at least 0\.1 m"):
        _walk(_hairpin(0.2))
