"""Verbs that check and compare: verify, compare, fit and score."""

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vlp16emu.cli.arguments import AsJson, CaptureFile, PlotFile, UnitName
from vlp16emu.cli.printer import (
    members,
    print_file,
    print_json,
    print_line,
    print_rows,
    quantity,
    report_of,
    rows_of,
)
from vlp16emu.cli.terminal import Progress
from vlp16emu.errors import CaptureError, InputError
from vlp16emu.extras.options import ScoreInputs
from vlp16emu.run.options import Option
from vlp16emu.trees import Tree

if TYPE_CHECKING:
    from collections.abc import Sequence

    from vlp16emu.extras.compare import Compared
    from vlp16emu.extras.verify.run import Verification


def verify(
    file: Annotated[
        Path,
        Option(
            "Capture with VLP-16 packets: pcap or pcapng, also .gz, .bz2, .xz, .zst, or a bag with "
            "/velodyne_packets; with --for a bag of any sensor.",
            name="FILE.pcap",
        ),
    ],
    *,
    unit: UnitName = None,
    slam: Annotated[
        str | None,
        Option(
            "Check a bag (.mcap, .bag or a folder of ROS 2) for a SLAM program instead, such as "
            "fast-lio2 or kiss-icp, or all of them: what it would read wrong, and which of its "
            "parameters to set.",
            "NAME",
            "--for",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Check a capture against the rules of VLP-16 traffic, or a bag for SLAM programs.

    Names each broken rule with the packet number, as in Wireshark. Several units are checked separately,
    unless --unit names one. Notes are deviations that settings, receivers, old firmware or recorders explain.
    The exit code is 0 if no rule is broken, else 1; notes do not change it.
    """
    if slam is not None:
        _verify_bag(file, unit, slam, as_json=as_json)
        return
    from vlp16emu.captures import Survey
    from vlp16emu.extras.verify.run import verify_units

    if file.is_fifo():  # a pipe cannot be read twice, and the units are searched first
        raise CaptureError(str(file), "a pipe", "a file, which can be read twice")
    with Progress(100.0, "reading", unit="%") as bar:
        survey = Survey(file, progress=partial(bar.show_share, "finding sensors"))
        units = survey.units if unit is None else [survey.chosen(unit, where="--unit")]
        results = verify_units(file, units or [None], progress=partial(bar.show_share, "checking"))
    titles = [str(file)] if len(results) == 1 else list(map(str, units))
    if as_json:
        _print_verification_json(file, titles, results)
    else:
        for title, result in zip(titles, results, strict=True):
            _print_verification(title, result)
    if not all(result.is_clean for result in results):
        raise typer.Exit(1)


def _print_verification_json(file: Path, titles: list[str], results: "Sequence[Verification]") -> None:
    """Print the results of one capture; those of several units are in a list."""
    trees = [_members_of(result) for result in results]
    if len(trees) == 1:
        print_json({"file": file} | trees[0])
        return
    units = [{"unit": title} | tree for title, tree in zip(titles, trees, strict=True)]
    print_json({"file": file, "clean": all(tree["clean"] for tree in trees), "units": units})


def _verify_bag(file: Path, unit: str | None, slam: str, *, as_json: bool) -> None:
    from vlp16emu.extras.slam.fitness import fitness

    if unit is not None:
        raise InputError("--unit", f"found {unit}", "no unit with --for")
    result = fitness(file, slam)
    if as_json:
        programs = {
            name: {
                "fit": not result.findings_of(name),
                "configurations": result.configurations[name],
                "findings": result.findings_of(name),
            }
            for name in result.programs
        }
        print_json({"file": file, "fit": not result.findings, "bag": result.summary, "programs": programs})
    else:
        for finding in result.findings:
            print_line(str(finding))
        verdicts = {}
        for name in result.programs:
            number = len(result.findings_of(name))
            files = result.configurations[name]
            verdict = quantity(number, "finding") if number else "fit"
            verdicts[name] = f"{verdict}, with {', '.join(files)}" if files else verdict
        summary = "fit"
        if result.findings:
            summary = "not fit for all" if slam == "all" else "not fit"
        print_rows(f"{file}: {summary}", verdicts)
    if result.findings:
        raise typer.Exit(1)


def _members_of(result: "Verification") -> Tree:
    return {
        "clean": result.is_clean,
        "model": result.model,
        "packets": result.data_packets,
        "position_packets": result.position_packets,
        "other_frames": result.other_frames,
        "lost_packets": result.lost_packets,
        "void_sentences": result.void_sentences,
        "duration_s": result.span_s,
        "rpm": result.rpm,
        "cut": result.is_cut,
        "damage": result.damage,
        "broken_rules": result.counts,
        "notes": result.notes,
        "findings": result.findings,
    }


def _print_verification(title: str, result: "Verification") -> None:
    for finding in result.findings:
        print_line(str(finding))
    from vlp16emu.models import model_table

    listed = ("clean", "model", "broken_rules", "notes", "findings")
    tree = {name: value for name, value in _members_of(result).items() if name not in listed and value}
    rows = rows_of(tree)
    rows |= {f"broken: {rule}": str(number) for rule, number in result.counts.items()}
    rows |= {f"note: {rule}": str(number) for rule, number in result.notes.items()}
    words = model_table(result.model)["title"]
    article = "an" if words[0] in "AEFHILMNORSX" else "a"  # read letter by letter
    print_rows(f"{title}: {'clean' if result.is_clean else f'not what {article} {words} sends'}", rows)


def compare(
    file: CaptureFile,
    other: Annotated[Path, Option("The capture to compare it with.", name="OTHER.pcap")],
    *,
    plot: PlotFile = None,
    as_json: AsJson = False,
) -> None:
    """Compare two captures, emulated or real, by the statistics that distinguish units.

    Each difference is given as a multiple of the spread of real VLP-16 units, also for other models; real
    units differ by at most 1. At most a minute of each capture is read. Scatter of ranges and of reflectivity
    also depends on the scene: compare walls with walls, foliage with foliage.
    """
    from vlp16emu.extras.compare import compare_statistics, histograms_of, read_sequences
    from vlp16emu.extras.plot.sheet import plotting

    with plotting(plot, [file, other]) as draw:
        sequences = read_sequences(file), read_sequences(other)
        rows = compare_statistics(*sequences)
        differing = [row.name for row in rows if row.apart]
        tree = {
            "files": [file, other],
            "apart": differing,
            "statistics": [row._asdict() for row in rows],
            "histograms": histograms_of(*sequences),
        }
        report = report_of("compare", tree)
        draw(report)
    if as_json:
        print_json(report)
        return
    head = {"": "     first     second   distance"}
    print_rows(f"{file} and {other}", head | {row.text: _difference_text(row) for row in rows})
    print(f"{len(differing)} of {len(rows)} statistics differ by more than real units do")
    if unlike_both := sum(all(row.unlike) for row in rows):
        print(
            f"{unlike_both} are like no real unit in both captures (*): the real ones show rooms and "
            "streets, not foliage"
        )
    print_file(plot)


def _difference_text(row: "Compared") -> str:
    """Format a statistic, with a note if the captures differ, or if only one of them is like real units."""
    notes = ["differs"] if row.apart else []
    first_is_unlike, second_is_unlike = row.unlike
    if first_is_unlike != second_is_unlike:
        notes.append(f"{'first' if first_is_unlike else 'second'} like no real unit")
    mark = "*" if all(row.unlike) else " "
    return f"{row.first:10.4g} {row.second:10.4g} {row.distance:10.2f}{mark} {', '.join(notes)}".rstrip()


def fit(
    file: CaptureFile,
    *,
    out: Annotated[Path | None, Option("Write them to a file instead.", "UNIT.toml")] = None,
) -> None:
    """Print the [noise] and [sensor] tables of the unit that made a capture, for a scene file.

    The beat of its ranges has its phase at the capture's first pulse. At most a minute is read.
    """
    from vlp16emu.extras.compare import fit_settings, read_sequences
    from vlp16emu.output import STDOUT, OutputFile, spare

    if out is not None:
        spare((file,), out)
    tables = []
    for name, table in fit_settings(read_sequences(file)).items():
        lines = [f"{key} = {json.dumps(value)}\n" for key, value in table.items()]  # also the syntax of TOML
        tables.append(f"[{name}]\n{''.join(lines)}")
    text = "\n".join(tables)
    if out is None or out == STDOUT:
        print(text, end="")
        return
    with OutputFile(out, where=f"--out {out}") as output, output.writing() as toml_file:
        toml_file.write(text.encode())
    print_line(f"wrote {out}")


def score(
    inputs: ScoreInputs,
    *,
    require: Annotated[
        list[str] | None, Option("A threshold; exit code 1 if it is missed. Repeatable.", "SCORE<NUMBER")
    ] = None,
    out: Annotated[
        Path | None,
        Option(
            "Also write the scores as a page with pictures, to hand on; needs the extra 'plot'.", "FILE.html"
        ),
    ] = None,
    plot: PlotFile = None,
    as_json: AsJson = False,
) -> None:
    """Score a pipeline's trajectory, map, labels and stems against the truth of a run.

    Scores each result that is given, from files of any tool. The exit code is 1 if a threshold is missed.
    """
    from vlp16emu.extras.plot.page import page_writing
    from vlp16emu.extras.plot.sheet import plotting
    from vlp16emu.extras.score.card import limits_of, make_card

    limits = limits_of(require or ())
    files = [path for path in vars(inputs).values() if isinstance(path, Path)]
    if plot is not None and not (inputs.trajectory or inputs.stems):
        raise InputError(f"--plot {plot}", "found nothing to draw", "--trajectory or --stems")
    with plotting(plot, files) as draw, page_writing(out, files) as write:
        card = make_card(inputs)
        missed = card.failed_limits(limits)
        report = report_of("score", dict(members(card)) | {"missed": missed})
        draw(report)
        write(report)
    if as_json:
        print_json(report)
    else:
        print_rows("scores", card.texts())
        print_rows("measured", card.notes)
        for line in missed:
            print_line(f"missed: {line}")
        print_file(plot)
        print_file(out)
    if missed:
        raise typer.Exit(1)


def plot(
    report: Annotated[Path, Option("Report that a command has printed with --json.", name="REPORT.json")],
    out: Annotated[Path, Option("File to write: .png, .svg or .pdf.", name="OUT")],
) -> None:
    """Draw a report of accuracy, compare, forest, plan or score that was printed with --json.

    The picture equals that of their option --plot. Needs the extra 'plot'.
    """
    from vlp16emu.extras.plot.sheet import plotting, read_report

    with plotting(out, [report], where="OUT") as draw:
        draw(read_report(report))
    print_file(out)
