"""Colours of points by label or measurement, and their legend."""

import colorsys
from collections.abc import Iterable, Mapping
from html import escape

import numpy as np

from vlp16emu.extras.colours import (
    PART_RGB,
    Rgb,
    colour_of_kind,
    colour_of_species,
    colours_of_plant,
    surface_colours,
)
from vlp16emu.types import F8, SURFACE, U1, AnyArray, Labels, PlantPart, Scan, Semantic
from vlp16emu.units import S_NS

Entries = Mapping[str, tuple[Rgb, ...]] | tuple[float, float, str] | None
"""Legend of a layer: colours by name, or limits of a scale with its name and unit; None for instances, which
have no names."""

_LABELLED = ("natural", "class", "part", "species", "instance")
MEASURED = ("range", "reflectivity", "ring", "time")
LAYERS = (*_LABELLED, *MEASURED, "range error")

_SCALE = np.array([(68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37)], np.float64)
"""Viridis at five values (matplotlib, `_cm_listed.py`)."""
_DIVERGING = np.array([(59, 76, 192), (150, 150, 150), (180, 4, 38)], np.float64)
"""Scale of values about 0: ends of coolwarm (K. Moreland, "Diverging color maps", ISVC 2009) about a grey
that is visible on white."""
_ERROR_CM = 6.0  # end of the scale of range errors: twice the +-3 cm of the data sheet
_KINDS = {
    Semantic.SHRUB: "Shrubs",
    Semantic.GROUND: "Ground",
    Semantic.GRASS: "Grass and herbs",
    Semantic.STONE: "Stones",
    Semantic.DEADWOOD: "Deadwood",
    Semantic.OTHER: "Other things",
}
"""Names of classes in natural colours; trees are named by species."""
_GOLDEN = 0.618034  # step of the hue between instances: consecutive numbers differ most
_STOPS = 9  # colours of a gradient
_DOT = "display:inline-block;width:0.8em;height:0.8em;margin-right:0.5em;border-radius:2px"


def layers_of_scan(scan: Scan) -> tuple[str, ...]:
    """Return the layers of a sweep, without those of labels for a capture without ground truth."""
    return MEASURED if scan.labels is None else LAYERS


def colours_of(scan: Scan, layer: str, species: Mapping[int, str]) -> tuple[U1, Entries]:
    """Return the colours (n, 3) of the points of a sweep in one of its layers, and the legend.

    `species` are the names of species by number.
    """
    if scan.labels is None or layer not in _LABELLED:
        values, scale = _values(scan, layer)
        low, high, _ = scale
        return colours_of_scale(values, low, high), scale
    if layer == "natural":
        surfaces = np.zeros(len(scan.labels.semantic), SURFACE)
        for name in ("semantic", "part", "species"):
            surfaces[name] = getattr(scan.labels, name)
        return surface_colours(surfaces, species), _natural_legend(scan.labels, species)
    labels: AnyArray = getattr(scan.labels, "semantic" if layer == "class" else layer)
    distinct, row = np.unique(labels, return_inverse=True)
    numbers: list[int] = distinct.tolist()
    legend: Entries = None
    if layer == "instance":
        colours = [_instance_rgb(number) for number in numbers]
    else:
        entries = _names_and_colours(layer, species)
        unnamed = ("", colour_of_kind("ground"))
        colours = [entries.get(number, unnamed)[1] for number in numbers]
        in_sight = (entries[number] for number in numbers if number in entries)
        legend = {_title(name): (colour,) for name, colour in in_sight}
    return np.array(colours, np.uint8).reshape(-1, 3)[row.ravel()], legend


def _title(name: str) -> str:
    return name.replace("_", " ").capitalize()


def _natural_legend(labels: Labels, species: Mapping[int, str]) -> dict[str, tuple[Rgb, ...]]:
    """Return the colours of leaves and stems by species, then those of other classes in sight."""
    is_tree = labels.semantic == Semantic.TREE
    names = [species.get(number, "") for number in np.unique(labels.species[is_tree]).tolist()]
    kinds = [kind for kind in _KINDS if (labels.semantic == kind).any()]
    legend = {_title(name) or "Tree": colours_of_plant(name) for name in names}
    return legend | {_KINDS[kind]: (colour_of_kind(kind.name.lower()),) for kind in kinds}


