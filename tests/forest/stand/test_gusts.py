"""Gusts by their statistics, and trees that follow them against a general solver."""

import numpy as np
import pytest
from scipy.signal import lsim

from vlp16emu.forest.stand.wind import ACROSS, ALONG, Trees, gust_lines, swings
from vlp16emu.world import Wind

SPEED_M_S, INTENSITY, LENGTH_M = 6.0, 0.5, 20.0
KAIMAL = Wind(speed_m_s=SPEED_M_S, turbulence_intensity=INTENSITY, gust_length_m=LENGTH_M)


def gusts(lines, speed_m_s, downwind_m, aside_m, t_s):
    """Speed (k,) of a component in m/s, beyond the mean, at a place and times (k,): a rigid tree follows at once."""
    rigid = Trees(np.array([np.inf]), 1.0, np.array([downwind_m]), np.array([aside_m]))
    return swings(lines, speed_m_s, rigid, t_s)[:, 0]


@pytest.mark.parametrize(("component", "share"), [(ALONG, 1.0), (ACROSS, 0.8)])
def test_gusts_have_the_turbulence_that_was_asked_for(component, share):
    """Their variance is (intensity x speed)^2, of the lines to rounding and of three hours of gusts to 3 %."""
    lines = gust_lines(KAIMAL, 1, component)
    wanted = (share * INTENSITY * SPEED_M_S) ** 2
    assert np.sum(lines.speed_m_s**2) / 2 == pytest.approx(wanted, rel=1e-12)
    u_m_s = gusts(lines, SPEED_M_S, 12.0, -7.0, np.arange(0.0, 10_800.0, 0.5))
    assert u_m_s.var() == pytest.approx(wanted, rel=0.03)
    assert abs(u_m_s.mean()) < 0.02


def test_energy_lies_where_kaimal_has_it():
    """In every octave from 0.02 Hz to 4 Hz the lines hold the integral of Kaimal's spectrum, to a line of eighteen at either edge."""
    lines = gust_lines(KAIMAL, 2, ALONG)
    hz, energy = lines.omega_rad_s / (2 * np.pi), lines.speed_m_s**2 / 2
    f = np.geomspace(0.02, 4.0, 20_001)
    n = f * LENGTH_M / SPEED_M_S
    density = 4 * n / (1 + 6 * n) ** (5 / 3) / f * (INTENSITY * SPEED_M_S) ** 2
    for low in 0.02 * 2.0 ** np.arange(7):
        octave = (f >= low) & (f <= 2 * low)
        wanted = np.trapezoid(density[octave], f[octave])
        assert energy[(hz >= low) & (hz < 2 * low)].sum() == pytest.approx(wanted, rel=0.12)


def test_gusts_travel_with_the_wind():
    """What is felt 30 m downwind was felt here 30 m / speed ago."""
    lines, t_s = gust_lines(KAIMAL, 3, ALONG), np.arange(0.0, 60.0, 0.1)
    there = gusts(lines, SPEED_M_S, 35.0, 4.0, t_s)
    assert np.abs(there - gusts(lines, SPEED_M_S, 5.0, 4.0, t_s - 30.0 / SPEED_M_S)).max() < 1e-9


def test_gusts_part_across_the_wind():
    """Beside each other lines agree by Davenport's exp(-10 f d / speed), over all lines of sixty winds to 0.03."""
    apart_m, waves, phases = 4.0, [], []
    for seed in range(60):
        lines = gust_lines(KAIMAL, seed, ALONG)
        waves.append(lines.omega_rad_s / (2 * np.pi))
        phases.append(lines.aside_rad_m * apart_m)
    hz, phase = np.concatenate(waves), np.concatenate(phases)
    for low, high in ((0.01, 0.03), (0.1, 0.2), (0.2, 0.4)):
        band = (hz >= low) & (hz < high)
        wanted = np.exp(-10 * hz[band] * apart_m / SPEED_M_S).mean()
        assert np.cos(phase[band]).mean() == pytest.approx(wanted, abs=0.03)


@pytest.mark.parametrize(("hz", "damping"), [(0.15, 0.05), (0.3, 0.1), (1.2, 0.3)])
def test_trees_follow_as_a_general_solver_has_it(hz, damping):
    """From any state on, once that is forgotten, scipy's lsim of the same oscillator gives the same swing to 0.02 %."""
    lines, omega = gust_lines(KAIMAL, 4, ALONG), 2 * np.pi * hz
    t_s = np.arange(0.0, 10.0 / (damping * omega) + 30.0, 0.005)
    u_m_s = gusts(lines, SPEED_M_S, 3.0, 2.0, t_s)
    system = ([omega**2], [1.0, 2 * damping * omega, omega**2])
    _, solved, _ = lsim(system, u_m_s, t_s)
    tree = Trees(np.array([omega]), damping, np.array([3.0]), np.array([2.0]))
    late = t_s > t_s[-1] - 25.0
    ours = swings(lines, SPEED_M_S, tree, t_s[late])[:, 0]
    assert np.abs(ours - solved[late]).max() < 2e-4 * INTENSITY * SPEED_M_S + 1e-4


def test_any_tree_at_any_time_by_itself():
    """One tree at one time has the same bits as among others over a week."""
    lines = gust_lines(KAIMAL, 5, ACROSS)
    t_s = np.concatenate([np.arange(0.0, 7.0, 0.1), [604_800.0]])
    stand = Trees(np.linspace(0.8, 4.0, 9), 0.1, np.linspace(-90.0, 90.0, 9), np.linspace(5.0, -70.0, 9))
    whole = swings(lines, SPEED_M_S, stand, t_s)
    for i, k in ((0, 0), (4, 33), (8, 70)):
        alone = Trees(stand.omega_rad_s[i : i + 1], 0.1, stand.downwind_m[i : i + 1], stand.aside_m[i : i + 1])
        assert swings(lines, SPEED_M_S, alone, t_s[k : k + 1]).tobytes() == whole[k, i].tobytes()
