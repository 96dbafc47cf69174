"""Pictures of a walk for `tools/forest`: from the side, from above, at breast height, sections of stems."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vlp16emu import Emulator
from vlp16emu.extras.survey import survey
from vlp16emu.types import PlantPart

STEM_PARTS = PlantPart.STEM, PlantPart.ROOT_FLARE
LOOKS = {  # colours after Okabe and Ito, which the colour blind can tell apart
    "ground, stones": ((PlantPart.NONE,), "#b0a898"),
    "stem": (STEM_PARTS, "#d55e00"),
    "branch": ((PlantPart.BRANCH_FIRST_ORDER, PlantPart.BRANCH_HIGHER_ORDER), "#e69f00"),
    "dead branch": ((PlantPart.DEAD_BRANCH,), "#7b3fa0"),
    "leaf": ((PlantPart.LEAF,), "#009e73"),
}
SLAB_M = 0.5, 4.5  # distance of the side view from the line from start to end, to its left
BREAST_M = 1.2, 1.4
SECTIONS = 12
COLOURS = 64  # of a picture's palette
Array = np.ndarray


class Walk(NamedTuple):
    """Points of a walk in a frame with x from its start to its end, and its trees."""

    points: dict[str, Array]
    xyz_m: Array  # (n, 3)
    path_m: Array  # (p, 2)
    stems: list[tuple[int, Array, float]]
    """Instance, centre at breast height (2,) and DBH of trees, the nearest first."""


def along_path(emulator: Emulator, points: dict[str, Array]) -> Walk:
    """Return the points of a walk in its own frame, and the trees nearest to its path."""
    path_m = points["viewpoint_m"][::5000, :2]
    ahead = path_m[-1] - path_m[0]
    ahead = ahead / np.hypot(*ahead)
    turn = np.array([[ahead[0], -ahead[1]], [ahead[1], ahead[0]]])
    trees = survey(emulator.scenario, 15.0, emulator.parts)
    rows = trees.inventory(trees.near)
    centres_m = np.column_stack([rows["x_breast_m"], rows["y_breast_m"]])
    away_m = np.linalg.norm(centres_m[:, None] - path_m, axis=2).min(axis=1)
    nearest = [i for i in np.argsort(away_m) if rows["dbh_m"][i] >= 0.05][:SECTIONS]
    own_m = (centres_m - path_m[0]) @ turn
    stems = [(int(rows["id"][i]), own_m[i], float(rows["dbh_m"][i])) for i in nearest]
    xyz_m = np.column_stack([(points["world_m"][:, :2] - path_m[0]) @ turn, points["world_m"][:, 2]])
    return Walk(points, xyz_m, (path_m - path_m[0]) @ turn, stems)


def scatter(axis: Any, walk: Walk, own: Array, axes: tuple[int, int], size: float) -> None:
    """Draw some points by part, in two of the three axes; leaves first, so that stems stay visible."""
    part = walk.points["part"][own]
    for parts, colour in reversed(LOOKS.values()):
        xyz_m = walk.xyz_m[own][np.isin(part, parts)]
        axis.scatter(xyz_m[:, axes[0]], xyz_m[:, axes[1]], s=size, color=colour, lw=0, rasterized=True)
    axis.set_aspect("equal")


def draw(scene: str, walk: Walk, path: Path) -> None:
    """Draw the views of a walk."""
    import matplotlib.pyplot as plt
    from matplotlib.patches import Circle, Patch
    from PIL import Image

    figure = plt.figure(figsize=(11, 13), layout="constrained")
    grid = figure.add_gridspec(5, 6, height_ratios=[3, 3, 3, 1.5, 1.5])
    side, above, breast = (figure.add_subplot(grid[row, :]) for row in range(3))
    x_m, y_m, z_m = walk.xyz_m.T
    height_m = walk.points["height_m"]
    long_m = walk.path_m[:, 0].max()
    near = (x_m > -5) & (x_m < long_m + 5)
    scatter(side, walk, near & (y_m > SLAB_M[0]) & (y_m < SLAB_M[1]), (0, 2), 0.3)
    side.set_title(f"{scene}: a slab {SLAB_M[1] - SLAB_M[0]:g} m deep beside the path, from the side")
    beside = near & (np.abs(y_m) < 8)
    at_breast = (height_m > BREAST_M[0]) & (height_m < BREAST_M[1])
    scatter(above, walk, beside, (0, 1), 0.1)
    above.set_title("from above, the path dashed")
    scatter(breast, walk, beside & at_breast, (0, 1), 1.0)
    breast.set_title(f"{BREAST_M[0]:g} to {BREAST_M[1]:g} m above the ground, numbers of the sections below")
    for axis in (above, breast):
        axis.plot(*walk.path_m.T, color="black", lw=0.8, ls="--")
    for number, (instance, centre_m, dbh_m) in enumerate(walk.stems, 1):
        axis = figure.add_subplot(grid[3 + (number - 1) // 6, (number - 1) % 6])
        half_m = 0.75 * dbh_m + 0.1
        own = at_breast & (np.abs(walk.xyz_m[:, :2] - centre_m) < half_m).all(axis=1)
        scatter(axis, walk, own, (0, 1), 2.0)
        axis.add_patch(Circle(tuple(centre_m), dbh_m / 2, fill=False, lw=0.8, ls=":"))
        hits = int((own & (walk.points["instance"] == instance)).sum())
        axis.set_title(f"{number}: {100 * dbh_m:.0f} cm, {hits} points", fontsize=8)
        axis.set(xticks=[], yticks=[], xlim=centre_m[0] + np.array([-half_m, half_m]))
        axis.set_ylim(centre_m[1] - half_m, centre_m[1] + half_m)
        breast.annotate(str(number), tuple(centre_m), fontsize=8, xytext=(4, 4), textcoords="offset points")
    side.set(ylabel="height, m", ylim=(z_m[near].min() - 0.5, np.quantile(z_m[near], 0.9999) + 1))
    above.set(ylabel="to the left, m")
    breast.set(xlabel="along the path, m", ylabel="to the left, m")
    entries = [Patch(color=colour, label=name) for name, (_, colour) in LOOKS.items()]
    figure.legend(handles=entries, loc="outside lower center", ncols=len(entries), frameon=False)
    figure.savefig(path, dpi=85)
    plt.close(figure)
    picture = Image.open(path).convert("RGB")
    picture.quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE).save(path, optimize=True)
