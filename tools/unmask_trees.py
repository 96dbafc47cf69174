"""Trees that rank windows of emulated and of real units.

`tools/unmask` runs it in an environment with scikit-learn.

python tools/unmask_trees.py WINDOWS.npz
"""

import sys
import warnings
from collections.abc import Iterator

import numpy as np
from sklearn.ensemble import HistGradientBoostingClassifier
from sklearn.metrics import roc_auc_score

Array = np.ndarray
BY_HAND = "by_hand"
EXPLAINED = 60
"""Number of features whose importance is asked for: those with the largest areas of their own."""
DIVISIONS = 20
"""Number of random divisions of real units into two classes."""
SCENE_SHARE = 0.3
"""Share of variance between scenes, over emulated windows, from which a feature belongs to the scene."""


class Data:
    """Windows of all units, with the class, the unit, the scene and the seed of each."""

    def __init__(self, path: str) -> None:
        file = np.load(path)
        self.names, self.features = file["names"], file["features"]
        self.groups = np.array([name.partition(".")[0] for name in self.names])
        self.unit, self.scene, self.seed = file["unit"], file["scene"], file["seed"]
        self.real = self.scene == "real"
        self.by_hand = self.groups == BY_HAND
        self.units = {
            is_real: list(dict.fromkeys(self.unit[self.real == is_real])) for is_real in (True, False)
        }


def scene_share(data: Data) -> Array:
    """Return the share of variance between scenes of each feature (f,), over emulated windows.

    Scenes have equal weights.
    """
    own = [data.features[~data.real & (data.scene == one)] for one in dict.fromkeys(data.scene[~data.real])]
    with warnings.catch_warnings(action="ignore"):  # a scene may lack a feature
        between = np.nanvar([np.nanmean(of, axis=0) for of in own], axis=0)
        within = np.nanmean([np.nanvar(of, axis=0) for of in own], axis=0)
    return np.where(data.groups == "scene", 1.0, between / np.maximum(between + within, 1e-30))


def shown_by_all(data: Data) -> Array:
    """Return True for each feature (f,) that half the windows of half the units of both classes have."""
    has = {
        unit: np.isfinite(data.features[data.unit == unit]).mean(axis=0) >= 0.5
        for unit in np.unique(data.unit)
    }
    return np.all(
        [np.mean([has[unit] for unit in units], axis=0) >= 0.5 for units in data.units.values()], axis=0
    )


def folds(data: Data) -> Iterator[tuple[str, Array, Array]]:
    """Yield each real unit twice, with the training windows without it, and the test windows.

    Each half of the emulated seeds is learnt once.
    """
    even = np.array([int(seed) % 2 == 0 for seed in data.seed])
    for unit in data.units[True]:
        out = data.unit == unit
        for half in (even, ~even):
            yield unit, (data.real & ~out) | (~data.real & ~half), out | (~data.real & half)


def weights_of(data: Data, rows: Array, positive: Array) -> Array:
    """Return weights by which all units of a class, and both classes, count equally."""
    weight = np.zeros(len(rows))
    for is_positive in (True, False):
        own = rows & (positive == is_positive)
        units, of, counts = np.unique(data.unit[own], return_inverse=True, return_counts=True)
        weight[own] = 1.0 / counts[of] / len(units)
    return weight[rows] * rows.sum() / 2


def ranked_by(
    data: Data, x: Array, learnt: Array, ranked: Array, positive: Array
) -> tuple[float, HistGradientBoostingClassifier]:
    """Return the area of trees that learn some windows and rank others, and the trees."""
    trees = HistGradientBoostingClassifier(
        max_depth=3,
        max_iter=60,
        learning_rate=0.1,
        min_samples_leaf=10,
        l2_regularization=1.0,
        random_state=0,
    )
    unknown = ~np.isfinite(x[learnt]).any(axis=0)  # bins need a value; trees cannot split at a constant
    x = np.where(unknown, 0.0, x)
    trees.fit(x[learnt], positive[learnt], weights_of(data, learnt, positive))
    return roc_auc_score(positive[ranked], trees.decision_function(x[ranked])), trees


