"""`vlp16emu forest`: what stands along the way of a sensor."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from vlp16emu.cli.arguments import AsJson, SceneName, Settings, checked
from vlp16emu.cli.output import count, print_json, print_rows, size
from vlp16emu.errors import InputError, OutputError

if TYPE_CHECKING:
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
    ),
]
InventoryFile = Annotated[
    Path | None,
    typer.Option("--inventory", metavar="OUT.csv", help="Write all trees in the sensor's reach, one per line."),
]
TwinFile = Annotated[
    Path | None,
    typer.Option("--glb", metavar="OUT.glb", help="Write a digital twin as glTF, its nodes named by labels."),
]
PictureFile = Annotated[
    Path | None, typer.Option("--picture", metavar="OUT.png", help="Draw a plan and a section.")
]


def forest(
    scene: SceneName,
    *,
    settings: Settings = None,
    radius: Radius = 30.0,
    inventory: InventoryFile = None,
    glb: TwinFile = None,
    picture: PictureFile = None,
    as_json: AsJson = False,
) -> None:
    """Tell what stands along the way of the sensor.

    Stems by species, pattern, relief, and what lies on the ground; of a hall, its things. Figures are those of
    the surroundings of the way within the radius.
    """
    for option, path in (("--inventory", inventory), ("--glb", glb), ("--picture", picture)):
        if path is not None:
            _check_output(option, path)
    if picture is not None:
        from vlp16emu.report.forest import check_matplotlib

        check_matplotlib()
    from vlp16emu.cli.survey import survey
    from vlp16emu.scenario import load

    scenario = load(scene, settings or [])
    seen = survey(scenario, radius)
    report = _report(scene, scenario, seen)
    files = {}
    if inventory is not None:
        files["inventory"] = _write_inventory(inventory, seen)
    if glb is not None:
        files["glb"] = _write_twin(glb, seen)
    if picture is not None:
        files["picture"] = _write_picture(picture, scenario, seen)
    if as_json:
        print_json(report | {"files": files})
        return
    _print(report)
    _print(report, scenario.title)
    for written in files.values():
        print(f"wrote {written['file']}: {written['what']}")


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
    """Put the figures into one tree."""
    import numpy as np

    from vlp16emu.report.forest import CELL_M, cells_near, clark_evans, relief, stand_rows
    from vlp16emu.world import Hall

    way_xy_m = seen.way_m[:, :2]
    tree: dict[str, Any] = {"scene": scene, "title": scenario.title, "seed": scenario.seed}
    tree["way_m"] = float(np.hypot(*np.diff(way_xy_m, axis=0).T).sum())
    if isinstance(seen.world, Hall):
        return tree | {"world": "hall", "things": _hall_things(seen.world, seen)}
    cells = cells_near(way_xy_m, seen.radius_m)
    ground_m2 = len(cells) * CELL_M**2
    near = seen.near
    xy_m, all_xy_m = (np.column_stack([trees["x_m"], trees["y_m"]]) for trees in (near, seen.trees))
    rows = stand_rows(seen.inventory(near), seen.species, ground_m2)
    return tree | {
        "world": "forest",
        "radius_m": seen.radius_m,
        "area_ha": ground_m2 / 10_000,
        "relief": asdict(relief(cells, seen.world.height_m)),
        "trees": [asdict(row) for row in rows],
        "clark_evans": clark_evans(xy_m, all_xy_m, ground_m2) if len(near) > 1 else None,
        "things": _kinds(seen, ground_m2),
        "trees_in_reach": len(seen.trees),
    }


def _kinds(seen: "Survey", ground_m2: float) -> dict[str, dict[str, Any]]:
    """Count everything else by kind, with its species and the range of its sizes."""
    kinds: dict[str, dict[str, Any]] = {}
    for kind in sorted({thing.kind for thing in seen.things}):
        things = [thing for thing in seen.things if thing.kind == kind]
        measure, axis = _MEASURES.get(kind, ("length", 0))
        sizes_m = [thing.size_m[axis] for thing in things]
        names = Counter(seen.species[thing.species] for thing in things if thing.species)
        kinds[kind] = {
            "count": len(things),
            "per_ha": len(things) / ground_m2 * 10_000,
            "measure": measure,
            "least_m": min(sizes_m),
            "greatest_m": max(sizes_m),
            "species": dict(names.most_common()),
        }
    return kinds
