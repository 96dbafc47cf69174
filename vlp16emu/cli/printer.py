"""Results on standard output: as JSON, or as rows for people."""

import json
import math
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
from vlp16emu.units import count_text

if TYPE_CHECKING:  # help prints none of them
    from vlp16emu.extras.accuracy.audit import AuditFinding
    from vlp16emu.extras.bench.gps_in import GpsInResult
    from vlp16emu.extras.bench.outlets import Away, OutletResult
    from vlp16emu.run.report import Turn, UnitSent
    from vlp16emu.run.stream import FirstPacket
    from vlp16emu.sinks import FellBehind
    from vlp16emu.sinks.pacing import Lateness

INTERRUPTED = 130
"""Exit code after Ctrl-C: 128 + SIGINT, as shells count (POSIX.1-2024, Shell, section 2.8.2)."""
_UNIT_SYMBOLS = {
    "_per_s": "per s",
    "_s": "s",
    "_us": "us",
    "_ns": "ns",
    "_m": "m",
    "_deg": "deg",
    "_hz": "Hz",
    "per_ha": "per ha",
    "_ha": "ha",
}
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
_NUMBER_LIST = re.compile(r"\[\n([^][{}\"]*)\]")
"""A list of numbers as `json` indents it; text never holds a line feed."""
_SMALL_BYTES = 100_000
_WIDEST_RATIO = 10.0  # of the ends of an interval; beyond it not even the order of magnitude is known


def finish(result: object, title: str | None = None, *, as_json: bool) -> None:
    """Print a result, a dataclass or mapping, as rows under a title or as JSON.

    Without a title, the first line says that the first member was written. The program exits with 130 if the
    result was interrupted.
    """
    tree = dict(members(result))
    is_interrupted = bool(tree.get("interrupted"))
    if as_json:
        print_json(result)
    elif title is None:
        file = tree.pop(next(iter(tree)))
        print_rows(f"{'interrupted, kept' if is_interrupted else 'wrote'} {file}", rows_of(tree))
    else:
        print_rows(title, rows_of(tree))
    if is_interrupted:
        raise typer.Exit(INTERRUPTED)


def print_json(result: object) -> None:
    """Print one JSON object, each list of numbers on one line."""
    text = json.dumps(tree_of(result), indent=2)
    print(_NUMBER_LIST.sub(lambda match: f"[{' '.join(match[1].split())}]", text))


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
    head = [name.replace("_", " ") for name, _ in members(rows[0])]
    return [head, *([_cell(value) for _, value in members(row)] for row in rows)]


def _cell(value: str | float) -> str:
    return value if isinstance(value, str) else f"{value:.4g}"


def tree_of(value: object) -> object:
    """Return a result in JSON types; NaN becomes None, and a negative zero zero.

    The properties of a dataclass stand beside its fields.
    """
    if is_dataclass(value) or isinstance(value, Mapping):
        return {name: tree_of(item) for name, item in members(value)}
    if isinstance(value, list | tuple | frozenset):
        return [tree_of(item) for item in value]
    if isinstance(value, Enum) and not isinstance(value, str):
        return value.name.lower()
    if isinstance(value, float):
        return None if math.isnan(value) else value + 0.0  # JSON has no NaN; -0.0 + 0.0 is 0.0
    return str(value) if isinstance(value, Path) else value


def rows_of(result: object) -> dict[str, str]:
    """Return the non-empty members of a result, and of dataclasses in it, as names and texts."""
    rows = dict[str, str]()
    for name, value in members(result):
        if value is None:
            continue
        if name == "units":
            rows |= {f"unit {unit.unit}": _unit_text(unit) for unit in value}
        elif name == "messages":
            rows |= {topic: f"{count_text(number)} messages" for topic, number in value.items()}
        elif is_dataclass(value) and name not in _FORMATTERS:
            rows |= rows_of(value)
        elif text := _member_text(name, value):
            rows[_label(name)] = text
    return rows


def _member_text(name: str, value: object) -> str:
    """Format a member with its unit; empty for an empty member."""
    if name in _FORMATTERS:
        return _FORMATTERS[name](value)
    text = text_of(value)
    return f"{text}{_unit_suffix(name)}" if text else ""


