"""`vlp16emu verify`: whether a real sensor could have sent it."""

from typing import TYPE_CHECKING

import typer

from vlp16emu.cli.arguments import AsJson, CaptureFile
from vlp16emu.cli.output import count, print_json, print_rows

if TYPE_CHECKING:
    from vlp16emu.report import Verification

__all__ = ["verify"]


def verify(file: CaptureFile, *, as_json: AsJson = False) -> None:
    """Check a capture against the rules of VLP-16 traffic.

    Names each broken rule with the number of the packet, as Wireshark counts. Exits with 0 where no rule
    is broken, else with 1.
    """
    from vlp16emu.report import verify_capture

    result = verify_capture(file)
    if as_json:
        findings = [
            {"rule": f.rule, "packet": f.packet, "found": f.found, "expected": f.expected}
            for f in result.findings
        ]
        tree = {
            "file": str(file),
            "clean": result.is_clean,
            "packets": result.data_packets,
            "position_packets": result.position_packets,
            "other_frames": result.other_frames,
            "lost_packets": result.lost_packets,
            "duration_s": result.span_s,
            "rpm": result.rpm,
            "cut": result.is_cut,
            "broken_rules": dict(result.counts),
            "findings": findings,
        }
        print_json(tree)
    else:
        _print(str(file), result)
    if not result.is_clean:
        raise typer.Exit(1)


def _print(file: str, result: "Verification") -> None:
    """Print findings, counts and the verdict for people."""
    for finding in result.findings:
        print(finding)
    rows = {
        "packets": f"{count(result.data_packets)} data, {count(result.position_packets)} position",
        "time": f"{result.span_s:.3f} s",
    }
    if result.rpm is not None:
        rows["rotor"] = f"{result.rpm:.1f} rpm"
    if result.other_frames:
        rows["passed over"] = f"{count(result.other_frames)} other frames"
    if result.is_cut:
        rows["end"] = "in the middle of a packet, which was left out"
    rows |= {f"broken: {rule}": count(number) for rule, number in result.counts.items()}
    print_rows(f"{file}: {'clean' if result.is_clean else 'not what a VLP-16 sends'}", rows)
