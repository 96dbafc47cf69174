"""Ground truth of standing trees, computed from the scanned meshes: inventory and circles.

An inventory has one row per tree. Circles lie along stems and along branches of the first order.
"""

import csv
from collections.abc import Sequence
from io import TextIOWrapper
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import matvec, norm
from vlp16emu.foliage.tiles import STEM
from vlp16emu.forest.plants.allometry import BREAST_HEIGHT_M, US_BREAST_HEIGHT_M
from vlp16emu.forest.plants.prototypes import (
    CROWN_PARTS,
    CrownKey,
    crown_branches,
    crown_meshes,
    crown_placements,
    crown_scale,
    crown_wood_m3,
)
from vlp16emu.forest.plants.species import Table, Trees, flora
from vlp16emu.forest.plants.stem import (
    STEM_CIRCLE,
    STEM_PARTS,
    Stems,
    circles_of,
    polygon_m2,
    stems_above_ground,
    tape_m,
)
from vlp16emu.forest.stand.stand import TREE
from vlp16emu.types import F8, Mesh, PlantPart
from vlp16emu.world.vectors import determinant, places_m, unit

INVENTORY = np.dtype(  # one tree of the inventory; tops, volumes and areas come from its meshes
    [
        ("id", "<u4"),  # instance number in labels
        ("species", "<u2"),  # number in the species table
        ("x_m", "<f8"),  # foot: point where the stem's axis leaves the ground
        ("y_m", "<f8"),
        ("z_m", "<f8"),
        ("x_breast_m", "<f8"),  # centre of the section at breast height, 1.3 m above the foot
        ("y_breast_m", "<f8"),
        ("dbh_m", "<f8"),  # area-equivalent, perpendicular to the axis there
        ("dbh_us_m", "<f8"),  # the same at 1.37 m, as measured in North America
        ("girth_over_pi_m", "<f8"),  # diameter by a taut tape around that section
        ("height_m", "<f8"),  # height of the stem's tip over the foot, vertical
        ("top_m", "<f8"),  # height of the highest point (tip, branch or leaf) over the foot, vertical
        ("x_min_m", "<f8"),  # box around stem, branches and leaves; from z_m to z_m + top_m
        ("x_max_m", "<f8"),
        ("y_min_m", "<f8"),
        ("y_max_m", "<f8"),
        ("crown_base_m", "<f8"),  # height of the crown's lowest branch over the foot, vertical
        ("crown_width_m", "<f8"),
        ("taper", "<f8"),  # taper in excess of its species' curve; 0 for a user's tree model
        ("lean_deg", "<f8"),  # angle of the line from foot to tip from the vertical
        ("lean_towards_deg", "<f8"),  # counter-clockwise from east
        ("stem_m3", "<f8"),  # volume of the stem over bark, from the ground at the axis to the tip
        ("wood_m3", "<f8"),  # stem and all branches; parts of branches inside the stem count twice
        ("leaf_m2", "<f8"),  # one-sided
        ("biomass_kg", "<f8"),  # dry, above ground, by the species' equation; NaN without one
        ("list_line", "<u4"),  # line of the stem list; 0 for a generated tree
    ]
)
COPIED = tuple(name for name in INVENTORY.names or () if name in (TREE.names or ()))
"""Fields copied from `TREE`."""
_DECIMALS = 4  # decimals of numbers in a file: a tenth of a millimetre, a tenth of a litre


def inventory(
    trees: Trees, crowns: Sequence[CrownKey], *, seed: int, table: Table | None = None
) -> NDArray[np.void]:
    """Return the inventory (n,) `INVENTORY` of trees (n,) `TREE`, in order.

    Crowns are prototypes grown from the seed.
    """
    table = table or flora().trees
    rows = np.zeros(len(trees), INVENTORY)
    for name in COPIED:
        rows[name] = trees[name]
    _measure_sections(rows, trees, table)
    meshes = stems_above_ground(trees, table=table)
    ends_m = np.array([[mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)] for mesh in meshes])
    span_m = ends_m.reshape(-1, len(STEM_PARTS), 2, 3)
    span_m = np.stack([span_m[:, :, 0].min(axis=1), span_m[:, :, 1].max(axis=1)], axis=1, dtype=np.float64)
    rows["stem_m3"] = np.array([volume_m3(mesh) for mesh in meshes]).reshape(-1, len(STEM_PARTS)).sum(axis=1)
    _measure_crowns(rows, span_m, trees, crowns, seed, table)
    rows["top_m"] = span_m[:, 1, 2]
    for axis, name in enumerate("xy"):
        rows[f"{name}_min_m"], rows[f"{name}_max_m"] = (
            trees[f"{name}_m"] + end_m for end_m in span_m[..., axis].T
        )
    rows["biomass_kg"] = np.nan
    for species in table.values():
        is_species = trees["species"] == species.number
        sizes = (trees[name][is_species] for name in ("dbh_m", "height_m", "crown_base_m", "taper"))
        rows["biomass_kg"][is_species] = species.biomass_kg(*sizes)
    return rows


