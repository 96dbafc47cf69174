"""The score card as one page of HTML, its pictures within it."""

import base64
import io
import math
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING

from vlp16emu.score.card import ScoreCard

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_STYLE = (
    "body{font:15px/1.45 sans-serif;max-width:60em;margin:2em auto;padding:0 1em;color:#222}"
    "table{border-collapse:collapse}td,th{padding:.2em .8em;border-bottom:1px solid #ddd;text-align:left}"
    "td.n{text-align:right;font-variant-numeric:tabular-nums}img{max-width:100%}.missed{color:#b00020}"
)


def page(card: ScoreCard, missed: Sequence[str]) -> str:
    """Write a card and the thresholds that it misses as HTML; needs matplotlib where there is something to draw."""
    parts = [
        f"<!doctype html><meta charset=utf-8><title>Score card</title><style>{_STYLE}</style><h1>Score card</h1>"
    ]
    parts += [f'<p class="missed">missed: {escape(line)}</p>' for line in missed]
    parts += [_table(("score", "value"), [(name, _number(value)) for name, value in card.scores.items()])]
    parts += [f"<p>{escape(group)}: {escape(note)}</p>" for group, note in card.notes.items()]
    if card.path is not None or card.trees:
        parts.append(f'<img alt="plots" src="data:image/png;base64,{_picture(card)}">')
    if card.trees:
        head = (
            "tree",
            "list line",
            "own number",
            "x m",
            "y m",
            "position error m",
            "DBH m",
            "DBH error m",
            "hits",
        )
        rows = [
            (
                row.true_id,
                row.list_line,
                row.found_number,
                *map(_number, (row.x_m, row.y_m, row.position_error_m, row.true_dbh_m, row.dbh_error_m)),
                "" if row.hits is None else str(row.hits),
            )
            for row in card.trees
        ]
        parts += ["<h2>Trees</h2>", _table(head, rows)]
    return "\n".join(parts) + "\n"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Write a table, all but the first column as numbers."""
    lines = [f"<tr>{''.join(f'<th>{escape(name)}</th>' for name in head)}</tr>"]
    for first, *others in rows:
        cells = "".join(f'<td class="n">{escape(text)}</td>' for text in others)
        lines.append(f"<tr><td>{escape(first)}</td>{cells}</tr>")
    return f"<table>{''.join(lines)}</table>"


def _number(value: float) -> str:
    return f"{value:.4g}" if math.isfinite(value) else ""


def _picture(card: ScoreCard) -> str:
    """Draw path, stems and errors of diameters; PNG as base64."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.6), layout="constrained")
    _draw(figure, card)
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=110)
    return base64.b64encode(file.getvalue()).decode()


def _draw(figure: "Figure", card: ScoreCard) -> None:
    """Draw a plan on the left; errors over poses or over hits on the right."""
    plan, errors = figure.subplots(1, 2)
    plan.set(xlabel="east, m", ylabel="north, m", aspect="equal", title="plan")
    if (path := card.path) is not None:
        plan.plot(*path.true_m[:, :2].T, color="#222", label="true path")
        plan.plot(*path.found_m[:, :2].T, color="#d1495b", lw=1, label="estimate")
    styles = (("found", "#2e7d32", "o"), ("missed", "#999", "x"), ("false", "#d1495b", "+"))
    for name, colour, marker in styles:
        rows = [row for row in card.trees if _kind(row.true_id, row.found_number) == name]
        if rows:
            plan.scatter(
                [r.x_m for r in rows], [r.y_m for r in rows], c=colour, marker=marker, s=18, label=name
            )
    plan.legend(fontsize=8)
    measured = [row for row in card.trees if math.isfinite(row.dbh_error_m)]
    if measured:
        errors.axhline(0, color="#999", lw=1)
        errors.scatter(
            [r.true_dbh_m * 100 for r in measured], [r.dbh_error_m * 100 for r in measured], c="#2e7d32", s=18
        )
        errors.set(xlabel="true DBH, cm", ylabel="DBH error, cm", title="diameters")
    elif path is not None:
        errors.plot(path.errors_m, color="#d1495b")
        errors.set(xlabel="pose", ylabel="position error, m", title="trajectory")
    else:
        errors.set_axis_off()


def _kind(true_id: str, found_number: str) -> str:
    return "false" if not true_id else "found" if found_number else "missed"
