"""Files that `vlp16emu forest` writes: inventory, stems, ground, digital twin, picture."""

from pathlib import Path

import numpy as np

from vlp16emu.extras.palette import surface_colours
from vlp16emu.extras.sheets.section import draw_stand, section_of
from vlp16emu.extras.sheets.sheet import draw_sheet, section_pixels_per_m
from vlp16emu.extras.sheets.survey import Survey
from vlp16emu.forest.ground.dem import write_ascii
from vlp16emu.forest.plants.stem_rings import STEM_CIRCLE
from vlp16emu.forest.stand.inventory import write_csv
from vlp16emu.forest.stand.nearby import Grow, cut_out
from vlp16emu.forest.twin import write_glb
from vlp16emu.output import OutputFile
from vlp16emu.world.vectors import places_m

_GROUND_CELL_M = 0.25  # cell of the ground grid: the finest that is usual for forests


def write_inventory(output: OutputFile, seen: Survey, truth: Path | None) -> None:
    """Write all trees within the sensor's range, with what a run saw of their stems if the folder of its truth is given.

    InputError if the folder has no truth of returns of this scene.
    """
    more = seen.stems_seen(seen.trees, truth) if truth else None
    rows = seen.inventory(seen.trees)
    with output.writing() as file:
        write_csv(file, rows, more, table=seen.plants.trees)


def write_stems(output: OutputFile, seen: Survey) -> None:
    """Write circles along all stems within range and the branches within the radius: skeletons with radii, as a QSM has them."""
    circles = seen.stem_circles(seen.trees)
    with output.writing() as file:
        header = ",".join(STEM_CIRCLE.names or ())
        np.savetxt(file, circles, fmt=[*["%d"] * 4, *["%.4f"] * 5], delimiter=",", header=header, comments="")


def write_ground(output: OutputFile, seen: Survey) -> None:
    """Write the height of the ground of the survey's bounding rectangle."""
    with output.writing() as file:
        write_ascii(file, seen.bare.height_m, *seen.bounds_m, _GROUND_CELL_M)


def write_twin(output: OutputFile, seen: Survey) -> None:
    """Write everything within the radius, or the whole hall, as glTF."""
    at_m = {thing.instance: thing.place_m for thing in seen.things}
    at_m |= dict(zip(seen.near["id"].tolist(), places_m(seen.near), strict=True))
    window = seen.window
    shape: Grow = seen.world.shape
    if seen.hall is None:
        wanted = np.array(list(at_m), np.uint32)
        window, shape = cut_out(window, shape, instances=wanted, inside=seen.inside)
    colours = surface_colours(seen.window.surfaces, seen.species)
    with output.writing() as file:
        write_glb(file, window, shape, places_m=at_m, species=seen.species, colours=colours)


def write_picture(output: OutputFile, seen: Survey, *, title: str, subtitle: str) -> None:
    """Draw plan and section."""
    section = section_of(seen)
    drawn = draw_stand(seen, section, section_pixels_per_m(section))
    with output.writing() as file:
        draw_sheet(file, seen, section, drawn, title=title, subtitle=subtitle)
