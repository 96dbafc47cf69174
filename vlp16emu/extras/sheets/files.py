"""Files that `vlp16emu forest` writes: inventory, ground, digital twin, picture."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vlp16emu.extras.palette import surface_colours
from vlp16emu.extras.sheets.plan import PlanView
from vlp16emu.extras.sheets.section import StandSection, draw_section, strip_along
from vlp16emu.extras.sheets.sheet import draw_sheet, section_pixels_per_m
from vlp16emu.extras.sheets.survey import Survey
from vlp16emu.forest.ground.dem import write_ascii
from vlp16emu.forest.plants.stem_rings import STEM_CIRCLE
from vlp16emu.forest.stand.inventory import write_csv
from vlp16emu.forest.stand.nearby import AllNear, cut_out
from vlp16emu.forest.twin import write_glb
from vlp16emu.output import OutputFile
from vlp16emu.raycast.caster import caster
from vlp16emu.world.hall import HallWorld
from vlp16emu.world.vectors import places_m

Array = NDArray[np.float64]

_DRAWN_IN_ORDER = (
    *("none", "ground", "grass", "tuft", "herb", "dwarf_shrub", "fern", "stone", "log", "broken_log"),
    *("stump", "broken_stump", "root_plate", "deadwood", "sapling", "shrub", "tree", "other"),
)
"""Kinds of things, the lowest first."""

_MARGIN_M = 2.0
"""Of a plan."""

_SECTION_M = 60.0
"""Length of a section, the classic one of forest profile diagrams (Davis and Richards 1933: 200 ft by 25 ft)."""

_DEPTHS_M, _ENOUGH_TREES = (8.0, 12.0, 20.0, 30.0), 25
"""A section takes the first of these depths in which so many trees stand, or else the last."""

_OVERHANG_M = 15.0
"""How far crowns may reach out of the strip in which their trees stand."""

_LEAD_M = 6.0
"""Trees beyond the ends of a section whose crowns may reach into it."""

_BELOW_M, _ABOVE_M, _LEAST_HEIGHT_M = 1.5, 0.8, 6.0
"""How far a section reaches below the lowest ground and above the highest top, and how high it is at least."""

_INSIDE_M = 0.01
"""How far behind a hall's wall its section begins."""

_GROUND_CELL_M = 0.25
"""Of the ground that is written: the finest that is usual for forests."""


def write_inventory(output: OutputFile, seen: Survey, truth: Path | None) -> None:
    """Write all trees in reach, with what a run saw of their stems if the folder of its truth is given.

    InputError where the folder has no truth of returns of this scene.
    """
    more = seen.stems_seen(seen.trees, truth) if truth else None
    rows = seen.inventory(seen.trees)
    with output.writing() as file:
        write_csv(file, rows, more, table=seen.plants.trees)


def write_stems(output: OutputFile, seen: Survey) -> None:
    """Write the circles of all stems in reach and of the branches in the surroundings: skeletons with radii, as a QSM has them."""
    circles = seen.stem_circles(seen.trees)
    with output.writing() as file:
        header = ",".join(STEM_CIRCLE.names or ())
        np.savetxt(file, circles, fmt=[*["%d"] * 4, *["%.4f"] * 5], delimiter=",", header=header, comments="")


def write_ground(output: OutputFile, seen: Survey) -> None:
    """Write the height of the ground of a rectangle that holds the surroundings."""
    low_m, high_m = _around(seen)
    with output.writing() as file:
        write_ascii(file, seen.height_m, low_m, high_m, _GROUND_CELL_M)


def write_twin(output: OutputFile, seen: Survey) -> None:
    """Write what is in the surroundings; of a hall, all."""
    places_m = {thing.instance: thing.place_m for thing in seen.things}
    for tree in seen.near:
        places_m[int(tree["id"])] = np.array([tree["x_m"], tree["y_m"], tree["z_m"]])
    window, shape = seen.window, seen.grow
    if seen.hall is None:
        wanted = np.array(list(places_m), np.uint32)
        window, shape = cut_out(window, shape, instances=wanted, inside=seen.inside)
    colours = surface_colours(seen.window.surfaces, seen.species)
    with output.writing() as file:
        write_glb(file, window, shape, places_m=places_m, species=seen.species, colours=colours)


