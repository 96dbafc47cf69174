"""Results on standard output: as JSON, or as rows for people."""

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from vlp16emu.errors import printable
from vlp16emu.trees import Table, Tree

if TYPE_CHECKING:  # help prints none of them
    from vlp16emu.extras.accuracy.audit import AuditFinding
    from vlp16emu.extras.bench.gps_in import GpsInResult
    from vlp16emu.extras.bench.outlets import Away, OutletResult
    from vlp16emu.run.report import Turn, UnitSent
    from vlp16emu.run.stream import FirstPacket
    from vlp16emu.sinks import FellBehind
    from vlp16emu.sinks.pacing import Lateness

INTERRUPTED = (
    130  # exit code after Ctrl-C: 128 + SIGINT, as shells count (POSIX.1-2024, Shell, section 2.8.2)
)
_UNITS = {"_per_s": "per s", "_s": "s", "_us": "us", "_ns": "ns", "_m": "m", "_deg": "deg", "_hz": "Hz"}
_UNITS |= {"per_ha": "per ha", "_ha": "ha"}
"""Unit by the ending of a member's name."""
_LABELS = {
    "audit": "range error",
    "behind": "fell behind",
    "bytes": "size",
    "cut": "end",
    "first": "packet 0 left",
    "fit": "host's clock",
    "gaps_s": "gaps shortened",
    "gps_in": "receiver",
    "gps_out": "sentences",
    "imu_out": "samples",
    "keeps_up_with": "to keep up",
    "moved_s": "moved",
    "packets": "data packets",
    "per_ha": "density",
    "real_time_factor": "ran at",
    "wall_s": "run time",
    "walk_share": "of the walk",
}
_NUMBERS = re.compile(
    r"\[\n([^][{}\"]*)\]"
)  # a list of numbers as `json` indents it; text never holds a line feed
_SMALL_BYTES = 100_000
_WIDEST = 10.0  # ratio of the ends of an interval; beyond it not even the order of magnitude is known


def finish(result: object, title: str | None = None, *, as_json: bool) -> None:
    """Print a result, a dataclass or mapping, as rows under a title or as JSON.

    The program exits with 130 if it was interrupted.

    Without a title, the first line says that the first member was written.
    """
    (_, place), *others = members(result)
    interrupted = bool(dict(others).get("interrupted"))
    if as_json:
        print_json(result)
    elif title is None:
        print_rows(f"{'interrupted, kept' if interrupted else 'wrote'} {place}", rows_of(dict(others)))
    else:
        print_rows(title, rows_of(result))
    if interrupted:
        raise typer.Exit(INTERRUPTED)


def print_json(result: object) -> None:
    """Print one JSON object, each list of numbers on one line."""
    print(
        _NUMBERS.sub(lambda found: f"[{' '.join(found[1].split())}]", json.dumps(tree_of(result), indent=2))
    )


def report_of(verb: str, tree: Table) -> Tree:
    """Return the report of a verb in JSON types; `vlp16emu plot` draws it by its member `report`."""
    members_of = {name: tree_of(value) for name, value in tree.items()}
    return {"report": verb, "written_by": f"vlp16emu {version('vlp16emu')}", **members_of}


def print_file(path: Path | None) -> None:
    """Print that a file was written, with its size, unless none was wanted or it is standard output."""
    if path is not None and path.is_file():
        print_line(f"wrote {path}, {size(path.stat().st_size)}")


def print_line(text: str) -> None:
    """Print a line on standard output at once, with control characters escaped."""
    print(printable(text), flush=True)


def print_rows(title: str, rows: Mapping[str, str]) -> None:
    """Print a title and under it names and values in two columns."""
    print_line(title)
    width = max(map(len, rows), default=0)
    for name, value in rows.items():
        print_line(f"  {name:<{width}}  {value}")


