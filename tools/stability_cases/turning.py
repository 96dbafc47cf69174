"""Straps from slack to rigid, and heads that turn while the body turns."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from stability_cases.row import Row, refused
from vlp16emu import Emulator
from vlp16emu.extras.walk import Harness
from vlp16emu.extras.walk.pack import KNOTS_PER_S, Pack
from vlp16emu.packets import BLOCK_PERIOD_NS, BLOCKS_PER_PACKET, DATA_BYTES, DISTANCE_LSB_M, LASERS, decode_data
from vlp16emu.scenario import load
from vlp16emu.sensor.beams import LASER_NS, SEQUENCE_NS
from vlp16emu.types import PacketKind
from vlp16emu.units import S_NS, US_NS

Array = NDArray[np.float64]

_STEP_HZ, _SWAY_M = 1.8, 0.02
_AT_S = 300
"""Second at which the start is forgotten: straps of 0.5 Hz and ten times critical damping need 250 s."""
_NODES_S = np.arange(1001) / 1000
_TURN_DEG_S = 500.0
_LAST_NS = SEQUENCE_NS + (LASERS - 1) * LASER_NS
_STEPS = 1 + _LAST_NS / BLOCK_PERIOD_NS / (BLOCKS_PER_PACKET - 1)
"""Of the azimuth: the one that is floored, and what the last pulse of a block adds to it over the gaps of a packet."""


def _sway(first: int, count: int) -> Array:
    """Sine on all axes from knot 0 on."""
    t_s = np.maximum(np.arange(first, first + count), 0) / KNOTS_PER_S
    return np.repeat((_SWAY_M * np.sin(2 * np.pi * _STEP_HZ * t_s))[:, None], 6, axis=1)


def _straps(hz: float, damping: float) -> Pack:
    axes = ("fore_aft_hz", "sideways_hz", "vertical_hz", "roll_hz", "pitch_hz", "yaw_hz")
    return Pack(_sway, Harness(**dict.fromkeys(axes, hz), damping_ratio=damping))


def stiff_straps() -> Iterator[Row]:
    """Straps of 0.5 Hz to 1 GHz, whose stiffness spans 18 decades, against the transfer function."""
    s = 2j * np.pi * _STEP_HZ
    for damping in (0.1, 1.0, 10.0):
        errors = []
        for hz in np.geomspace(0.5, 1e9, 19):
            w = 2 * np.pi * hz
            answer = (2 * damping * w * s + w * w) / (s * s + 2 * damping * w * s + w * w)
            nodes = _straps(hz, damping).nodes(_AT_S)[:, 0]
            exact = [_SWAY_M * np.imag(answer * s**d * np.exp(s * (_AT_S + _NODES_S))) for d in range(2)]
            errors.append([float(np.abs(nodes[:, d] - exact[d]).max()) for d in range(2)])
        worst_m, worst_m_s = np.max(errors, axis=0)
        name = f"straps of 0.5 Hz to 1 GHz, damping {damping:g}"
        yield Row(name, "sway off the closed form, m", float(worst_m), 1e-9)
        yield Row(name, "its rate, m/s", float(worst_m_s), 1e-7)
    yield refused("straps that swing for ever", lambda: _straps(2.0, 0.0), "more damping")


def fast_turns() -> Iterator[Row]:
    """Rotors of 300 and 1200 rpm on a body that turns by 500 deg/s about a tilted axis, in a bare hall.

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
        yield Row(name, f"largest error over bound, {len(off_m)} points", float((off_m / bound_m).max()), 1)
        yield Row(name, "mean error, m", float(off_m.mean()), 1e-3)
        yield Row(name, "walls, floor or ceiling not seen", 6 - len(np.unique(gaps_m.argmin(axis=0))), 0)
