"""What `vlp16emu stream` reports: at once where it falls behind, and at its end."""

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from vlp16emu.cli.audit import audit_row
from vlp16emu.cli.keeping_up import settings_that_keep_up
from vlp16emu.cli.light import light_rows
from vlp16emu.cli.output import count
from vlp16emu.cli.rotor import revolutions, turned

if TYPE_CHECKING:
    from vlp16emu.assembly import Unit
    from vlp16emu.scenario import Scenario
    from vlp16emu.sinks import FellBehind, Late, StreamReport, UdpResult, UdpSink
    from vlp16emu.types import PacketKind

__all__ = ["behind_line", "stream_rows", "stream_tree"]

_POLICY = {
    "pace": "the delay stays, at the sensor's own spacing (--late pace)",
    "skip": "late packets are dropped until the stream is at now (--late skip)",
}


def behind_line(behind: "FellBehind", scenario: "Scenario", late: "Late", speed: float) -> str:
    """Write the line that is printed when the stream falls behind."""
    line = (
        f"behind: {behind.behind_s:.3f} s late at {behind.at_s:.1f} s, as {_cause(behind)}; {_POLICY[late]}"
    )
    options = _options([behind], scenario, speed)
    return f"{line}; to keep up: {', or '.join(options)}" if options else line


def stream_tree(
    units: "Sequence[Unit]",
    sinks: "Sequence[UdpSink]",
    report: "StreamReport",
    left_out: "Counter[PacketKind]",
    scenario: "Scenario",
    speed: float,
) -> dict[str, Any]:
    """Put how the stream went into the types of JSON; ports are those of the first unit."""
    from vlp16emu.types import PacketKind

    lateness, skipped = report.lateness, report.skipped + left_out
    pairs = zip(units, sinks, strict=True)
    sent = [_unit(unit, sink.result, report.simulated_s) for unit, sink in pairs]
    return {
        "data_port": sent[0]["data_port"],
        "position_port": sent[0]["position_port"],
        "packets": sum(unit["packets"] for unit in sent),
        "position_packets": sum(unit["position_packets"] for unit in sent),
        "units": sent,
        "simulated_s": report.simulated_s,
        "wall_s": report.wall_s,
        "real_time_factor": report.real_time_factor,
        "late_median_us": lateness.median_ns * 1e-3,
        "late_p99_us": lateness.p99_ns * 1e-3,
        "late_max_us": lateness.max_ns * 1e-3,
        "fell_behind": len(report.behind),
        "most_behind_s": max((behind.total_s for behind in report.behind), default=0.0),
        "behind": [_behind(behind) for behind in report.behind],
        "delay_s": report.delay_s,
        "skipped_packets": skipped[PacketKind.DATA],
        "skipped_position_packets": skipped[PacketKind.POSITION],
        "keeps_up_with": _options(report.behind, scenario, speed),
        "interrupted": report.interrupted,
    }


def stream_rows(tree: dict[str, Any]) -> dict[str, str]:
    """Write the rows of the report."""
    rows = {
        **light_rows(tree),
        "data packets": count(tree["packets"]),
        "position packets": count(tree["position_packets"]),
        "simulated": f"{tree['simulated_s']:.1f} s in {tree['wall_s']:.1f} s",
        "revolutions": revolutions(tree["units"]),
        "lateness": (
            f"median {_time(tree['late_median_us'])}, 99 % within {_time(tree['late_p99_us'])}, "
            f"at most {_time(tree['late_max_us'])}"
        ),
        "fell behind": _times(tree["behind"], tree["most_behind_s"]),
    }
    if tree["delay_s"]:
        rows["delay"] = f"late by {tree['delay_s']:.2f} s since {tree['behind'][-1]['at_s']:.1f} s"
    if tree["skipped_packets"] or tree["skipped_position_packets"]:
        data, position = count(tree["skipped_packets"]), count(tree["skipped_position_packets"])
        rows["skipped"] = f"{data} data packets, {position} position packets"
    if tree["keeps_up_with"]:
        rows["to keep up"] = ", or ".join(tree["keeps_up_with"])
    return rows | audit_row(tree["audit"])


def _unit(unit: "Unit", sent: "UdpResult", simulated_s: float) -> dict[str, Any]:
    """Give what one unit sent to which ports, and how far it turned."""
    return {
        "unit": unit.number + 1,
        "data_port": unit.link.data_port,
        "position_port": unit.link.position_port,
        "packets": sent.data_packets,
        "position_packets": sent.position_packets,
    } | turned(unit.head, simulated_s)


def _behind(behind: "FellBehind") -> dict[str, Any]:
    """Put one time that the stream fell behind into the types of JSON."""
    return {
        "at_s": behind.at_s,
        "behind_s": behind.total_s,
        "engine": behind.engine,
        "engine_speed": behind.engine_speed if behind.engine else None,
        "cause": _cause(behind),
    }


def _cause(behind: "FellBehind") -> str:
    """Write why a stream fell behind."""
    if not behind.engine:
        return "the process stood still or got no core"
    if behind.engine_speed is None:
        return "the engine is too slow"
    return f"the engine computes {behind.engine_speed:.2f} x real time"


def _options(times: "Sequence[FellBehind]", scenario: "Scenario", speed: float) -> list[str]:
    """Options with which the engine keeps up, as slow as it was; none where it was not the cause."""
    speeds = [behind.engine_speed for behind in times if behind.engine and behind.engine_speed is not None]
    return settings_that_keep_up(scenario, min(speeds), speed) if speeds else []


def _times(times: list[dict[str, Any]], most_s: float) -> str:
    """Write how often, by how much, when first and why a stream fell behind."""
    if not times:
        return "never"
    often = "once" if len(times) == 1 else f"{count(len(times))} times"
    most = f"by {most_s:.2f} s" + (" at most" if len(times) > 1 else "")
    first = "first at" if len(times) > 1 else "at"
    causes = ", ".join(dict.fromkeys(behind["cause"] for behind in times[:3]))
    return f"{often}, {most}, {first} {times[0]['at_s']:.1f} s: {causes}"


def _time(us: float) -> str:
    """Write a lateness in the unit that suits it."""
    if us < 10_000:
        return f"{us:.0f} us"
    return f"{us * 1e-3:.0f} ms" if us < 1e6 else f"{us * 1e-6:.2f} s"