def quantity(number: float, noun: str) -> str:
    """Format a number of things: `1 core`, `2 cores`, `99.5 revolutions`."""
    text = count_text(number) if isinstance(number, int) else f"{number:.12g}"
    return f"{text} {noun}{'' if number == 1 else 's'}"


def size(number_of_bytes: int) -> str:
    """Format a file's size in MB (10^6 bytes), a small one in kB."""
    if number_of_bytes < _SMALL_BYTES:
        return f"{number_of_bytes / 1e3:.1f} kB"
    return f"{number_of_bytes / 1e6:.1f} MB"


def behind_text(times: "Sequence[FellBehind]") -> str:
    """Format how often, by how much, when first and why a stream fell behind."""
    if not times:
        return "never"
    total_s = max(time.total_s for time in times)
    first_s = times[0].at_s
    causes = ", ".join(dict.fromkeys(time.cause for time in times[:3]))
    if len(times) == 1:
        return f"once, by {total_s:.2f} s, at {first_s:.1f} s: {causes}"
    return f"{count_text(len(times))} times, by {total_s:.2f} s at most, first at {first_s:.1f} s: {causes}"


def audit_text(audit: "AuditFinding") -> str:
    """Format the result of an audit."""
    if audit.exact:
        return "rounding to float32 only: by the scene's choice a pulse is one ray"
    if audit.range_rmse_m is None:
        return f"not known: {audit.pulses} pulses cast again had no return"
    low_m, high_m = audit.range_rmse_low_m, audit.range_rmse_high_m
    if low_m is None or high_m is None:
        interval = "interval not known from so few"
    elif high_m > _WIDEST_RATIO * low_m:
        interval = "run too short for an interval"
    else:
        interval = f"95 %: {1e3 * low_m:.1f} to {1e3 * high_m:.1f} mm"
    shares = {"lost": audit.lost, "invented": audit.invented, "of another echo": audit.other_echo}
    texts = ", ".join(f"{100 * (share or 0.0):.1f} % {name}" for name, share in shares.items())
    return f"RMSE {1e3 * audit.range_rmse_m:.1f} mm before noise ({interval}), {texts}"


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
            (name, getattr(result, name))
            for name, attribute in vars(owner).items()
            if isinstance(attribute, property)
        )


def text_of(value: object) -> str:
    """Format a value; empty for None and empty members."""
    if value is None or value is False or isinstance(value, str):
        return value or ""
    if value is True:
        return "yes"
    if isinstance(value, Enum):
        return value.name.lower()
    if isinstance(value, int):
        return count_text(value)
    if isinstance(value, float):
        return f"{round(value, 3):z.12g}"
    if is_dataclass(value) or isinstance(value, Mapping):
        pairs = ((name, text_of(member)) for name, member in members(value))
        return ", ".join(f"{_label(name)} {text}{_unit_suffix(name)}" for name, text in pairs if text)
    if isinstance(value, list | tuple):
        separator = "; " if value and is_dataclass(value[0]) else ", "
        return separator.join(map(text_of, value))
    return str(value)


def _unit_suffix(name: str) -> str:
    return next((f" {symbol}" for end, symbol in _UNIT_SYMBOLS.items() if name.endswith(end)), "")


def _label(name: str) -> str:
    """Return the label of a member: its name in words, without unit; names of files stay."""
    if name in _LABELS:
        return _LABELS[name]
    bare_name = next((name.removesuffix(end) for end in _UNIT_SYMBOLS if name.endswith(end)), name)
    return bare_name if "." in bare_name else bare_name.replace("_", " ")


def _unit_text(unit: "UnitSent") -> str:
    """Format the traffic of one sensor, and the turn of its rotor if it is known."""
    text = f"{unit.name}, ports {unit.data_port} and {unit.position_port}: "
    text += f"{count_text(unit.packets)} data, {count_text(unit.position_packets)} position"
    if unit.returns is not None:
        text += f", {count_text(unit.returns)} returns"
    return text if unit.turn is None else f"{text}; {_turn_text(unit.turn)}"


