"""Scores of a pipeline from its output files, and thresholds for the scores."""

import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

import numpy as np

from vlp16emu.errors import InputError
from vlp16emu.extras.clouds.deskew import Trajectory
from vlp16emu.extras.options import ScoreInputs
from vlp16emu.extras.score import measures
from vlp16emu.extras.score.files import Stem, read_cloud, read_stems
from vlp16emu.extras.score.paths import RPE_DELTA_M, PathErrors, score_path
from vlp16emu.forest.plants.allometry import BREAST_HEIGHT_M
from vlp16emu.scenario import load
from vlp16emu.trees import Table, Tree
from vlp16emu.types import F8, AnyArray, PlantPart, Semantic
from vlp16emu.units import MS_NS, S_NS

Cloud = Mapping[str, AnyArray]

WITHIN_M = (0.05, 0.1, 0.2)  # distances for precision and completeness of a map
SAME_POINT_M = 0.02
"""A labelled point represents the nearest true point within this distance: half a beam's width near the
sensor."""
LEAST_POINTS = 10  # least number of points of a visible tree: fewer give neither a stem nor a box
REGION_M = 20.0  # radius around the first true position in which density and uniformity of a map are measured
_STEP_NS = 100 * MS_NS  # between points of the path for the range of trees: a decimetre at walking speed
_BREAST_M = 0.1  # half the height of the stem's slice whose points count as hits for the DBH: 1.2 to 1.4 m
_SIGNS = MappingProxyType({"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge})
_LIMIT = re.compile(r"\s*(\w+)\s*(<=|>=|<|>)\s*([-+.\deE]+)\s*")
_UNDEFINED = (
    ("stamp_offset", "the motion is too uniform, or poses are too few"),
    ("drift", "the path is shorter"),
    ("rpe", "the path is shorter than 1 m"),
    ("infra", "the map has no point near the start"),
    ("stem_position", "no stem is paired"),
    ("dbh", "no pair has a DBH"),
    ("leaf", "no true point has this label"),
    ("wood", "no true point has this label"),
)
"""Why a score is NaN, by the beginning of its name; for others there is nothing to find and nothing found."""
Limit = tuple[str, str, float]  # a threshold: name of a score, sign and bound; NaN never meets it


@dataclass(frozen=True, slots=True)
class TreeRow:
    """A true tree, a found tree, or a pair of both."""

    true_id: str  # number in the inventory; empty if a found tree is false
    list_line: str  # line of the user's stem list that named the true tree
    found_number: str  # number of the found tree in its own list; empty if the tree is missed
    x_m: float
    y_m: float
    position_error_m: float
    true_dbh_m: float
    dbh_error_m: float  # found value minus true value
    hits: int | None
    """True points on the stem from 1.2 to 1.4 m over the foot; None without labelled true points."""
    range_m: float  # horizontal distance from the true path of the sensor; NaN without a path

    @property
    def kind(self) -> str:
        """One of `found`, `missed` and `false`, which is a found tree without a true one."""
        if not self.true_id:
            return "false"
        return "found" if self.found_number else "missed"


@dataclass(slots=True)
class ScoreCard:
    """Scores, with the data behind them."""

    inputs: ScoreInputs
    scores: dict[str, float] = field(default_factory=dict)
    notes: dict[str, str] = field(default_factory=dict)  # description of the measure by group of scores
    trees: list[TreeRow] = field(default_factory=list)
    path: PathErrors | None = None
    reference: Table | None = None  # title and seed of the walk; None if the truth has no scenario

    def texts(self) -> dict[str, str]:
        """Return the scores as text, with the reason where one is NaN."""
        return {name: _score_text(name, value) for name, value in self.scores.items()}

    def failed_limits(self, limits: Sequence[Limit]) -> list[str]:
        """Return the failed thresholds, with the values, as text.

        Raises InputError if there is no score of that name.
        """
        failed = []
        for name, sign, bound in limits:
            if name not in self.scores:
                raise InputError("--require", f"found {name}", ", ".join(self.scores))
            if not _SIGNS[sign](self.scores[name], bound):
                failed.append(f"{name} is {_score_text(name, self.scores[name])}, required {sign} {bound:g}")
        return failed


def _score_text(name: str, value: float) -> str:
    """Return a score as text; for NaN the reason."""
    if not math.isnan(value):
        return f"{value:.6f}" if name == "time_offset_s" else f"{value:.6g}"
    reason = next((text for begin, text in _UNDEFINED if name.startswith(begin)), "nothing to find")
    return f"none: {reason}"


def limits_of(texts: Sequence[str]) -> list[Limit]:
    """Read thresholds such as `ate_m<0.3`; InputError if one is malformed."""
    limits = list[Limit]()
    for text in texts:
        try:
            name, sign, bound = _LIMIT.fullmatch(text).groups()  # type: ignore[union-attr]
            limits.append((name, sign, float(bound)))
        except (AttributeError, ValueError):
            raise InputError("--require", f"found {text}", "NAME<NUMBER, with <, <=, > or >=") from None
    return limits


def make_card(inputs: ScoreInputs) -> ScoreCard:
    """Compute all scores that the given files allow.

    InputError if a file is malformed, or its ground truth is missing; MissingExtraError without the library
    for a file.
    """
    if not (inputs.trajectory or inputs.map or inputs.points or inputs.stems):
        raise InputError(
            "vlp16emu score", "found nothing to score", "--trajectory, --map, --points or --stems"
        )
    if inputs.points and not inputs.truth_points:
        raise InputError("--points", "found no true points", "--truth-points, of `vlp16emu points --truth`")
    if inputs.stems and not inputs.inventory:
        raise InputError("--stems", "found no true trees", "--inventory, of `vlp16emu forest --inventory`")
    card = ScoreCard(inputs, reference=_reference(inputs.truth))
    true = read_cloud(inputs.truth_points) if inputs.truth_points else None
    if inputs.trajectory:
        _score_trajectory(card, inputs.trajectory)
    if inputs.map:
        _score_map(card, read_cloud(inputs.map)["xyz"], true)
    if inputs.points and true is not None:
        _score_labels(card, read_cloud(inputs.points), true)
    if inputs.stems and inputs.inventory:
        _score_stems(card, read_stems(inputs.stems), read_stems(inputs.inventory), true)
    return card


def _score_trajectory(card: ScoreCard, trajectory: Path) -> None:
    """Score the poses of a trajectory."""
    inputs = card.inputs
    found = score_path(
        trajectory, inputs.times, inputs.truth, inputs.unit, inputs.alignment, inputs.time_offset_s
    )
    card.scores |= found.scores
    card.path = found.errors
    card.notes["trajectory"] = (
        f"alignment {inputs.alignment}; RPE over {RPE_DELTA_M:g} m of path, drift the mean over longer ones; "
        f"{found.poses} poses, {found.left_out} beyond the truth left out; RMSE by evo; the offset is to be "
        "added to the estimate's stamps"
    )
    if found.clock is not None:
        offset_s = found.clock.offset_ns / S_NS
        card.scores["time_offset_s"] = offset_s
        card.notes["stamps"] = f"of the estimate, minus UTC: {offset_s:.6f} s ({found.clock.clock})"


def _score_map(card: ScoreCard, points_m: F8, true: Cloud | None) -> None:
    """Score a map (n, 3): its points around the start, and its distances from the true points."""
    centre_m = Trajectory(card.inputs.truth, card.inputs.unit).first_m[:2]
    card.scores["infra_d_per_m2"] = measures.density_per_m2(points_m[:, :2], centre_m, REGION_M)
    card.scores["infra_nuc"] = measures.uniformity(points_m[:, :2], centre_m, REGION_M)
    card.notes["map"] = (
        f"InfraD and InfraNUC in plan, {REGION_M:g} m around the first true position; no alignment"
    )
    if true is not None:
        card.scores |= measures.cloud_distances(points_m, true["xyz"], WITHIN_M)


def _require_columns(true: Cloud, *names: str) -> None:
    """Raise InputError if the true points have no column of a name."""
    for name in names:
        if name not in true:
            raise InputError("--truth-points", f"no column {name}", "points of `vlp16emu points --truth`")


def _score_labels(card: ScoreCard, found: Cloud, true: Cloud) -> None:
    """Score labels at the true points; a true point without a near labelled point has no label."""
    from scipy.spatial import KDTree

    apart_m, nearest = KDTree(found["xyz"]).query(true["xyz"])
    is_apart = apart_m > SAME_POINT_M
    names = [name for name in ("leaf_wood", "instance") if name in found]
    if not names:
        raise InputError(str(card.inputs.points), "found no labels", "a column leaf_wood or instance")
    _require_columns(true, "semantic", *names)
    is_tree = true["semantic"] == Semantic.TREE
    if "leaf_wood" in found:
        labels = np.where(is_apart, 0, found["leaf_wood"][nearest])
        card.scores |= measures.leaf_wood_scores(labels, np.where(is_tree, true["leaf_wood"], 0))
    if "instance" in found:
        trees = np.where(is_tree, true["instance"], 0)
        if "semantic" in found:  # our instances include shrubs and stones
            found = {**found, "instance": np.where(found["semantic"] == Semantic.TREE, found["instance"], 0)}
        card.scores |= measures.instance_scores(np.where(is_apart, 0, found["instance"][nearest]), trees)
        boxes, counts = measures.boxes_of(found["xyz"], found["instance"], LEAST_POINTS)
        true_boxes, _ = measures.boxes_of(true["xyz"], trees, LEAST_POINTS)
        card.scores |= measures.box_scores(boxes, counts, true_boxes)
    card.notes["labels"] = (
        f"a true point has the label of the nearest point within {SAME_POINT_M:g} m; trees alone; boxes of "
        f"{LEAST_POINTS} points or more, their number is the confidence"
    )


def _score_stems(
    card: ScoreCard, found: tuple[Stem, ...], trees: tuple[Stem, ...], true: Cloud | None
) -> None:
    """Score a list of stems against trees, those with enough true points if these are given."""
    hits: list[int | None] = [None] * len(trees)
    seen = trees
    if true is not None:
        on_stem, points = _point_counts(trees, true)
        kept = [i for i, count in enumerate(points) if count >= LEAST_POINTS]
        seen = tuple(trees[i] for i in kept)
        hits = [on_stem[i] for i in kept]
    pairs = measures.match_stems(found, seen, card.inputs.radius_m)
    card.scores |= measures.stem_scores(found, seen, pairs)
    found_by_tree = {j: found[i] for i, j in pairs}
    range_m = _range_from_path(card.inputs)
    card.trees += [_row(found_by_tree.get(j), tree, hits[j], range_m) for j, tree in enumerate(seen)]
    paired = {i for i, _ in pairs}
    card.trees += [_row(stem, None, None, range_m) for i, stem in enumerate(found) if i not in paired]
    scope = "all trees of the inventory"
    if true is not None:
        scope = f"trees with {LEAST_POINTS} true points or more"
    card.notes["stems"] = f"{scope}; pairs within {card.inputs.radius_m:g} m"


def _row(
    found: Stem | None, tree: Stem | None, hits: int | None, range_m: Callable[[float, float], float]
) -> TreeRow:
    """Return the row of a found stem, of a true tree, or of a pair; `range_m` as in `_range_from_path`."""
    missing = Stem("", math.nan, math.nan, math.nan, math.nan, "")
    stem = found or missing
    true = tree or missing
    place = tree or found or missing
    return TreeRow(
        true_id=true.number,
        list_line=true.list_line,
        found_number=stem.number,
        x_m=place.x_m,
        y_m=place.y_m,
        position_error_m=math.hypot(stem.x_m - true.x_m, stem.y_m - true.y_m),
        true_dbh_m=true.dbh_m,
        dbh_error_m=stem.dbh_m - true.dbh_m,
        hits=hits,
        range_m=range_m(place.x_m, place.y_m),
    )


def _reference(truth: Path) -> Tree | None:
    """Return title, seed and world of the walk whose truth is in a folder; None without its scenario."""
    if not (scene := truth / "scenario.json").is_file():
        return None
    scenario = load(str(scene))
    return {"title": scenario.title, "seed": scenario.seed, "world": scenario.world.kind}


def _range_from_path(inputs: ScoreInputs) -> Callable[[float, float], float]:
    """Return the function that gives the distance of a place from the true path.

    The distance is NaN if the truth has no path.
    """
    from scipy.spatial import KDTree

    if not (inputs.truth / "rig.json").is_file():
        return lambda _x_m, _y_m: math.nan
    path = Trajectory(inputs.truth, inputs.unit)
    begin_ns, end_ns = (int(at_s * S_NS) for at_s in path.span_s)
    _, place_m = path.poses_at(np.arange(begin_ns, end_ns + 1, _STEP_NS))
    tree = KDTree(place_m[:, :2])
    return lambda x_m, y_m: round(float(tree.query([x_m, y_m])[0]), 3)


def _point_counts(trees: tuple[Stem, ...], true: Cloud) -> tuple[list[int], list[int]]:
    """Return the number of points of each tree: on the stem at breast height, and in total."""
    _require_columns(true, "instance", "part")
    if not trees:
        return [], []
    numbers = np.array([int(tree.number) if tree.number.isdigit() else -1 for tree in trees])
    order = np.argsort(numbers)
    place = np.searchsorted(numbers[order], true["instance"]).clip(max=len(numbers) - 1)
    row = np.where(numbers[order][place] == true["instance"], order[place], -1)
    foot_m = np.array([tree.z_m for tree in trees])[row]
    at_breast = np.abs(true["xyz"][:, 2] - foot_m - BREAST_HEIGHT_M) <= _BREAST_M
    on_stem = (true["part"] == PlantPart.STEM) & at_breast
    stem_counts = np.bincount(row[(row >= 0) & on_stem], minlength=len(trees))
    tree_counts = np.bincount(row[row >= 0], minlength=len(trees))
    return stem_counts.tolist(), tree_counts.tolist()
