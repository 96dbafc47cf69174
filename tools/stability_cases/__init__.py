"""Stiff and extreme cases: the one table that `tools/stability` prints and the tests hold.

A case is a function that yields rows of quantity, error and bound. Its docstring says what is extreme.
"""

from stability_cases import (  # noqa: F401  # each adds its cases to the table
    clock,
    coordinates,
    crowds,
    entries,
    faces,
    forests,
    inertial,
    light,
    poses,
    precision,
    sensors,
    straps,
    walks,
)
from stability_cases.case import CASES, Case, Result, Row, carry_out

__all__ = ["CASES", "Case", "Result", "Row", "carry_out"]
