"""Curves of stems that bend under a load, as cantilevers of their own taper.

A stem is a beam that the ground holds upright, with round sections of one modulus of elasticity, so its
stiffness goes with the fourth power of the radius. Its curvature is the bending moment over that stiffness
(Euler and Bernoulli; Timoshenko and Gere, Mechanics of Materials, chapter 9). Slopes are small.
"""

import numpy as np

from vlp16emu.types import F8

STEPS = 100  # steps of a curve
SHARES = np.arange(STEPS + 1) / STEPS  # heights of its points over the height of the stem


def bent(radius_m: F8, load: F8) -> F8:
    """Return curves (n, STEPS + 1) of stems with radii (n, STEPS + 1), above 0, from the foot to the tip.

    `load` (n, STEPS + 1) is the level force per metre at the same heights, in any unit. The displacement at
    the foot is 0, and 1 at the tip.
    """
    force = _from_tip(load)
    moment = _from_tip(force)
    curvature = moment / np.square(np.square(radius_m))
    curve = _from_foot(_from_foot(curvature))
    return curve / curve[:, -1:]


def _from_foot(values: F8) -> F8:
    """Integral (n, k) of values (n, k) from the foot, in steps, by trapezoids."""
    parts = (values[:, 1:] + values[:, :-1]) / 2
    return np.concatenate([np.zeros((len(values), 1)), np.cumsum(parts, axis=1)], axis=1)


def _from_tip(values: F8) -> F8:
    """Integral (n, k) of values (n, k) to the tip, likewise."""
    return _from_foot(values[:, ::-1])[:, ::-1]
