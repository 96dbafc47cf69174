"""Cost of a run by stage of the chain."""

from typing import TYPE_CHECKING

import numpy as np

from vlp16emu.extras.plot.sheet import BLUE, INK, ORANGE, SOFT, VERMILION, Report

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLOURS = {"open": ORANGE, "cast": VERMILION, "audi": SOFT}
"""Colours by the first four letters of stages; the others are blue."""


def draw(figure: "Figure", report: Report) -> None:
    """Draw a bar for each stage, in the order of the chain, and their sum beside the cores of the run."""
    figure.set_size_inches(12, 6)
    stages = report["stages"]
    measured = report["measured"]
    cost_s = np.array([stage["cpu_s_per_s"] for stage in stages])
    axes = figure.add_subplot()
    colours = [_COLOURS.get(stage["name"][:4], BLUE) for stage in stages]
    bars = axes.barh(range(len(stages)), cost_s, color=colours, height=0.75)
    for bar, stage in zip(bars, stages, strict=True):
        bar.set_gid(f"stage-{stage['name']}")
    for row, cost in enumerate(cost_s.tolist()):
        text = f"{cost:.3f} s, {100 * cost / cost_s.sum():.0f} %"
        axes.annotate(
            text, (cost, row), (6, 0), textcoords="offset points", va="center", fontsize=11, color=INK
        )
    axes.set_yticks(range(len(stages)), [stage["name"] for stage in stages])
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    axes.set_xlim(0, 1.25 * cost_s.max())
    axes.set(xlabel="processor time, seconds of one core per simulated second")
    speed = f"ran at {measured['real_time_factor']:.2f} x real time on {report['threads']} threads"
    stream = f"a stream keeps up: {report['stream']['verdict']}"
    figure.suptitle(
        f"{report['scene']}, seed {report['seed']}: {cost_s.sum():.2f} core seconds per second\n{speed}; "
        f"{stream}"
    )
