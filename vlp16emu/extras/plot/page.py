"""Scores as a page of HTML that needs no other file and no network."""

import base64
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from html import escape
from importlib.resources import files
from pathlib import Path

from vlp16emu.errors import OutputError
from vlp16emu.extras.plot.sheet import Report, check_matplotlib, picture_of
from vlp16emu.output import OutputFile

_STYLE = files(__package__).joinpath("page.css").read_text(encoding="utf-8")
_MEANING = {
    "ate_m": "RMSE of positions, m",
    "ate_max_m": "greatest error of a position, m",
    "rpe_m": "RMSE of positions over 1 m of path, m",
    "rpe_deg": "RMSE of rotations over 1 m of path, degrees",
    "drift_10m_percent": "mean error of position over 10 m of path, % of the length",
    "drift_100m_percent": "mean error of position over 100 m of path, % of the length",
    "stamp_offset_s": "time to add to the estimate's stamps, s",
    "time_offset_s": "time of the estimate's stamps minus UTC, taken off before scoring, s",
    "infra_d_per_m2": "points per m2 of plan around the start",
    "infra_nuc": "evenness of these points, 0 is perfectly even",
    "accuracy_m": "mean distance from points of the map to true points, m",
    "completeness_m": "mean distance from true points to points of the map, m",
    "chamfer_m": "sum of both, m",
    "precision_": "share of the map's points within this distance of a true one",
    "completeness_": "share of true points within this distance of one of the map",
    "stem_precision": "share of found stems that are true",
    "stem_recall": "share of true stems that were found",
    "stem_f1": "harmonic mean of both",
    "stem_position_m": "RMSE of positions of stems, m",
    "dbh_bias_m": "mean error of DBH, m; above 0 is too thick",
    "dbh_m": "RMSE of DBH, m",
    "leaf_wood_accuracy": "share of points with the right label, leaf or wood",
    "wood_iou": "intersection over union of wood",
    "leaf_iou": "intersection over union of leaf",
    "leaf_wood_miou": "mean of both",
    "pq": "panoptic quality of trees",
    "sq": "segmentation quality: mean overlap of matched trees",
    "rq": "recognition quality: F1 of matched trees",
    "instance_": "the same of tree instances that overlap by more than half",
    "box_": "average precision of boxes of trees",
}
"""Meaning of scores by name, or by the beginning of names."""
_COLUMNS = {
    "kind": "tree",
    "true_id": "in the inventory",
    "list_line": "list line",
    "found_number": "own number",
    "x_m": "x, m",
    "y_m": "y, m",
    "range_m": "from the path, m",
    "position_error_m": "position error, m",
    "true_dbh_m": "DBH, m",
    "dbh_error_m": "DBH error, m",
    "hits": "points at breast height",
}


@contextmanager
def page_writing(path: Path | None, inputs: Iterable[Path]) -> Iterator[Callable[[Report], None]]:
    """Open a page before the scores are computed, and yield the function that writes a report into it.

    Without a path that function does nothing. Raises OutputError for another ending than .html, or a file
    that cannot be written; MissingExtraError without matplotlib.
    """
    if path is None:
        yield lambda _: None
        return
    if path.suffix.lower() != ".html":
        raise OutputError(f"--out {path}", f"found the ending {path.suffix!r}", ".html")
    check_matplotlib()
    with OutputFile(path, where=f"--out {path}", inputs=inputs) as output:

        def write(report: Report) -> None:
            with output.writing() as file:
                file.write(page_of(report).encode())

        yield write


def page_of(report: Report) -> str:
    """Return a report of scores as HTML; pictures, if there is a trajectory or stems, are inside."""
    reference = report["reference"]
    title = f"Scores: {reference['title']}" if reference else "Scores"
    inputs = [
        (name.replace("_", " "), _text(value))
        for name, value in report["inputs"].items()
        if value is not None
    ]
    about = [("written by", report["written_by"])]
    if reference:
        about += [
            ("reference", f"{reference['title']}, seed {reference['seed']}, world {reference['world']}")
        ]
    scores = [(name, _text(value), _meaning(name)) for name, value in report["scores"].items()]
    parts = [
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{escape(title)}</title>",
        f"<style>{_STYLE}</style>",
        f"<h1>{escape(title)}</h1>",
        *(f'<p class="missed">missed: {escape(line)}</p>' for line in report["missed"]),
        _table(("score", "value", "meaning"), scores),
        *(f"<p>{escape(group)}: {escape(note)}</p>" for group, note in report["notes"].items()),
    ]
    if report["path"] or report["trees"]:
        picture = base64.b64encode(picture_of(report, ".png")).decode()
        parts.append(f'<img alt="pictures of the scores" src="data:image/png;base64,{picture}">')
    parts += ["<h2>What was scored</h2>", _table(("", ""), [*about, *inputs])]
    if report["trees"]:
        rows = [tuple(_text(row[name]) for name in _COLUMNS) for row in report["trees"]]
        parts += ["<h2>Trees</h2>", _table(tuple(_COLUMNS.values()), rows)]
    return "\n".join([*parts, "</html>\n"])


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table; cells with a number are aligned right."""
    lines = [f"<tr>{''.join(f'<th>{escape(name)}</th>' for name in head)}</tr>"] if any(head) else []
    for row in rows:
        cells = (f"<td{' class=n' if _is_number(cell) else ''}>{escape(cell)}</td>" for cell in row)
        lines.append(f"<tr>{''.join(cells)}</tr>")
    return f"<table>{''.join(lines)}</table>"


def _is_number(cell: str) -> bool:
    return bool(cell) and cell.replace(".", "").replace("-", "").replace("e", "").isdigit()


def _meaning(name: str) -> str:
    longest = max((key for key in _MEANING if name.startswith(key)), key=len, default="")
    return _MEANING.get(longest, "")


def _text(value: object) -> str:
    if value is None:
        return "not known"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
