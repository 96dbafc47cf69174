"""`vlp16emu verify`: whether a real sensor could have sent it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from vlp16emu.cli.arguments import AsJson, UnitName
from vlp16emu.cli.printer import print_json, print_rows, rows_of
from vlp16emu.errors import CaptureError, InputError
from vlp16emu.options import Option

if TYPE_CHECKING:
    from vlp16emu.extras.verify import Verification


def verify(
    file: Annotated[
        Path,
        Option(
            "Capture with VLP-16 packets: pcap or pcapng, also .gz, .bz2, .xz, .zst; with --for a bag of any sensor.",
            name="FILE.pcap",
        ),
    ],
    *,
    unit: UnitName = None,
    slam: Annotated[
        str | None,
        Option(
            "Check a bag (.mcap, .bag or a folder of ROS 2) for a SLAM program instead, such as fast-lio2 or kiss-icp, or all of "
            "them: what it would read wrong, and which of its parameters to set.",
            "NAME",
            "--for",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Check a capture against the rules of VLP-16 traffic, or a bag for SLAM programs.

    Names each broken rule with the number of the packet, as Wireshark counts. Each of several units is checked
    by itself, unless --unit names one. Notes are what settings, receivers, old firmware or recorders account for. Exits with 0 if no rule is
    broken, whatever the notes, else with 1.
    """
    if slam is not None:
        _verify_bag(file, unit, slam, as_json=as_json)
        return
    if file.suffix.lower() in (".mcap", ".bag") or (file / "metadata.yaml").is_file():
        raise InputError(str(file), "a bag", "a capture, or --for with the name of a SLAM program, or all")
    from vlp16emu.extras.verify import verify_units
    from vlp16emu.packets import chosen_unit, units_in

    if file.is_fifo():  # its units are looked for first
        raise CaptureError(str(file), "a pipe", "a file, which can be read twice")
    units = units_in(file) if unit is None else [chosen_unit(file, unit, where="--unit")]
    if len(units) < 2:
        results = {str(file): verify_units(file, units or [None])[0]}
        tree = {"file": file} | _tree(results[str(file)])
    else:
        results = dict(zip(map(str, units), verify_units(file, units), strict=True))
        trees = [{"unit": unit} | _tree(result) for unit, result in results.items()]
        tree = {"file": file, "clean": all(tree["clean"] for tree in trees), "units": trees}
    if as_json:
        print_json(tree)
    else:
        for whose, result in results.items():
            _print(whose, result)
    if not tree["clean"]:
        raise typer.Exit(1)


def _verify_bag(file: Path, unit: str | None, slam: str, *, as_json: bool) -> None:
    """Print why a bag is not fit for programs, a line each."""
    from vlp16emu.extras.slam import fitness

    if unit is not None:
        raise InputError("--unit", f"found {unit}", "no unit with --for")
    result = fitness(file, slam)
    if as_json:
        programs = {name: {"fit": not result.of(name), "findings": result.of(name)} for name in result.programs}
        print_json({"file": file, "fit": not result.findings, "bag": result.summary, "programs": programs})
    else:
        for finding in result.findings:
            print(finding)
        counts = {name: len(result.of(name)) for name in result.programs}
        verdicts = {name: f"{n} finding{'s' * (n > 1)}" if n else "fit" for name, n in counts.items()}
        print_rows(
            f"{file}: {'fit' if not result.findings else 'not fit for all' if slam == 'all' else 'not fit'}", verdicts
        )
    if result.findings:
        raise typer.Exit(1)


def _tree(result: "Verification") -> dict[str, Any]:
    """Return findings, counts and the verdict."""
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
        "broken_rules": result.counts,
        "notes": result.notes,
        "findings": result.findings,
    }


def _print(whose: str, result: "Verification") -> None:
    for finding in result.findings:
        print(finding)
    tree = _tree(result)
    counts = tree.pop("broken_rules"), tree.pop("notes")
    rows = rows_of({name: value for name, value in tree.items() if name not in ("clean", "findings") and value})
    for what, numbers in zip(("broken", "note"), counts, strict=True):
        rows |= {f"{what}: {rule}": str(number) for rule, number in numbers.items()}
    print_rows(f"{whose}: {'clean' if result.is_clean else 'not what a VLP-16 sends'}", rows)
