"""`vlp16emu forest`: what stands along the way of a sensor."""

from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from vlp16emu.cli.arguments import AsJson, SceneName, Settings, checked
from vlp16emu.cli.output import count, print_json, print_rows, size
from vlp16emu.errors import InputError, OutputError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from vlp16emu.cli.survey import Survey
    from vlp16emu.scenario import Scenario

__all__ = ["forest"]

Radius = Annotated[
    float,
    typer.Option(
        "--radius",
        metavar="M",
        parser=checked("--radius", float, lambda m: 1 <= m <= 300, "a number from 1 to 300"),
        help="How far from the way things count, are drawn and go into the twin.",
        show_default="30",
    ),
]
InventoryFile = Annotated[
    Path | None,
    typer.Option(
        "--inventory", metavar="OUT.csv", help="Write all trees in the sensor's reach, one per line."
    ),
]
GroundFile = Annotated[
    Path | None,
    typer.Option(
        "--ground",
        metavar="OUT.asc",
        help="Write the true height of the ground as an ESRI ASCII grid of 0.25 m cells.",
    ),
]
TwinFile = Annotated[
    Path | None,
    typer.Option("--glb", metavar="OUT.glb", help="Write a digital twin as glTF, its nodes named by labels."),
]
PictureFile = Annotated[
    Path | None,
    typer.Option(
        "--picture", metavar="OUT.png", help="Draw a plan and a section; needs the extra 'picture'."
    ),
]

_SUFFIXES = {"--inventory": ".csv", "--ground": ".asc", "--glb": ".glb", "--picture": ".png"}

_MEASURES = {
    "sapling": ("height", 2),
    "shrub": ("height", 2),
    "stone": ("length", 0),
    "log": ("length", 0),
    "stump": ("diameter", 0),
    "tuft": ("height", 2),
}
"""What is told of the size of a kind, and along which axis it lies."""


def forest(
    scene: SceneName,
    *,
    settings: Settings = None,
    radius: Radius = 30.0,
    inventory: InventoryFile = None,
    ground: GroundFile = None,
    glb: TwinFile = None,
    picture: PictureFile = None,
    as_json: AsJson = False,
) -> None:
    """Tell what stands along the way of the sensor.

    Trees by species, their pattern, the relief, and what lies on the ground, all within the radius of the
    way; of a hall, its things.
    """
    from vlp16emu.scenario import load

    outputs = {"--inventory": inventory, "--ground": ground, "--glb": glb, "--picture": picture}
    scenario = load(scene, settings or ())
    _spare(scene, scenario, outputs.values())
    wanted = {option: path for option, path in outputs.items() if path is not None}
    for option, path in wanted.items():
        _check_output(option, path)
    if picture is not None:
        from vlp16emu.report.forest import check_matplotlib

        check_matplotlib()
    from vlp16emu.cli.forest_files import write_ground, write_inventory, write_picture, write_twin
    from vlp16emu.cli.survey import survey

    seen = survey(scenario, radius)
    report = _report(scene, scenario, seen)
    if inventory is not None:
        write_inventory(inventory, seen)
    if ground is not None:
        write_ground(ground, seen)
    if glb is not None:
        write_twin(glb, seen)
    if picture is not None:
        write_picture(picture, seen, title=scenario.title, subtitle=_subtitle(report))
    report["files"] = {option.removeprefix("--"): str(path) for option, path in wanted.items()}
    if as_json:
        print_json(report)
        return
    _print_report(report)
    for path in wanted.values():
        print(f"wrote {path}, {size(path.stat().st_size)}")


def _spare(scene: str, scenario: "Scenario", outputs: "Iterable[Path | None]") -> None:
    """Refuse outputs that are the scene's own file, or one that it names.

    Raises
    ------
    OutputError
        where one is
    """
    from vlp16emu.assembly.files import named_files
    from vlp16emu.errors import spare
    from vlp16emu.scenario import find

    inputs = [find(scene), *named_files(scenario)]
    for output in outputs:
        if output is not None:
            spare(inputs, output)


def _check_output(option: str, path: Path) -> None:
    """Refuse a file of the wrong kind or in a place that cannot be written, before anything heavy.

    Raises
    ------
    InputError
        where the suffix is another than the option's
    OutputError
        where the file cannot be opened for writing
    """
    suffix = _SUFFIXES[option]
    if path.suffix != suffix:
        raise InputError(f"{option} {path}", f"found suffix '{path.suffix}'", suffix)
    try:
        path.open("ab").close()
    except OSError as error:
        raise OutputError(f"{option} {path}", str(error.strerror), "a file that can be written") from error


def _report(scene: str, scenario: "Scenario", seen: "Survey") -> dict[str, Any]:
    """Put what is known into one tree."""
    import numpy as np

    from vlp16emu.report.forest import CELL_M, cells_near, clark_evans, relief, stand_rows

    way_xy_m = seen.way_m[:, :2]
    tree: dict[str, Any] = {"scene": scene, "title": scenario.title, "seed": scenario.seed}
    ends_m = {"start_m": seen.way_m[0].tolist(), "end_m": seen.way_m[-1].tolist()}
    length_m = float(np.hypot(*np.diff(way_xy_m, axis=0).T).sum())
    tree |= {"world": scenario.world.kind, "way": {"length_m": length_m, **ends_m}}
    tree |= {"radius_m": seen.radius_m, "named": _named(seen)}
    if seen.hall is not None:
        return tree
    cells = cells_near(way_xy_m, seen.radius_m)
    ground_m2 = len(cells) * CELL_M**2
    xy_m, all_xy_m = (np.column_stack([trees["x_m"], trees["y_m"]]) for trees in (seen.near, seen.trees))
    rows = stand_rows(seen.inventory(seen.near), seen.species, ground_m2)
    return tree | {
        "area_ha": ground_m2 / 10_000,
        "relief": asdict(relief(cells, seen.height_m)),
        "trees": [asdict(row) for row in rows],
        "clark_evans": clark_evans(xy_m, all_xy_m, ground_m2) if len(xy_m) > 1 else None,
        "things": _kinds(seen, ground_m2),
        "trees_in_reach": len(seen.trees),
    }