def write_csv(file: BinaryIO, rows: NDArray[np.void], *, table: Table | None = None) -> None:
    """Write rows (n,) `INVENTORY` below a header, with species by name and unknown numbers empty."""

    def text(value: float) -> str:
        return "" if np.isnan(value) else f"{value:.{_DECIMALS}f}"

    names = {species.number: name for name, species in (table or flora().trees).items()}
    opened = TextIOWrapper(file, encoding="utf-8", newline="")
    writer = csv.writer(opened, lineterminator="\n")
    writer.writerow(INVENTORY.names or ())
    for number, species, *values, line in rows.tolist():
        writer.writerow([number, names[species], *map(text, values), line or ""])
    opened.detach()


def _measure_sections(rows: NDArray[np.void], trees: Trees, table: Table) -> None:
    stems = Stems(trees, table=table)
    at = (BREAST_HEIGHT_M, US_BREAST_HEIGHT_M)
    middle_m = stems.axis_m(np.full((len(trees), 1), BREAST_HEIGHT_M))[:, 0]
    rows["x_breast_m"] = trees["x_m"] + middle_m[:, 0]
    rows["y_breast_m"] = trees["y_m"] + middle_m[:, 1]
    for i, sides in enumerate(stems.sides.tolist()):
        (away_m,) = stems.outlines(np.array([i]), sides)
        above_m = stems.above_ground_m[i]
        breast, us = np.array([[np.interp(z, above_m, side) for side in away_m.T] for z in at])
        rows["girth_over_pi_m"][i] = tape_m(breast[None])[0]
        rows["dbh_us_m"][i] = 2 * np.sqrt(polygon_m2(us, 2 * np.pi / sides) / np.pi)


def volume_m3(mesh: Mesh) -> float:
    """Volume of a closed mesh; an open one is closed by a cone to the origin."""
    a, b, c = np.moveaxis(mesh.vertices_m[mesh.faces].astype(np.float64), 1, 0)
    return float((a * np.cross(b, c)).sum() / 6)


def _measure_crowns(
    rows: NDArray[np.void], span_m: F8, trees: Trees, crowns: Sequence[CrownKey], seed: int, table: Table
) -> None:
    """Fill in wood and leaves, prototype by prototype, scaled for each tree.

    Widen the boxes (n, 2, 3) to include them.
    """
    wide, long = crown_scale(trees, crowns)
    rows["wood_m3"] = rows["stem_m3"]
    foot_T_crown = crown_placements(trees, crowns)
    foot_T_crown[:, :, 3] -= places_m(trees)
    trees_of: dict[CrownKey, list[int]] = {}
    for i, key in enumerate(crowns):
        trees_of.setdefault(key, []).append(i)
    for key, rows_of_key in trees_of.items():
        rows["wood_m3"][rows_of_key] += (
            crown_wood_m3(seed, key, table=table) * np.square(wide[rows_of_key]) * long[rows_of_key]
        )
        meshes = crown_meshes(seed, key, table=table)
        corners_m = hull_m(np.concatenate([mesh.vertices_m for mesh in meshes]).astype(np.float64))
        for i in rows_of_key:
            at_m = matvec(foot_T_crown[i, :, :3], corners_m) + foot_T_crown[i, :, 3]
            span_m[i, 0] = at_m.min(axis=0, initial=np.inf).clip(max=span_m[i, 0])
            span_m[i, 1] = at_m.max(axis=0, initial=-np.inf).clip(min=span_m[i, 1])
        leaves = meshes[CROWN_PARTS.index(PlantPart.LEAF)]
        foliage = table[key.species].foliage
        if foliage is not None and len(leaves.faces):
            # Area of planar quads after scaling across and along the axis.
            a, b, c, d = np.moveaxis(leaves.vertices_m[leaves.faces].astype(np.float64), 1, 0)
            x, y, z = (np.cross(c - a, d - b) / 2).T
            level = np.square(z)
            steep = np.square(x) + np.square(y)
            stretches = zip(wide[rows_of_key], long[rows_of_key], strict=True)
            areas_m2 = [w * np.sqrt(level * w * w + steep * h * h).sum() for w, h in stretches]
            rows["leaf_m2"][rows_of_key] = foliage.clumping * np.array(areas_m2)