def print_table(rows: Sequence[Sequence[str]]) -> None:
    """Print rows of cells in columns, the first aligned left and the others right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for first, *others in rows:
        cells = (text.rjust(width) for text, width in zip(others, widths[1:], strict=True))
        print_line("  ".join([first.ljust(widths[0]), *cells]))


def table_of(rows: Sequence[object]) -> list[list[str]]:
    """Return dataclasses as rows of cells, under a header of field names with units."""
    return [
        [name.replace("_", " ") for name, _ in members(rows[0])],
        *([value if isinstance(value, str) else f"{value:.4g}" for _, value in members(row)] for row in rows),
    ]


def tree_of(value: object) -> object:
    """Return a result in JSON types, with the properties of dataclasses beside their fields.

    It is NaN becomes null.
    """
    if is_dataclass(value) or isinstance(value, Mapping):
        return {name: tree_of(one) for name, one in members(value)}
    if isinstance(value, list | tuple | frozenset):
        return [tree_of(one) for one in value]
    if isinstance(value, Enum) and not isinstance(value, str):
        return value.name.lower()
    if isinstance(value, float) and value != value:  # noqa: PLR0124  # NaN, which JSON does not have
        return None
    return str(value) if isinstance(value, Path) else value


def rows_of(result: object) -> dict[str, str]:
    """Return the non-empty members of a result, and of dataclasses in it, as names and texts."""
    rows = dict[str, str]()
    for name, value in members(result):
        if value is None:
            continue
        label = _label(name)
        text = (_WORDS.get(name) or text_of)(value)
        if name == "units":
            rows |= {f"unit {unit.unit}": _unit(unit) for unit in value}
        elif name == "messages":
            rows |= {topic: f"{count(number)} messages" for topic, number in value.items()}
        elif is_dataclass(value) and name not in _WORDS:
            rows |= rows_of(value)
        elif text:
            rows[label] = text if name in _WORDS else f"{text}{_unit_of(name)}"
    return rows


def count(number: int) -> str:
    """Format a whole number in groups of three digits (ISO 80000-1, section 7.3.1)."""
    return f"{number:,}".replace(",", " ")


def size(number_of_bytes: int) -> str:
    """Format a file's size in MB (10^6 bytes), a small one in kB."""
    return (
        f"{number_of_bytes / 1e6:.1f} MB"
        if number_of_bytes >= _SMALL_BYTES
        else f"{number_of_bytes / 1e3:.1f} kB"
    )


def behind_text(times: "Sequence[FellBehind]") -> str:
    """Format how often, by how much, when first and why a stream fell behind."""
    if not times:
        return "never"
    often = "once" if len(times) == 1 else f"{count(len(times))} times"
    most = f"by {max(one.total_s for one in times):.2f} s" + (" at most" if len(times) > 1 else "")
    first = "first at" if len(times) > 1 else "at"
    causes = ", ".join(dict.fromkeys(one.cause for one in times[:3]))
    return f"{often}, {most}, {first} {times[0].at_s:.1f} s: {causes}"


def audit_text(found: "AuditFinding") -> str:
    """Format the result of an audit."""
    if found.exact:
        return "rounding to float32 only: by the scene's choice a pulse is one ray"
    if found.range_rmse_m is None:
        return f"not known: {found.pulses} pulses cast again had no return"
    low_m, high_m = found.range_rmse_low_m, found.range_rmse_high_m
    if low_m is None or high_m is None:
        sure = "interval not known from so few"
    elif high_m > _WIDEST * low_m:
        sure = "run too short for an interval"
    else:
        sure = f"95 %: {1e3 * low_m:.1f} to {1e3 * high_m:.1f} mm"
    shares = {"lost": found.lost, "invented": found.invented, "of another echo": found.other_echo}
    texts = ", ".join(f"{100 * (share or 0.0):.1f} % {name}" for name, share in shares.items())
    return f"RMSE {1e3 * found.range_rmse_m:.1f} mm before noise ({sure}), {texts}"


def members(result: object) -> Iterator[tuple[str, Any]]:
    """Yield name and value of the items of a mapping, or of the fields and properties of a dataclass."""
    if isinstance(result, Mapping):
        yield from ((str(name), value) for name, value in result.items())
        return
    kind: type = type(result)
    assert is_dataclass(result)
    yield from ((field.name, getattr(result, field.name)) for field in fields(result))
    for owner in kind.__mro__:
        yield from (
            (name, getattr(result, name)) for name, one in vars(owner).items() if isinstance(one, property)
        )


def _unit_of(name: str) -> str:
    return next((f" {unit}" for end, unit in _UNITS.items() if name.endswith(end)), "")


def _label(name: str) -> str:
    bare = next((name.removesuffix(end) for end in _UNITS if name.endswith(end)), name)
    return _LABELS.get(name) or (bare if "." in bare else bare.replace("_", " "))  # names of files stay


