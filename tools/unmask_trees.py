"""Trees that rank windows of emulated and of real units.

`tools/unmask` runs it in an environment with scikit-learn.

python tools/unmask_trees.py WINDOWS.npz
"""

import sys
import warnings
from collections.abc import Iterator

import numpy as np
from sklearn.ensemble import HistGradientBoostingClassifier
from sklearn.inspection import permutation_importance
from sklearn.metrics import roc_auc_score

Array = np.ndarray
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
    trees.fit(x[learnt], positive[learnt], weights_of(data, learnt, positive))
    return roc_auc_score(positive[ranked], trees.decision_function(x[ranked])), trees


def null(data: Data, x: Array) -> list[float]:
    """Return areas with two real units per class: one of each class is learnt, the others are ranked."""
    out, units = [], data.units[True]
    for a in units:
        for b in (one for one in units if one > a):
            c, d = (one for one in units if one not in (a, b))
            for positive, negative in (((a, c), (b, d)), ((a, d), (b, c))):
                is_positive = np.isin(data.unit, positive)
                learnt, ranked = (np.isin(data.unit, pair) for pair in zip(positive, negative, strict=True))
                out.append(ranked_by(data, x, learnt, ranked, is_positive)[0])
    return out


def report(data: Data, wanted: Array, title: str, *, whole: bool = False) -> None:
    """Print the areas of the trees for some features.

    With `whole` also those of real units against each other, and the top features.
    """
    names, x = data.names[wanted], data.features[:, wanted]
    carried, areas = np.zeros(len(names)), []
    for _, learnt, ranked in folds(data):
        area, trees = ranked_by(data, x, learnt, ranked, data.real)
        areas.append(area)
        if whole:
            other = permutation_importance(
                trees, x[learnt], data.real[learnt], scoring="roc_auc", n_repeats=1
            )
            carried += other.importances_mean
    own = np.reshape(areas, (-1, 2)).mean(axis=1)
    chance = null(data, x) if whole else []
    between = f"{np.mean(chance):.2f} +- {np.std(chance):.2f}" if whole else ""
    print(
        f"| {title} ({len(names)}) | {np.mean(areas):.2f} | {' '.join(f'{one:.2f}' for one in own)} | "
        f"{between} |",
        flush=True,
    )
    if not whole:
        return
    for i in np.argsort(-carried)[:5]:
        seen = np.isfinite(x[:, i])
        single = roc_auc_score(data.real[seen], x[seen, i])
        real = " ".join(f"{np.nanmedian(x[data.unit == unit, i]):.3g}" for unit in data.units[True])
        ours = " ... ".join(f"{value:.3g}" for value in np.nanquantile(x[~data.real, i], (0.1, 0.5, 0.9)))
        print(f"| - {names[i]} | {max(single, 1 - single):.2f} | {real} | {ours} |")


def main() -> None:
    """Print the areas of all trees."""
    data = Data(sys.argv[1])
    counts = shown_by_all(data)
    of_scene = ~(scene_share(data) < SCENE_SHARE)
    print(
        f"Real units: {', '.join(data.units[True])}. A row of a feature: its own area, its middle on "
        "these, and P10, P50, P90 of ours.\n"
    )
    print("| Trees | area | left out: each real unit | real against real |\n|---|---|---|---|")
    of_unit = counts & ~of_scene
    report(data, of_unit, "features of units", whole=True)
    for group in dict.fromkeys(data.groups[of_unit]):
        report(data, of_unit & (data.groups == group), f"{group} alone")
    report(data, counts & of_scene, "features of scenes")
    print(
        f"\nOf the scene, with more than {SCENE_SHARE:.0%} of their variance between scenes: "
        f"{', '.join(data.names[counts & of_scene])}"
    )


if __name__ == "__main__":
    main()