def null(data: Data, x: Array) -> list[float]:
    """Return areas of real units in two random classes: one unit of each is ranked, the others are learnt."""
    units, drawn = data.units[True], np.random.default_rng(1)
    out = []
    if len(units) < 4:
        return out
    while len(out) < DIVISIONS:
        mixed = drawn.permutation(units)
        positive, negative = mixed[: len(units) // 2], mixed[len(units) // 2 :]
        learnt = np.isin(data.unit, [*positive[1:], *negative[1:]])
        ranked = np.isin(data.unit, [positive[0], negative[0]])
        out.append(ranked_by(data, x, learnt, ranked, np.isin(data.unit, positive))[0])
    return out


def report(data: Data, wanted: Array, title: str, *, whole: bool = False) -> None:
    """Print the areas of the trees for some features, and of real units against each other.

    With `whole` also the features that carry most.
    """
    names, x = data.names[wanted], data.features[:, wanted]
    if not len(names):
        print(f"| {title} (0) | - | - | - |", flush=True)
        return
    own_area = np.array([area_alone(data, x[:, i]) for i in range(len(names))]) if whole else None
    asked = np.argsort(-own_area)[:EXPLAINED] if whole else []
    carried, areas = np.zeros(len(asked)), []
    for _, learnt, ranked in folds(data):
        area, trees = ranked_by(data, x, learnt, ranked, data.real)
        areas.append(area)
        for place, feature in enumerate(asked):
            carried[place] += area - area_without(data, x, ranked, trees, feature)
    own = np.reshape(areas, (-1, 2)).mean(axis=1)
    chance = null(data, x)
    between = f"{np.mean(chance):.2f} +- {np.std(chance):.2f}" if chance else "-"
    print(
        f"| {title} ({len(names)}) | {np.mean(areas):.2f} | {' '.join(f'{one:.2f}' for one in own)} | "
        f"{between} |",
        flush=True,
    )
    for i in (asked[place] for place in np.argsort(-carried)[:8]):
        with warnings.catch_warnings(action="ignore"):  # a unit may lack a feature
            real = " ".join(f"{np.nanmedian(x[data.unit == unit, i]):.3g}" for unit in data.units[True])
        ours = " ... ".join(f"{value:.3g}" for value in np.nanquantile(x[~data.real, i], (0.1, 0.5, 0.9)))
        print(f"| - {names[i]} | {own_area[i]:.2f} | {real} | {ours} |")


def area_alone(data: Data, value: Array) -> float:
    """Return the area of one feature, at least 0.5, with the units of each class counting equally."""
    seen = np.isfinite(value)
    if len(np.unique(data.real[seen])) < 2:
        return 0.5
    area = roc_auc_score(data.real[seen], value[seen], sample_weight=weights_of(data, seen, data.real))
    return max(area, 1 - area)


def area_without(
    data: Data, x: Array, ranked: Array, trees: HistGradientBoostingClassifier, feature: int
) -> float:
    """Return the area of trees on windows whose values of one feature are shuffled."""
    mixed = x[ranked].copy()
    mixed[:, feature] = np.random.default_rng(feature).permutation(mixed[:, feature])
    return roc_auc_score(data.real[ranked], trees.decision_function(mixed))


def main() -> None:
    """Print the areas of all trees."""
    data = Data(sys.argv[1])
    counts = shown_by_all(data)
    of_scene = ~(scene_share(data) < SCENE_SHARE)
    print(
        f"Real units: {', '.join(data.units[True])}. A row of a feature: its own area, its middle on "
        "these, and P10, P50, P90 of emulated units.\n"
    )
    print("| Trees | area | left out: each real unit | real against real |\n|---|---|---|---|")
    of_unit = counts & ~of_scene & ~data.by_hand
    report(data, of_unit, "features of units", whole=True)
    for group in dict.fromkeys(data.groups[of_unit]):
        report(data, of_unit & (data.groups == group), f"{group} alone")
    report(data, counts & of_scene & ~data.by_hand, "features of scenes")
    report(data, counts & ~of_scene & data.by_hand, "chosen by hand")
    report(data, counts & of_scene & data.by_hand, "chosen by hand, of scenes")
    few = int((~counts & ~data.by_hand).sum())
    print(
        f"\n{few} of {(~data.by_hand).sum()} features have too few values on units of one class, and "
        f"{int((counts & of_scene & ~data.by_hand).sum())} belong to the scene: more than "
        f"{SCENE_SHARE:.0%} of their variance lies between emulated scenes."
    )


if __name__ == "__main__":
    main()