def _named(seen: "Survey") -> list[dict[str, Any]]:
    """Places and sizes of things that have a name: those of a hall, and the user's own."""
    return [
        {
            "name": seen.names[thing.instance],
            "kind": thing.kind,
            "instance": thing.instance,
            "place_m": thing.place_m.tolist(),
            "size_m": thing.size_m,
        }
        for thing in seen.things
        if thing.instance in seen.names
    ]


def _kinds(seen: "Survey", ground_m2: float) -> dict[str, dict[str, Any]]:
    """Count things without names by kind, with their species and the range of their sizes."""
    kinds: dict[str, dict[str, Any]] = {}
    nameless = [thing for thing in seen.things if thing.instance not in seen.names]
    for kind in sorted({thing.kind for thing in nameless}):
        things = [thing for thing in nameless if thing.kind == kind]
        measure, axis = _MEASURES[kind]
        sizes_m = [thing.size_m[axis] for thing in things]
        kinds[kind] = {
            "count": len(things),
            "per_ha": len(things) / ground_m2 * 10_000,
            "measure": measure,
            "least_m": min(sizes_m),
            "greatest_m": max(sizes_m),
            "species": dict(
                Counter(seen.species[one.species] for one in things if one.species).most_common()
            ),
        }
    return kinds


def _subtitle(report: dict[str, Any]) -> str:
    """Sum up a report in one line."""
    words = [f"{Path(report['scene']).stem}, seed {report['seed']}"]
    if length_m := report["way"]["length_m"]:
        words.append(f"{length_m:.0f} m of way")
    if report["world"] != "hall":
        words.append(f"{report['area_ha']:.2f} ha within {report['radius_m']:g} m")
        if report["trees"]:
            row = report["trees"][-1]
            words.append(f"{row['stems_per_ha']:.0f} stems/ha, DBH {row['dbh_mean_cm']:.0f} cm")
            words.append(
                f"{row['basal_area_m2_per_ha']:.0f} m2/ha, leaf area index {row['leaf_area_index']:.1f}"
            )
    return "  |  ".join(words)


def _print_report(report: dict[str, Any]) -> None:
    """Print the report for people."""
    about = {"seed": str(report["seed"])}
    if length_m := report["way"]["length_m"]:
        about["way"] = f"{length_m:.0f} m"
    if report["world"] != "hall":
        ground = report["relief"]
        about |= {
            "looked at": f"{report['area_ha']:.2f} ha within {report['radius_m']:g} m of the way",
            "ground": f"from {ground['low_m']:.1f} m to {ground['high_m']:.1f} m, slope"
            f" {ground['slope_mean_deg']:.0f} deg on average, {ground['slope_max_deg']:.0f} deg at most",
        }
        if report["clark_evans"] is not None:
            about["Clark-Evans index"] = (
                f"{report['clark_evans']:.2f} (1 random, less in clumps, more if regular)"
            )
        about["trees in reach"] = count(report["trees_in_reach"])
    print_rows(f"{report['scene']}: {report['title']}", about)
    if report["world"] != "hall":
        _print_trees(report["trees"])
        if report["things"]:
            print_rows("on the ground", {kind: _told(of) for kind, of in report["things"].items()})
    if report["named"]:
        print_rows("things", {one["name"]: _placed(one) for one in report["named"]})


def _print_trees(rows: list[dict[str, Any]]) -> None:
    """Print the table of species."""
    columns = ("trees", "stems", "per ha", "DBH, cm", "height, m", "m2/ha", "m3/ha", "LAI")
    cells = [
        (
            row["species"].replace("_", " "),
            count(row["stems"]),
            f"{row['stems_per_ha']:.0f}",
            f"{row['dbh_mean_cm']:.1f} ({row['dbh_min_cm']:.1f} to {row['dbh_max_cm']:.1f})",
            f"{row['height_mean_m']:.1f} (to {row['height_max_m']:.1f})",
            f"{row['basal_area_m2_per_ha']:.1f}",
            f"{row['stem_m3_per_ha']:.0f}",
            f"{row['leaf_area_index']:.2f}",
        )
        for row in rows
    ]
    widths = [max(map(len, column)) for column in zip(columns, *cells, strict=True)]
    for line in (columns, *cells):
        first, *others = (text.rjust(width) for text, width in zip(line, widths, strict=True))
        print("  ".join([line[0].ljust(len(first)), *others]))


def _told(kind: dict[str, Any]) -> str:
    """Tell number, density, sizes and species of one kind."""
    text = f"{count(kind['count'])}, {kind['per_ha']:.0f} per ha, {kind['measure']}"
    text += f" {kind['least_m']:.2f} m to {kind['greatest_m']:.2f} m"
    names = ", ".join(f"{name.replace('_', ' ')} {number}" for name, number in kind["species"].items())
    return f"{text}: {names}" if names else text


def _placed(thing: dict[str, Any]) -> str:
    """Tell where a named thing is and how large."""
    place = ", ".join(f"{value:.2f}" for value in thing["place_m"])
    extent = " x ".join(f"{value:.2f}" for value in thing["size_m"])
    return f"at ({place}) m, {extent} m"
