"""The score card as one page of HTML with embedded pictures."""

import base64
import io
import math
from collections.abc import Sequence
from dataclasses import astuple
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from vlp16emu.extras.plots import INK, SOFT, plotted
from vlp16emu.extras.score.card import ScoreCard

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_STYLE = (
    "body{font:15px/1.45 sans-serif;max-width:60em;margin:2em auto;padding:0 1em;color:#222}"
    "table{border-collapse:collapse}td,th{padding:.2em .8em;border-bottom:1px solid #ddd;text-align:left}"
    "td.n{text-align:right;font-variant-numeric:tabular-nums}img{max-width:100%}.missed{color:#b00020}"
)
_HEAD = ["tree", "list line", "own number", "x m", "y m", "position error m", "DBH m", "DBH error m", "hits"]
_SIZE_PX = 1100, 460


def page(card: ScoreCard, missed: Sequence[str]) -> str:
    """Return a card and the thresholds that it misses as HTML; matplotlib is needed if there is something to draw."""
    parts = [
        "<!doctype html><meta charset=utf-8><meta name=generator content=vlp16emu><title>Score card</title>",
        f"<style>{_STYLE}</style><h1>Score card</h1>",
        *(f'<p class="missed">missed: {escape(line)}</p>' for line in missed),
        _table(("score", "value"), list(card.scores.items())),
        *(f"<p>{escape(group)}: {escape(note)}</p>" for group, note in card.notes.items()),
    ]
    if card.path is not None or card.trees:
        file = io.BytesIO()
        with plotted(file, _SIZE_PX) as figure:
            _draw(figure, card)
        picture = base64.b64encode(file.getvalue()).decode()
        parts.append(f'<img alt="plots" src="data:image/png;base64,{picture}">')
    if card.trees:
        parts += ["<h2>Trees</h2>", _table(_HEAD, [astuple(row) for row in card.trees])]
    return "\n".join(parts) + "\n"


def _table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return a table, all but the first column as numbers."""
    lines = [f"<tr>{''.join(f'<th>{escape(name)}</th>' for name in head)}</tr>"]
    for first, *others in rows:
        cells = "".join(f'<td class="n">{escape(_text(value))}</td>' for value in others)
        lines.append(f"<tr><td>{escape(_text(first))}</td>{cells}</tr>")
    return f"<table>{''.join(lines)}</table>"


def _text(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}" if math.isfinite(value) else ""
    return "" if value is None else str(value)


def _draw(figure: "Figure", card: ScoreCard) -> None:
    plan, errors = figure.subplots(1, 2)
    plan.set(xlabel="east, m", ylabel="north, m", aspect="equal", title="plan")
    if (path := card.path) is not None:
        plan.plot(*path.true_m[:, :2].T, color=INK, label="true path")
        plan.plot(*path.found_m[:, :2].T, color="C3", lw=1, label="estimate")
    for name, colour, marker in (("found", "C2", "o"), ("missed", SOFT, "x"), ("false", "C3", "+")):
        if of := [row for row in card.trees if row.kind == name]:
            plan.scatter([r.x_m for r in of], [r.y_m for r in of], c=colour, marker=marker, s=18, label=name)
    plan.legend()
    measured = [row for row in card.trees if math.isfinite(row.dbh_error_m)]
    if measured:
        errors.axhline(0, color=SOFT, lw=1)
        both_cm = 100 * np.array([(row.true_dbh_m, row.dbh_error_m) for row in measured])
        errors.scatter(*both_cm.T, c="C2", s=18)
        errors.set(xlabel="true DBH, cm", ylabel="DBH error, cm", title="diameters")
    elif path is not None:
        errors.plot(path.errors_m, color="C3")
        errors.set(xlabel="pose", ylabel="position error, m", title="trajectory")
    else:
        errors.set_axis_off()
