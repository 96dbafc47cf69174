"""Straps: the trunk's spline, and the exact swing about it."""

import math
from itertools import product

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.linalg import expm

from vlp16emu.errors import TrajectoryError
from vlp16emu.motion.harness import KNOTS_PER_S, Pack, decay_per_s, response

NODES_S = np.arange(1001) / 1000


def sines(first, count):
    """Six axes of different frequencies, at rest until the first knot and swelling over a second."""
    t = np.arange(first, first + count) / KNOTS_PER_S
    x = np.clip(t, 0.0, 1.0)
    rates = np.array([1.8, 0.9, 3.6, 0.9, 1.8, 7.0])
    return 0.02 * (x**3 * (10 - 15 * x + 6 * x * x))[:, None] * np.sin(2 * np.pi * t[:, None] * rates)


def test_trunk_is_the_spline_through_its_samples():
    """A quintic is reproduced to rounding with its derivatives, and a sine of 1.8 Hz to a nanometre."""
    quintic = np.polynomial.Polynomial([0.1, -2.0, 3.0, 1.0, -4.0, 2.0])

    def sample(first, count):
        t = np.arange(first, first + count) / KNOTS_PER_S
        return np.stack([quintic(t), 0.02 * np.sin(2 * np.pi * 1.8 * t)] + [t] * 4, -1)

    nodes = Pack(sample, None).nodes(0)
    for d in range(3):
        np.testing.assert_allclose(nodes[:, 0, d], quintic.deriv(d)(NODES_S) if d else quintic(NODES_S), atol=1e-9)
    np.testing.assert_allclose(nodes[:, 1, 0], 0.02 * np.sin(2 * np.pi * 1.8 * NODES_S), atol=1e-9)


def test_spline_agrees_with_scipys():
    """Value and derivatives are those of the B-spline whose control points are the filtered samples."""
    samples = sines(200 - 4, 209)
    control = np.apply_along_axis(np.convolve, 0, samples, np.array([13, -112, 438, -112, 13]) / 240, "valid")
    spline = BSpline((np.arange(len(control) + 6) - 5) / KNOTS_PER_S, control, 5)
    nodes = Pack(sines, None).nodes(1)
    for d, tolerance in ((0, 1e-15), (1, 1e-12), (2, 1e-10)):
        np.testing.assert_allclose(nodes[..., d], spline(NODES_S, d), atol=tolerance)


def test_step_is_the_matrix_exponential():
    """The map from state and forcing over a step is that of the exponential of the whole system."""
    dampings = 0.0, 0.05, 0.999999, 1.0, 1.000001, 1.4, 1.6, 10.0
    for hz, damping in product((0.5, 5.0, 60.0, 300.0), dampings):
        w, s = 2 * math.pi * hz, 0.005
        system = np.zeros((6, 6))
        system[0, 1] = 1.0
        system[1, :3] = -w * w, -2 * damping * w, 1.0
        for i in range(3):
            system[2 + i, 3 + i] = 1.0 + i
        scale = np.array([1.0, w])[:, None] / np.array([1.0, w, w * w, w * w, w * w, w * w])
        error = (response(hz, damping, s) - expm(system * s)[:2]) / scale
        assert np.abs(error).max() < 1e-9, (hz, damping)


def test_pack_answers_a_long_sine_as_the_transfer_function_says(straps):
    """Gain and lag in the steady state are those of (2 z w s + w^2) / (s^2 + 2 z w s + w^2)."""
    f, hz, z = 1.8, 2.2, 0.15

    def sine(first, count):
        t = np.arange(first, first + count) / KNOTS_PER_S
        return np.repeat(np.where(t > 0, 0.02 * np.sin(2 * np.pi * f * t), 0.0)[:, None], 6, axis=1)

    s, w = 2j * np.pi * f, 2 * np.pi * hz
    gain = (2 * z * w * s + w * w) / (s * s + 2 * z * w * s + w * w)
    expected = 0.02 * np.imag(gain * np.exp(s * (60 + NODES_S)))
    np.testing.assert_allclose(Pack(sine, straps(hz, z)).nodes(60)[:, 0, 0], expected, atol=1e-10)


def test_stiff_straps_are_no_straps(straps):
    """At 1 GHz the pack is where the trunk is, within 1e-9 in displacement, velocity and acceleration."""
    rigid, stiff = Pack(sines, None).nodes(2), Pack(sines, straps(1e9, 0.5)).nodes(2)
    np.testing.assert_allclose(stiff, rigid, atol=1e-9)


def test_random_access_gives_the_same_bits(straps):
    """A late second asked for first equals the one reached second by second."""
    steady, jumper = (Pack(sines, straps(1.5, 0.2)) for _ in range(2))
    walked = [steady.nodes(second) for second in range(40)]
    assert (jumper.nodes(39) == walked[39]).all()
    assert (jumper.nodes(7) == walked[7]).all()


def test_straps_rest_before_the_first_step(straps):
    """Until the first step nothing is stretched, however much is asked for."""
    pack = Pack(sines, straps(1.0, 0.2))
    assert not pack.nodes(-1)[:-20].any()


@pytest.mark.parametrize(("hz", "damping", "found"), [(2.0, 0.0, "for ever"), (1.0, 1e-3, "6230 s")])
def test_undamped_straps_are_refused(hz, damping, found, straps):
    """Straps that would swing for more than ten minutes are refused in one line that says for how long."""
    with pytest.raises(TrajectoryError, match=f"harness: swings .*{found}.*more damping"):
        Pack(sines, straps(hz, damping))


def test_slowest_part_decides_how_long_a_swing_lasts():
    """Weak straps fade with the damping, strong dampers with their slow creep."""
    assert decay_per_s(1.0, 0.1) == pytest.approx(0.2 * math.pi)
    assert decay_per_s(1.0, 10.0) == pytest.approx(2 * math.pi * (10 - math.sqrt(99)))