def _turn_text(turn: "Turn") -> str:
    revolutions = quantity(round(turn.revolutions, 1), "revolution")
    sequences = count_text(round(turn.sequences_per_revolution))
    return f"{revolutions} of {sequences} firing sequences, {turn.azimuth_step_deg:.4g} deg apart"


def _lateness_text(lateness: "Lateness") -> str:
    times_ns = (lateness.median_ns, lateness.p99_ns, lateness.max_ns)
    median, p99, maximum = (
        f"{t_ns * 1e-3:.0f} us" if t_ns < 1e7 else f"{t_ns * 1e-9:.2f} s" for t_ns in times_ns
    )
    return f"median {median}, 99 % within {p99}, at most {maximum}"


def _first_text(first: "FirstPacket") -> str:
    if first.sensor_ns is None:
        return ""
    late_ms = (first.host_ns - first.sensor_ns) * 1e-6
    return f"{late_ms:.3f} ms after its time by the sensor's clock, by this machine's"


def _outlet_text(result: "OutletResult") -> str:
    text = f"{count_text(result.messages)} to {result.to}"
    if result.dropped:
        text += f", {count_text(result.dropped)} dropped"
    if result.line:
        line = result.line.upper()
        if result.pulses is None:
            text += f"; no pulses, as it has no line {line}"
        else:
            text += f"; {count_text(result.pulses)} on {line}"
    return text + _away_text(result.away)


def _receiver_text(gps_in: "GpsInResult") -> str:
    line = gps_in.heard
    counts = {"sentences": line.sentences, "pulses": line.pulses, "garbled": line.refused}
    text = ", ".join(f"{count_text(number)} {name}" for name, number in counts.items())
    return f"{text} from {gps_in.port}; {gps_in.state.name.lower()}{_away_text(gps_in.away)}"


def _fit_text(fits: "Mapping[str, float] | Sequence[Mapping[str, float]]") -> str:
    """Format the line of a host's clock over the sensor's, or that of each sensor."""
    texts = []
    for fit in [fits] if isinstance(fits, Mapping) else fits:
        text = (
            f"{fit['rate_ppm']:+z.3g} ppm, {fit['offset_s']:+z.6f} s from the sensor's, packets late by "
            f"{fit['median_delay_ms']:.3g} ms in the median and {fit['most_delay_ms']:.3g} ms at most"
        )
        texts.append(f"{text}, in {fit['parts']:.0f} parts" if fit["parts"] > 1 else text)
    return "; ".join(texts)


def _away_text(times: "Sequence[Away]") -> str:
    if not times:
        return ""
    total_s = sum(time.away_s for time in times)
    return f"; the device was away {count_text(len(times))} times, for {total_s:.1f} s"


def _skipped_text(skipped: Mapping[str, int]) -> str:
    return ", ".join(f"{count_text(number)} {kind} packets" for kind, number in skipped.items())


_FORMATTERS: dict[str, Callable[[Any], str]] = {
    "audit": audit_text,
    "behind": behind_text,
    "bytes": size,
    "cut": lambda is_cut: "in the middle of a packet, which was left out" if is_cut else "",
    "damage": lambda parts: f"left out in {quantity(len(parts), 'place')}" if parts else "",
    "delay_s": lambda late_s: f"late by {late_s:.2f} s at the end" if late_s else "",
    "first": _first_text,
    "fit": _fit_text,
    "gaps_s": lambda gaps_s: ", ".join(f"{gap_s:.0f} s" for gap_s in gaps_s),
    "gps_in": _receiver_text,
    "gps_out": _outlet_text,
    "imu_out": _outlet_text,
    "interrupted": lambda _: "",
    "keeps_up_with": ", or ".join,
    "lateness": _lateness_text,
    "moved_s": lambda by_s: f"by {by_s:+d} s into the present" if by_s else "",
    "real_time_factor": lambda factor: f"{factor:.2f} x real time",
    "skipped": _skipped_text,
    "turn": _turn_text,
    "walk_share": lambda share: f"{100 * share:.0f} %",
}
"""Formatters of members that need more than a value with its unit."""
