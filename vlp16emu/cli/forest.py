"""`vlp16emu forest`: what stands along the path of a sensor."""

from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from vlp16emu.cli.arguments import AsJson, SceneName, Settings
from vlp16emu.cli.printer import (
    members,
    print_files,
    print_json,
    print_rows,
    print_table,
    rows_of,
    table_of,
    text_of,
    tree_of,
)
from vlp16emu.cli.start import compile_first
from vlp16emu.cli.terminal import Progress
from vlp16emu.errors import InputError
from vlp16emu.options import Option

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from vlp16emu.extras.sheets.summary import WorldSummary
    from vlp16emu.extras.sheets.survey import Survey
    from vlp16emu.scenario import Scenario


_SUFFIXES = {"--inventory": ".csv", "--stems": ".csv", "--ground": ".asc", "--glb": ".glb", "--picture": ".png"}


def forest(
    scene: SceneName,
    *,
    settings: Settings = None,
    radius_m: Annotated[
        float, Option("How far from the path things count, are drawn and go into the twin.", "M", ge=1, le=300)
    ] = 30.0,
    inventory: Annotated[Path | None, Option("Write all trees in the sensor's reach, one per line.", "OUT.csv")] = None,
    seen: Annotated[
        Path | None,
        Option(
            "With --inventory, for each tree the returns from its stem in a run with this truth"
            " (`record --truth DIR --truth-returns`), the share of the stem that has any, and the arc at breast height.",
            "DIR",
        ),
    ] = None,
    stems: Annotated[
        Path | None,
        Option(
            "Write the stems of those trees, and the branches of those within the radius, as circles along their axes,"
            " with radii, for QSM and taper.",
            "OUT.csv",
        ),
    ] = None,
    ground: Annotated[
        Path | None, Option("Write the true height of the ground as an ESRI ASCII grid of 0.25 m cells.", "OUT.asc")
    ] = None,
    glb: Annotated[Path | None, Option("Write a digital twin as glTF, its nodes named by labels.", "OUT.glb")] = None,
    picture: Annotated[Path | None, Option("Draw a plan and a section; needs the extra 'picture'.", "OUT.png")] = None,
    as_json: AsJson = False,
) -> None:
    """Report what stands along the path of the sensor.

    Trees by species, their pattern, the relief, and what lies on the ground, all within the radius of the
    path; of a hall, its things.
    """
    from vlp16emu.output import spare
    from vlp16emu.scenario import find, load
    from vlp16emu.scenario.find import named_files

    if seen and not inventory:
        raise InputError("--seen", "found no --inventory", "both")
    given = zip(_SUFFIXES, (inventory, stems, ground, glb, picture), strict=True)
    wanted = {name: path for name, path in given if path is not None}
    scenario = load(scene, settings or ())
    for name, path in wanted.items():  # before anything heavy
        spare([find(scene), *named_files(scenario)], path)
        if path.suffix != (suffix := _SUFFIXES[name]):
            raise InputError(f"{name} {path}", f"found suffix '{path.suffix}'", suffix)
    if picture is not None:
        from vlp16emu.extras.plots import check_matplotlib

        check_matplotlib()
    compile_first(scenario.world.kind)
    with Progress(0.0):
        summary = _surveyed(scene, scenario, radius_m, wanted, seen)
    if as_json:
        written = {name.removeprefix("--"): str(path) for name, path in wanted.items()}
        print_json({**tree_of(summary), "files": written})
        return
    _print(summary)
    print_files(wanted.values())


def _surveyed(
    scene: str, scenario: "Scenario", radius_m: float, wanted: "Mapping[str, Path]", truth: Path | None
) -> "WorldSummary":
    """Look at the world and write files, which are opened before anything heavy."""
    from vlp16emu.extras.sheets import files
    from vlp16emu.extras.sheets.summary import summary_of
    from vlp16emu.extras.sheets.survey import survey
    from vlp16emu.output import OutputFile

    with ExitStack() as stack:
        outputs = {name: stack.enter_context(OutputFile(path, where=f"{name} {path}")) for name, path in wanted.items()}
        seen = survey(scenario, radius_m)
        summary = summary_of(scene, scenario, seen)
        inventory = partial(files.write_inventory, truth=truth)
        writers: tuple[Callable[[OutputFile, Survey], None], ...]
        writers = inventory, files.write_stems, files.write_ground, files.write_twin
        for name, write in zip(_SUFFIXES, writers, strict=False):
            if name in outputs:
                write(outputs[name], seen)
        if "--picture" in outputs:
            title, subtitle = scenario.title, _subtitle(summary)
            files.write_picture(outputs["--picture"], seen, title=title, subtitle=subtitle)
    return summary


def _subtitle(summary: "WorldSummary") -> str:
    """Sum up a world in one line."""
    from vlp16emu.extras.sheets.summary import ForestSummary

    words = [f"{Path(summary.scene).stem}, seed {summary.seed}"]
    if summary.path.length_m:
        words.append(f"{summary.path.length_m:.0f} m of path")
    if isinstance(summary, ForestSummary):
        words.append(f"{summary.area_ha:.2f} ha within {summary.radius_m:g} m")
        if summary.trees:
            row = summary.trees[-1]
            words.append(f"{row.stems_per_ha:.0f} stems/ha, DBH {row.dbh_mean_cm:.0f} cm")
            words.append(f"{row.basal_area_m2_per_ha:.0f} m2/ha, leaf area index {row.leaf_area_index:.1f}")
    return "  |  ".join(words)


def _print(summary: "WorldSummary") -> None:
    figures = dict(members(summary))
    tables = {name: figures.pop(name, ()) for name in ("scene", "title", "trees", "things", "named")}
    print_rows(f"{summary.scene}: {summary.title}", rows_of(figures))
    if tables["trees"]:
        print_table(table_of(tables["trees"]))
    if tables["things"]:
        print_rows("on the ground", {kind: text_of(things) for kind, things in tables["things"].items()})
    if tables["named"]:
        print_rows("things", {one.name: text_of(one) for one in summary.named})