def hull_m(points_m: F8) -> F8:
    """Return the points (n, 3) that span their convex hull; all if they span no volume."""
    from scipy.spatial import ConvexHull, QhullError  # here: it takes a while to load

    try:
        hull: F8 = points_m[ConvexHull(points_m).vertices]
    except (QhullError, ValueError):  # few or flat
        return points_m
    return hull


def branch_circles(
    trees: Trees, crowns: Sequence[CrownKey], *, seed: int, table: Table | None = None
) -> NDArray[np.void]:
    """Circles (k,) `STEM_CIRCLE` along the branches of the first order, tree by tree.

    Each goes from the stem's axis to its tip. The crowns of trees (n,) `TREE` are prototypes grown from the
    seed and scaled; a circle has the area of the scaled branch's section.
    """
    prototypes = {key: crown_branches(seed, key, table=table) for key in dict.fromkeys(crowns)}
    found = [np.zeros(0, STEM_CIRCLE)]
    for tree, key, world_T_crown in zip(trees[:, None], crowns, crown_placements(trees, crowns), strict=True):
        number = 1
        parts = PlantPart.BRANCH_FIRST_ORDER, PlantPart.DEAD_BRANCH
        for part, branches in zip(parts, prototypes[key], strict=True):
            world_A = world_T_crown[:, :3]
            nodes_m = branches.nodes_m
            along = np.gradient(nodes_m, axis=1)
            longer = norm(matvec(world_A, along)) / norm(along)
            # Area times length is volume, which scales with the determinant.
            radius_m = branches.node_radius_m * np.sqrt(determinant(world_A) / longer)
            at_m = matvec(world_A, nodes_m) + world_T_crown[:, 3]
            numbers = number + np.arange(len(nodes_m))
            circles = circles_of(tree, 1, part, at_m, radius_m, numbers[:, None])
            circles["above_foot_m"] = circles["z_m"] - tree["z_m"]
            number += len(circles)
            found.append(circles.ravel())
    return np.concatenate(found)


def far_stems(trees: Trees, first_row: int, *, table: Table | None = None) -> NDArray[np.void]:
    """Stems of n trees as `STEM`, with circles as wide as their polygons look, then second leaders.

    Rows start at `first_row`.
    """
    stems_of_trees = Stems(trees, table=table)
    foot_m = places_m(trees)
    above_m = np.column_stack([stems_of_trees.above_ground_m, trees["height_m"]])
    first = profiles(
        foot_m,
        stems_of_trees.axis_m(above_m),
        np.column_stack([stems_of_trees.half_widths_m(), stems_of_trees.tip_radius_m]),
        1,
    )
    first["flare_m"] = stems_of_trees.flare_m / first["axis"][:, 2]
    first["row"] = first_row + 2 * np.arange(len(trees))[:, None] + [0, 1]
    above_m, radius_m = stems_of_trees.leaders(np.linspace(0.0, 1.0, above_m.shape[1]))
    second = profiles(foot_m[stems_of_trees.forked], stems_of_trees.leader_axis_m(above_m), radius_m, 0)
    second["flare_m"] = -1.0
    second["row"] = first["row"][stems_of_trees.forked]
    return np.concatenate([first, second])


def profiles(foot_m: F8, middle_m: F8, radius_m: F8, begin: int) -> NDArray[np.void]:
    """Return `STEM`s of circles (n, 16) with centres (n, 16, 3) relative to feet (n, 3).

    `begin` is the first used circle.
    """
    stems = np.zeros(len(foot_m), STEM)
    from_m = middle_m[:, begin]
    axis = unit(middle_m[:, -1] - from_m)
    along_m = (middle_m[..., 2] - from_m[:, None, 2]) / axis[:, 2:]
    stems["foot_m"] = foot_m + from_m
    stems["axis"] = axis
    stems["along_m"] = along_m
    stems["radius_m"] = radius_m
    aside_m = middle_m - from_m[:, None] - along_m[..., None] * axis[:, None]
    stems["aside_m"] = np.moveaxis(aside_m[..., :2], 2, 1)
    return stems
