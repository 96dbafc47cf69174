"""The stand under the hand: a panel for what grows, gizmos for the user's own meshes and the plot, and growing it anew."""

import math
from collections.abc import Callable
from copy import deepcopy
from functools import partial
from typing import Any, get_args

import numpy as np
import viser

from vlp16emu.errors import InputError
from vlp16emu.report.forest.survey import Survey
from vlp16emu.scenario import Scenario
from vlp16emu.scenario.presets import presets
from vlp16emu.viewer.draft import Course, Draft
from vlp16emu.viewer.editor import FARTHEST_M, Editor
from vlp16emu.world import Forest, Hall, Plot
from vlp16emu.world.plants.flora import flora, known
from vlp16emu.world.plants.settings import Season

_AS_IS = "as in the scene"
_RAISED_M = 1.2
"""Of the gizmos of meshes and plot, over those of way points."""
_PLOT = -1, -1
"""In place of the numbers of a mesh and its place: all that is in map coordinates."""
Place = dict[str, Any]


def mix_text(rows: list[dict[str, Any]]) -> str:
    """Write the species of a stand and their shares, as `mix_of` reads them."""
    return ", ".join(f"{row['species']} {row['share']:g}" for row in rows)


def mix_of(text: str, rows: list[dict[str, Any]], species_file: str | None) -> list[dict[str, Any]]:
    """Read species and their shares, which are made to sum to 1; those that are new have the mean sizes of the others.

    Parameters
    ----------
    text : `silver_birch 0.6, norway_spruce 0.4`
    rows : `species` of the scene so far

    Raises
    ------
    InputError
        where a species is not known, or the text is no list of names and shares
    """
    named = [part.strip().rpartition(" ") for part in str(text).split(",") if part.strip()]
    try:
        shares = [float(share) for _, _, share in named]
    except ValueError:
        shares = []
    if not shares or min(shares) <= 0 or not math.isfinite(sum(shares)):
        raise InputError(
            "species, shares", f"found {text!r:.80}", "such as silver_birch 0.6, norway_spruce 0.4"
        )
    plants = known([name for name, _, _ in named], flora(species_file).trees, "species")
    of = {row["species"]: row for row in rows}
    mean = {key: round(float(np.mean([row[key] for row in rows])), 1) for key in ("dbh_cm", "height_m")}
    return [
        {**mean, **of.get(plant.name, {}), "species": plant.name, "share": round(share / sum(shares), 6)}
        for plant, share in zip(plants, shares, strict=True)
    ]