def _instance_rgb(instance: int) -> Rgb:
    """Return a colour unlike those of neighbouring numbers; grey for 0, which is no instance."""
    if not instance:
        return 140, 140, 140
    red, green, blue = colorsys.hsv_to_rgb(instance * _GOLDEN % 1.0, 0.75, 0.95 - 0.25 * (instance % 2))
    return round(255 * red), round(255 * green), round(255 * blue)


def colours_of_scale(values: F8, low: float, high: float) -> U1:
    """Return the colours (n, 3) of values (n,) on a scale, a diverging one if it begins below 0."""
    scale = _DIVERGING if low < 0 else _SCALE
    position = np.clip((values - low) / max(high - low, 1e-9), 0.0, 1.0) * (len(scale) - 1)
    return np.column_stack([np.interp(position, range(len(scale)), band) for band in scale.T]).astype(
        np.uint8
    )


def _names_and_colours(layer: str, species: Mapping[int, str]) -> dict[int, tuple[str, Rgb]]:
    """Return name and colour of the classes, parts or species by number."""
    if layer == "class":
        names = {kind.value: kind.name.lower() for kind in Semantic}
        entries = {number: (name, colour_of_kind(name)) for number, name in names.items()}
        return entries | {Semantic.TREE.value: ("tree", colour_of_species("european_beech"))}
    if layer == "part":
        names = {part.value: part.name.lower() for part in PlantPart}
        return {number: (name, PART_RGB[name]) for number, name in names.items()}
    return {number: (name, colour_of_species(name)) for number, name in species.items()}


def _values(scan: Scan, layer: str) -> tuple[F8, tuple[float, float, str]]:
    """Return values (n,) of a layer, and the limits of its scale with its name and unit."""
    if layer == "range error" and scan.labels is not None:
        error_cm = 100.0 * (scan.distance_m.astype(np.float64) - scan.labels.range_m)
        return error_cm, (-_ERROR_CM, _ERROR_CM, "range error, cm")
    since_s = (scan.t_ns - scan.start_ns) / S_NS
    # Few ranges exceed 40 m in a forest; reflectivities above 100 come from retroreflectors.
    values: dict[str, tuple[AnyArray, float, str]] = {
        "range": (scan.distance_m, 40.0, "range, m"),
        "reflectivity": (scan.reflectivity, 100.0, "reflectivity, code"),
        "ring": (scan.ring, float(scan.ring.max(initial=1)), "ring, 0 lowest"),
        "time": (since_s, float(since_s.max(initial=1e-3)), "time in the sweep, s"),
    }
    array, limit, label = values[layer]
    return np.asarray(array, np.float64), (0.0, limit, label)


def legend_of(entries: Entries) -> str:
    """Return the legend of a layer as HTML."""
    if entries is None:
        return html_box(["each plant or thing in its own colour, the rest in grey"])
    if isinstance(entries, Mapping):
        lines = []
        for name, colours in entries.items():
            dots = (f'<span style="{_DOT};background:rgb{rgb}"></span>' for rgb in colours)
            lines.append(f"{''.join(dots)}{escape(name)}")
        return html_box(lines)
    low, high, label = entries
    colours = colours_of_scale(np.linspace(low, high, _STOPS), low, high).tolist()
    stops = ",".join(f"rgb{tuple(rgb)}" for rgb in colours)
    bar = f'<div style="height:0.8em;border-radius:2px;background:linear-gradient(to right,{stops})"></div>'
    ends = f"<span>{low:g}</span><span>{escape(label)}</span><span>{high:.3g}</span>"
    return html_box([f'{bar}<div style="display:flex;justify-content:space-between">{ends}</div>'])


def html_box(lines: Iterable[str]) -> str:
    """Return lines of HTML in a box of the panel."""
    return f'<div style="margin:0.3em 1em;font-size:0.85em;line-height:1.5">{"<br>".join(lines)}</div>'
