"""Stiff and extreme cases, each a function that gives rows of case, quantity, error and bound."""

from stability_cases import clock, coordinates, crowds, entries, faces, paths, turning
from stability_cases.row import Case, Row, check

__all__ = ["CASES", "Case", "Row", "check"]

CASES: tuple[Case, ...] = (
    coordinates.far_files,
    coordinates.far_worlds,
    coordinates.far_walks,
    faces.grazing,
    crowds.thin_twig,
    faces.slivers,
    faces.doubled,
    faces.crossed,
    faces.inside,
    faces.edge_on,
    crowds.crowd,
    crowds.too_many,
    turning.stiff_straps,
    turning.fast_turns,
    clock.day,
    paths.impossible_paths,
    paths.hairpins,
    paths.recordings,
    entries.every_key,
    entries.options,
    entries.python,
)
