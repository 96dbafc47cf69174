"""Curves of bent stems, against closed forms of beams and a general solver."""

import numpy as np
import pytest
from scipy.integrate import solve_bvp

from vlp16emu.forest.plants.bending import SHARES, bent

EVEN = np.ones_like(SHARES)


@pytest.mark.parametrize(
    ("load", "form"),
    [
        (EVEN, lambda x: (x**4 - 4 * x**3 + 6 * x**2) / 3),  # even load
        (1 - SHARES, lambda x: (10 * x**2 - 10 * x**3 + 5 * x**4 - x**5) / 4),  # falls linearly to the tip
    ],
    ids=["even", "falling"],
)
def test_a_cylinder_bends_as_the_handbook_has_it(load, form):
    """A cantilever of one section has the deflections of Timoshenko and Gere, appendix: 0.011 of the tip's at
    1.3 m of 17 m under an even load, and not the 0.076 of a straight line."""
    (curve,) = bent(EVEN[None], load[None])
    assert np.abs(curve - form(SHARES)).max() < 2e-4
    if load is EVEN:
        assert np.interp(1.3 / 17, SHARES, curve) == pytest.approx(0.0111, abs=1e-4)


@pytest.mark.parametrize("thin", [0.5, 0.2])
def test_a_tapering_stem_bends_as_a_general_solver_has_it(thin):
    """A cone cut off at a share of its width, with a load on its upper half: scipy's boundary value problem
    of the same beam (fixed foot, free tip) gives the same curve to 0.3 % of the tip's movement."""
    radius_m = 1 - (1 - thin) * SHARES
    load = np.where(SHARES >= 0.5, 1 - SHARES, 0.0)

    def beam(x, y):  # deflection, slope, moment, force
        moment = y[2] / (1 - (1 - thin) * x) ** 4
        return np.stack([y[1], moment, y[3], np.where(x >= 0.5, 1 - x, 0.0)])

    solved = solve_bvp(
        beam, lambda a, b: np.array([a[0], a[1], b[2], b[3]]), SHARES, np.zeros((4, len(SHARES))), tol=1e-6
    )
    (curve,) = bent(radius_m[None], load[None])
    form = solved.sol(SHARES)[0]
    assert np.abs(curve - form / form[-1]).max() < 0.003
