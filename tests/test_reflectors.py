"""Retroreflectors through the whole chain, from the scene file to the bytes."""

import math

import numpy as np
import pytest
from kit import data_payloads

from vlp16emu import Emulator
from vlp16emu.packets import decode_data
from vlp16emu.scenario import load

TURN_S = 0.1
PLATE_M = 8.94  # from the sensor to the face of the reflector of `static_bench`


def decoded(scenario):
    """Points of one revolution, from the packets."""
    return decode_data(data_payloads(Emulator(scenario).packets(0.0, TURN_S)), keep_no_returns=False)


def on_the_plate(points):
    """Whether points lie on the face of the reflector, a centimetre within its edges."""
    x, y, z = points.xyz_m.T
    return (np.abs(x) < 0.39) & (np.abs(y + PLATE_M) < 0.1) & (np.abs(z) < 0.49)


def code(coefficient):
    """Byte of a reflector at right angles: 101 for a white wall, 255 for a thousand of it, logarithmic."""
    return np.clip(np.rint(101 + 154 * np.log(math.pi * coefficient) / np.log(1000)), 101, 255)


def test_a_reflector_shows_the_upper_half_of_the_scale():
    """Points on the reflector carry the byte of its coefficient, all others of the hall that of a diffuse
    wall."""
    points = decoded(load("static_bench"))
    plate = on_the_plate(points)
    assert plate.sum() > 50
    cosine = PLATE_M / points.distance_m[plate]
    assert (np.abs(points.reflectivity[plate] - code(250 * cosine)) <= 1).all()
    x, y, _ = points.xyz_m.T
    assert points.reflectivity[(np.abs(x) > 0.41) | (y > 0)].max() <= 100


def test_noise_does_not_make_a_reflector_of_a_wall():
    """With the errors of a usual unit the reflector stays above 100, and a white wall below 101."""
    points = decoded(load("static_bench", ["noise.preset=typical", "world.wall_reflectance=1.0"]))
    plate = on_the_plate(points)
    assert plate.sum() > 50
    assert points.reflectivity[plate].min() > 200
    x, y, _ = points.xyz_m.T
    assert points.reflectivity[(np.abs(x) > 0.6) | (y > 0)].max() == 100


@pytest.mark.parametrize("share", ["reflectance = 0.2", "retroreflection_cd_lx_m2 = 700.0"])
def test_a_part_of_a_mesh_can_be_a_reflector(tmp_path, share):
    """A user's mesh on a wall keeps its own finish but for the part that has another one."""
    lines = []
    for part, (low, high) in {"board": (-1.0, 0.0), "sign": (0.0, 1.0)}.items():
        corners = [(5.0, y, z) for y, z in ((low, -0.7), (high, -0.7), (high, 0.7), (low, 0.7))]
        first = len(lines) // 6 * 4 + 1
        lines += [f"o {part}", *(f"v {x} {y} {z}" for x, y, z in corners)]
        lines += [f"f {first} {first + 1} {first + 2} {first + 3}"]
    (tmp_path / "wall.obj").write_text("\n".join(lines) + "\n")
    mesh = (
        f"{{ file = '{tmp_path}/wall.obj', unit = 'm', up = 'z', reflectance = 0.4,"
        f" parts = [{{ name = 'sign', {share} }}], places = [{{ x_m = 0.0, y_m = 0.0, z_m = 1.5 }}] }}"
    )
    points = decoded(load("static_bench", [f"world.meshes=[{mesh}]"]))
    x, y, z = points.xyz_m.T
    face = (np.abs(x - 5.0) < 0.01) & (np.abs(z) < 0.6)
    sign, board = face & (y > 0.1) & (y < 0.9), face & (y < -0.1) & (y > -0.9)
    cosine = 5.0 / points.distance_m
    want = code(700 * cosine) if "retro" in share else np.rint(20 * cosine)
    assert (np.abs(points.reflectivity[sign] - want[sign]) <= 1).all()
    assert (np.abs(points.reflectivity[board] - 40 * cosine[board]) <= 1).all()
    assert min(sign.sum(), board.sum()) > 50