def text_of(value: object) -> str:
    """Format a value; empty for None and empty members."""
    if value is None or value is False or isinstance(value, str):
        return value or ""
    if value is True or isinstance(value, Enum):
        return "yes" if value is True else value.name.lower()
    if isinstance(value, int):
        return count(value)
    if isinstance(value, float):
        return f"{round(value, 3):.12g}"
    if is_dataclass(value) or isinstance(value, Mapping):
        pairs = ((name, text_of(one)) for name, one in members(value))
        return ", ".join(f"{_label(name)} {text}{_unit_of(name)}" for name, text in pairs if text)
    if isinstance(value, list | tuple):
        return (
            "; ".join(map(text_of, value))
            if value and is_dataclass(value[0])
            else ", ".join(map(text_of, value))
        )
    return str(value)


def _unit(unit: "UnitSent") -> str:
    sent = f"{count(unit.packets)} data, {count(unit.position_packets)} position"
    sent += "" if unit.returns is None else f", {count(unit.returns)} returns"
    turn = "" if unit.turn is None else f"; {_turn(unit.turn)}"
    return f"{unit.name}, ports {unit.data_port} and {unit.position_port}: {sent}{turn}"


def _turn(turn: "Turn") -> str:
    turns = round(turn.revolutions, 1)
    return (
        f"{turns:.12g} revolution{'' if turns == 1 else 's'} of "
        f"{count(round(turn.sequences_per_revolution))} firing "
        f"sequences, {turn.azimuth_step_deg:.4g} deg apart"
    )


def _lateness(late: "Lateness") -> str:
    median, p99, most = (
        f"{ns * 1e-3:.0f} us" if ns < 1e7 else f"{ns * 1e-9:.2f} s"
        for ns in (late.median_ns, late.p99_ns, late.max_ns)
    )
    return f"median {median}, 99 % within {p99}, at most {most}"


def _first(first: "FirstPacket") -> str:
    if first.sensor_ns is None:
        return ""
    late_ms = (first.host_ns - first.sensor_ns) * 1e-6
    return f"{late_ms:.3f} ms after its time by the sensor's clock, by this machine's"


def _outlet(sent: "OutletResult") -> str:
    row = f"{count(sent.messages)} to {sent.to}" + (
        f", {count(sent.dropped)} dropped" if sent.dropped else ""
    )
    if sent.line:
        line = sent.line.upper()
        row += (
            f"; no pulses, as it has no line {line}"
            if sent.pulses is None
            else f"; {count(sent.pulses)} on {line}"
        )
    return row + _away(sent.away)


def _receiver(gps_in: "GpsInResult") -> str:
    heard = gps_in.heard
    counts = (
        f"{count(heard.sentences)} sentences, {count(heard.pulses)} pulses, {count(heard.refused)} garbled"
    )
    return f"{counts} from {gps_in.port}; {gps_in.state.name.lower()}{_away(gps_in.away)}"


def _fit(fits: "Mapping[str, float] | Sequence[Mapping[str, float]]") -> str:
    each = [fits] if isinstance(fits, Mapping) else fits
    return "; ".join(
        f"{fit['rate_ppm']:+.3g} ppm, {fit['offset_s']:+.6f} s from the sensor's, packets late by "
        f"{fit['median_delay_ms']:.3g} ms in the median and {fit['most_delay_ms']:.3g} ms at most"
        + (f", in {fit['parts']:.0f} parts" if fit["parts"] > 1 else "")
        for fit in each
    )


def _away(times: "Sequence[Away]") -> str:
    total_s = sum(time.away_s for time in times)
    return f"; the device was away {count(len(times))} times, for {total_s:.1f} s" if times else ""


_WORDS: dict[str, Callable[[Any], str]] = {
    "audit": audit_text,
    "behind": behind_text,
    "bytes": size,
    "cut": lambda is_cut: "in the middle of a packet, which was left out" if is_cut else "",
    "delay_s": lambda late_s: f"late by {late_s:.2f} s at the end" if late_s else "",
    "first": _first,
    "fit": _fit,
    "gaps_s": lambda gaps_s: ", ".join(f"{gap_s:.0f} s" for gap_s in gaps_s),
    "gps_in": _receiver,
    "gps_out": _outlet,
    "imu_out": _outlet,
    "interrupted": lambda _: "",
    "keeps_up_with": ", or ".join,
    "lateness": _lateness,
    "moved_s": lambda by_s: f"by {by_s:+d} s into the present" if by_s else "",
    "real_time_factor": lambda factor: f"{factor:.2f} x real time",
    "skipped": lambda skipped: ", ".join(
        f"{count(number)} {kind} packets" for kind, number in skipped.items()
    ),
    "turn": _turn,
    "walk_share": lambda share: f"{100 * share:.0f} %",
}
"""Formatters of members that need more than a value with its unit."""
