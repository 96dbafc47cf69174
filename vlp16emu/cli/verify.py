"""`vlp16emu verify`: whether a real sensor could have sent it."""

from typing import TYPE_CHECKING, Any

import typer

from vlp16emu.cli.arguments import AsJson, CaptureFile
from vlp16emu.cli.terminal import count, print_json, print_rows

if TYPE_CHECKING:
    from vlp16emu.extras.verify import Verification


def verify(file: CaptureFile, *, as_json: AsJson = False) -> None:
    """Check a capture against the rules of VLP-16 traffic.

    Names each broken rule with the number of the packet, as Wireshark counts. Where several units have
    sent, each is checked by itself. Notes are what units before firmware 3 and their recorders did. Exits with 0 where
    no rule is broken, whatever the notes, else with 1.
    """
    from vlp16emu.errors import CaptureError
    from vlp16emu.extras.verify import verify_capture, verify_units
    from vlp16emu.packets import units_in

    if file.is_fifo():  # its units are looked for first
        raise CaptureError(str(file), "a pipe", "a file, which can be read twice")
    units = units_in(file)
    if len(units) < 2:
        results = {str(file): verify_capture(file)}
        tree = {"file": str(file)} | _tree(results[str(file)])
    else:
        results = dict(zip(map(str, units), verify_units(file, units), strict=True))
        trees = [{"unit": unit} | _tree(result) for unit, result in results.items()]
        tree = {"file": str(file), "clean": all(tree["clean"] for tree in trees), "units": trees}
    if as_json:
        print_json(tree)
    else:
        for whose, result in results.items():
            _print(whose, result)
    if not tree["clean"]:
        raise typer.Exit(1)


def _tree(result: "Verification") -> dict[str, Any]:
    """Write findings, counts and the verdict in the types of JSON."""
    return {
        "clean": result.is_clean,
        "packets": result.data_packets,
        "position_packets": result.position_packets,
        "other_frames": result.other_frames,
        "lost_packets": result.lost_packets,
        "void_sentences": result.void_sentences,
        "duration_s": result.span_s,
        "rpm": result.rpm,
        "cut": result.is_cut,
        "broken_rules": dict(result.counts),
        "notes": dict(result.notes),
        "findings": [
            {"rule": f.rule, "level": f.level, "packet": f.packet, "found": f.found, "expected": f.expected}
            for f in result.findings
        ],
    }


def _print(whose: str, result: "Verification") -> None:
    """Print findings, counts and the verdict for people."""
    for finding in result.findings:
        print(finding)
    rows = {
        "packets": f"{count(result.data_packets)} data, {count(result.position_packets)} position",
        "time": f"{result.span_s:.3f} s",
    }
    if result.rpm is not None:
        rows["rotor"] = f"{result.rpm:.1f} rpm"
    if result.void_sentences:
        rows["without a fix"] = f"{count(result.void_sentences)} sentences of status V"
    if result.other_frames:
        rows["passed over"] = f"{count(result.other_frames)} other frames"
    if result.is_cut:
        rows["end"] = "in the middle of a packet, which was left out"
    rows |= {f"broken: {rule}": count(number) for rule, number in result.counts.items()}
    rows |= {f"note: {rule}": count(number) for rule, number in result.notes.items()}
    print_rows(f"{whose}: {'clean' if result.is_clean else 'not what a VLP-16 sends'}", rows)