def write_picture(output: OutputFile, seen: Survey, *, title: str, subtitle: str) -> None:
    """Draw plan and section."""
    section = _hall_section(seen.hall) if seen.hall is not None else _forest_section(seen)
    drawn = _drawn(seen, section)
    with output.writing() as file:
        draw_sheet(file, _plan(seen), section, drawn, title=title, subtitle=subtitle)


def _plan(seen: Survey) -> PlanView:
    kinds = sorted({thing.kind for thing in seen.things}, key=_DRAWN_IN_ORDER.index)
    low_m, high_m = _around(seen)
    return PlanView(
        low_m=low_m - _MARGIN_M,
        high_m=high_m + _MARGIN_M,
        path_m=seen.path_m,
        field_of_view_deg=seen.field_of_view_deg,
        radius_m=None if seen.hall is not None else seen.radius_m,
        trees=seen.near,
        species=seen.species,
        outlines_m={kind: [one.outline_m for one in seen.things if one.kind == kind] for kind in kinds},
        names=[(seen.names[one.instance], one.place_m[:2]) for one in seen.things if one.instance in seen.names],
        height_m=seen.height_m,
    )


def _around(seen: Survey) -> tuple[Array, Array]:
    """Corners (2,) of the least rectangle that holds the surroundings, or the hall."""
    if seen.hall is not None:
        corner_m = np.array(seen.hall.size_m[:2]) / 2
        return -corner_m, corner_m
    way_xy_m = seen.path_m[:, :2]
    return way_xy_m.min(axis=0) - seen.radius_m, way_xy_m.max(axis=0) + seen.radius_m


def _forest_section(seen: Survey) -> StandSection:
    """Lay a section along the path, as deep as it needs to be to hold some trees."""
    foot_m = places_m(seen.trees, "xy")
    low_m, high_m = _around(seen)
    for depth_m in _DEPTHS_M:
        section = strip_along(seen.path_m, _SECTION_M, depth_m).within(low_m, high_m)
        holds = section.holds(foot_m, _LEAD_M)
        if holds.sum() >= _ENOUGH_TREES:
            break
    ends_m = np.linspace(0.0, section.length_m, 61)[:, None] * section.along + section.start_xy_m
    strip_m = np.concatenate([ends_m + side * section.depth_m / 2 * section.towards for side in (-1, 0, 1)])
    ground_m = seen.height_m(strip_m[:, 0], strip_m[:, 1])
    tops_m = (seen.trees["z_m"] + seen.trees["height_m"])[holds]
    top_m = max([*tops_m.tolist(), float(ground_m.max()) + _LEAST_HEIGHT_M]) + _ABOVE_M
    return replace(section, low_m=float(ground_m.min()) - _BELOW_M, high_m=top_m)


def _hall_section(hall: HallWorld) -> StandSection:
    """Look at a whole hall from its southern wall."""
    length_m, width_m, height_m = hall.size_m
    start_xy_m, along = np.array([-length_m / 2, 0.0]), np.array([1.0, 0.0])
    return StandSection(start_xy_m, along, length_m, width_m - 2 * _INSIDE_M, -_BELOW_M, height_m)


def _drawn(seen: Survey, section: StandSection) -> NDArray[np.uint8]:
    """Cast light at what stands in a section."""
    window, shape, overhang_m = seen.window, seen.grow, 0.0
    if seen.hall is None:
        trees, overhang_m = seen.trees, _OVERHANG_M
        feet_m = [places_m(trees, "xy"), *(one.place_m[None, :2] for one in seen.things)]
        ids = np.array([*trees["id"].tolist(), *(one.instance for one in seen.things)], np.uint32)
        wanted = ids[section.holds(np.concatenate(feet_m), _LEAD_M)]
        window, shape = cut_out(window, shape, instances=wanted, inside=lambda xy_m: section.holds(xy_m, _LEAD_M))
    with ThreadPoolExecutor() as workers:
        scene = caster(AllNear(window, shape), workers).open(window)
    return draw_section(
        scene,
        section,
        overhang_m,
        colours=surface_colours(seen.window.surfaces, seen.species),
        height_m=seen.height_m,
        pixels_per_m=section_pixels_per_m(section),
    )