class Planter:
    """Panel and gizmos of the stand; what they change is a key of `[world]`.

    Parameters
    ----------
    grow : grows a scene, shows it, and gives what stands there
    """

    def __init__(
        self,
        server: viser.ViserServer,
        draft: Draft,
        editor: Editor,
        world: Forest | Plot | Hall,
        grow: Callable[[Scenario], Survey],
    ) -> None:
        self._server, self._draft, self._editor = server, draft, editor
        self._grow, self._world = grow, world
        self._gizmos = dict[tuple[int, int], viser.TransformControlsHandle]()
        self._mix_shown = ""
        with server.gui.add_folder("Stand"):
            self._panel()
        editor.follow(self._show)

    def _panel(self) -> None:
        """Lay out the controls that the kind of world has."""
        gui, world = self._server.gui, self._world
        if isinstance(world, Forest):
            names = (_AS_IS, *presets())
            self._preset = gui.add_dropdown("preset", names, initial_value=_AS_IS)
            self._on(self._preset, lambda now, name: now.preset(None if name == _AS_IS else str(name)))
            self._density = gui.add_number("stems per ha", world.stems_per_ha, min=0.0, step=50.0)
            self._on(
                self._density, lambda now, n: now.planted(stems_per_ha=float(n), basal_area_m2_per_ha=None)
            )
            self._mix = gui.add_text(
                "species, shares", "", hint="such as silver_birch 0.6, norway_spruce 0.4"
            )
        if isinstance(world, Forest | Plot):
            self._season = gui.add_dropdown("season", get_args(Season), initial_value=world.season)
            self._on(self._season, lambda now, name: now.planted(season=str(name)))
        if world.meshes:
            number = gui.add_number("mesh", 1, min=1, max=len(world.meshes), step=1)
            for label, change in (("add a place", _with_place), ("remove its last place", _without_place)):
                self._on(gui.add_button(label), partial(self._replaced, change, number), "on_click")
        button = gui.add_button("grow it", hint="with what has been changed here")
        button.on_click(lambda _: self._editor.ask(self._mixed))
        button.on_click(lambda _: self._editor.ask(self._regrow))
        self._text = gui.add_markdown("")

    def _on(self, control: Any, change: Callable[[Course, Any], Course], event: str = "on_update") -> None:
        """Make another course of the present one when somebody does something to a control."""

        def done(by: viser.GuiEvent[Any]) -> None:
            if by.client is not None:
                self._editor.ask(lambda: change(self._draft.course, control.value))

        getattr(control, event)(done)

    def _replaced(
        self,
        change: Callable[[list[Place]], list[Place]],
        number: viser.GuiNumberHandle[int],
        course: Course,
        _: object,
    ) -> Course:
        meshes = deepcopy(self._draft.world["meshes"])
        mesh = meshes[min(max(int(number.value), 1), len(meshes)) - 1]
        mesh["places"] = change(mesh["places"])
        return course.planted(meshes=meshes)

    def _mixed(self) -> Course | None:
        """Take the species from the panel: when it is to be grown, as a name that is being written is none yet."""
        world = self._draft.scenario(self._draft.course).world
        if not isinstance(world, Forest) or self._mix.value == self._mix_shown:
            return None
        rows = [row.model_dump() for row in world.species]
        return self._draft.course.planted(species=mix_of(self._mix.value, rows, world.species_file))

    def _regrow(self) -> None:
        scenario = self._draft.scenario(self._draft.course)
        self._text.content = "growing"
        self._draft.grown(scenario, self._grow(scenario))

    def _show(self, course: Course) -> None:
        """Put controls and gizmos where things are, and say whether the stand is that of the course."""
        self._show_controls(course)
        places = [
            (i, j, place)
            for i, mesh in enumerate(self._draft.world.get("meshes", ()))
            for j, place in enumerate(mesh["places"])
        ]
        for gone in self._gizmos.keys() - {(i, j) for i, j, _ in places} - {_PLOT}:
            self._gizmos.pop(gone).remove()
        for i, j, place in places:
            self._put((i, j), place["x_m"], place["y_m"], place.get("yaw_deg", 0.0))
        if isinstance(self._world, Plot):
            first_m, now_m = self._world.origin_m, self._draft.world.get("origin_m", self._world.origin_m)
            self._put(_PLOT, first_m[0] - now_m[0], first_m[1] - now_m[1], 0.0)
        changed = ", ".join(course.world)
        self._text.content = (
            "" if self._draft.is_grown else f"**not grown yet**: {changed or 'the stand of the file'}"
        )

    def _show_controls(self, course: Course) -> None:
        try:
            world = self._draft.scenario(course).world
        except InputError:
            return
        if isinstance(world, Forest):
            self._preset.value = course.world.get("preset") or _AS_IS
            self._density.value = world.stems_per_ha
            mix = mix_text([row.model_dump() for row in world.species])
            if mix != self._mix_shown:  # else somebody may be writing another one
                self._mix.value = self._mix_shown = mix
        if isinstance(world, Forest | Plot):
            self._season.value = world.season

    def _put(self, which: tuple[int, int], x_m: float, y_m: float, yaw_deg: float) -> None:
        gizmo = self._gizmos.get(which) or self._gizmo(which)
        gizmo.position = (x_m, y_m, self._draft.height_m(x_m, y_m) + _RAISED_M)
        half = math.radians(yaw_deg) / 2
        gizmo.wxyz = (math.cos(half), 0.0, 0.0, math.sin(half))

    def _gizmo(self, which: tuple[int, int]) -> viser.TransformControlsHandle:
        """Make the gizmo of a place, which slides level and turns about the vertical, or of the plot, which slides."""
        name = "/plot" if which == _PLOT else f"/places/{which[0] + 1}_{which[1] + 1}"
        gizmo = self._server.scene.add_transform_controls(
            name,
            scale=2.2,
            line_width=4.0,
            active_axes=(True, True, False),
            disable_rotations=which == _PLOT,
            depth_test=False,
        )
        label = "plot" if which == _PLOT else f"mesh {which[0] + 1}"
        self._server.scene.add_label(f"{name}/name", label)
        self._gizmos[which] = gizmo
        self._editor.on_drop(gizmo, partial(self._dropped, which))
        return gizmo

    def _dropped(self, which: tuple[int, int]) -> Course | None:
        gizmo, course = self._gizmos[which], self._draft.course
        x_m, y_m = (round(float(gizmo.position[axis]), 3) for axis in (0, 1))
        if not (abs(x_m) <= FARTHEST_M and abs(y_m) <= FARTHEST_M):
            return None
        if which == _PLOT:
            assert isinstance(self._world, Plot)
            first_m = self._world.origin_m
            return course.planted(origin_m=[first_m[0] - x_m, first_m[1] - y_m, first_m[2]])
        w, _, _, z = map(float, gizmo.wxyz)
        meshes = deepcopy(self._draft.world["meshes"])
        place = meshes[which[0]]["places"][which[1]]
        yaw_deg = round(math.remainder(math.degrees(2 * math.atan2(z, w)), 360.0), 1)
        place |= {"x_m": x_m, "y_m": y_m} | ({"yaw_deg": yaw_deg} if yaw_deg or "yaw_deg" in place else {})
        return course.planted(meshes=meshes)


def _with_place(places: list[Place]) -> list[Place]:
    """Add a place two metres east of the last one."""
    return [*places, {**places[-1], "x_m": places[-1]["x_m"] + 2.0}]


def _without_place(places: list[Place]) -> list[Place]:
    """Remove the last place; one is left at least."""
    return places[:-1] or places
