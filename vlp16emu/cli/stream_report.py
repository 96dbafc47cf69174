"""What `vlp16emu stream` reports: at once where it falls behind, and at its end."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from vlp16emu.cli.output import audit_rows, count, light_rows, revolutions

if TYPE_CHECKING:
    from vlp16emu.scenario import Scenario
    from vlp16emu.sinks import FellBehind
    from vlp16emu.streaming import Behind, Streamed

__all__ = ["behind_line", "stream_rows"]

_POLICY = {
    "pace": "the delay stays, at the sensor's own spacing (--late pace)",
    "skip": "late packets are dropped until the stream is at now (--late skip)",
}


def behind_line(behind: "FellBehind", scenario: "Scenario", late: str, speed: float) -> str:
    """Write the line that is printed when the stream falls behind."""
    from vlp16emu.streaming import cause_of, options_for

    line = (
        f"behind: {behind.behind_s:.3f} s late at {behind.at_s:.1f} s, as {cause_of(behind)}; {_POLICY[late]}"
    )
    options = options_for([behind], scenario, speed)
    return f"{line}; to keep up: {', or '.join(options)}" if options else line


def stream_rows(streamed: "Streamed") -> dict[str, str]:
    """Write the rows of the report."""
    rows = {
        **light_rows(streamed.beam, streamed.noise, streamed.weather),
        "data packets": count(streamed.packets),
        "position packets": count(streamed.position_packets),
        "simulated": f"{streamed.simulated_s:.1f} s in {streamed.wall_s:.1f} s",
        "revolutions": revolutions([unit.turn for unit in streamed.units]),
        "lateness": (
            f"median {_time(streamed.late_median_us)}, 99 % within {_time(streamed.late_p99_us)}, "
            f"at most {_time(streamed.late_max_us)}"
        ),
        "fell behind": _times(streamed.behind, streamed.most_behind_s),
    }
    if streamed.delay_s:
        rows["delay"] = f"late by {streamed.delay_s:.2f} s since {streamed.behind[-1].at_s:.1f} s"
    if streamed.skipped_packets or streamed.skipped_position_packets:
        data, position = count(streamed.skipped_packets), count(streamed.skipped_position_packets)
        rows["skipped"] = f"{data} data packets, {position} position packets"
    if streamed.keeps_up_with:
        rows["to keep up"] = ", or ".join(streamed.keeps_up_with)
    return rows | audit_rows(streamed.audit)


def _times(times: "Sequence[Behind]", most_s: float) -> str:
    """Write how often, by how much, when first and why a stream fell behind."""
    if not times:
        return "never"
    often = "once" if len(times) == 1 else f"{count(len(times))} times"
    most = f"by {most_s:.2f} s" + (" at most" if len(times) > 1 else "")
    first = "first at" if len(times) > 1 else "at"
    causes = ", ".join(dict.fromkeys(behind.cause for behind in times[:3]))
    return f"{often}, {most}, {first} {times[0].at_s:.1f} s: {causes}"


def _time(us: float) -> str:
    """Write a lateness in the unit that suits it."""
    if us < 10_000:
        return f"{us:.0f} us"
    return f"{us * 1e-3:.0f} ms" if us < 1e6 else f"{us * 1e-6:.2f} s"
