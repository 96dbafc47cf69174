"""Common style of plots and of pictures of points: light on dark, as in the viewer; and colours that pictures and twins share.

Colours are what people expect of a species, not what 903 nm would show.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.resources import files
from importlib.util import find_spec
from types import MappingProxyType
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import MissingExtraError
from vlp16emu.settings import toml
from vlp16emu.types import U1, PlantPart, Semantic

if TYPE_CHECKING:
    from matplotlib.figure import Figure


Rgb = tuple[int, int, int]

_TABLES = toml(files("vlp16emu.extras").joinpath("palette.toml").read_text("utf-8"))
_PLANTS: dict[str, tuple[Rgb, Rgb]] = {
    name: (tuple(leaf), tuple(bark)) for name, (leaf, bark) in _TABLES["plants"].items()
}
_KIND: dict[str, Rgb] = {name: tuple(rgb) for name, rgb in _TABLES["kinds"].items()}
PART_RGB: dict[str, Rgb] = {name: tuple(rgb) for name, rgb in _TABLES["parts"].items()}


def colour_of_species(name: str) -> Rgb:
    """Colour of a species' foliage; of a species that a user has added, a plain green."""
    return _PLANTS.get(name, _PLANTS[""])[0]


def colour_of_kind(kind: str) -> Rgb:
    """Colour of a kind of thing, or of a semantic class in small letters."""
    return _KIND.get(kind, _KIND["other"])


def surface_colours(surfaces: NDArray[np.void], species: Mapping[int, str]) -> U1:
    """Colours (m, 3) of a table of surfaces (m,) `SURFACE`, by the names of species by number."""
    looks = np.column_stack([surfaces[name].astype(np.int64) for name in ("semantic", "part", "species")])
    different, which = np.unique(looks, axis=0, return_inverse=True)

    def colour(kind: Semantic, part: int, plant: str) -> Rgb:
        if kind not in (Semantic.TREE, Semantic.SHRUB):
            return colour_of_kind(kind.name.lower())
        return _PLANTS.get(plant, _PLANTS[""])[part != PlantPart.LEAF]

    colours = [colour(Semantic(s), p, species.get(n, "")) for s, p, n in different.tolist()]
    return np.array(colours, np.uint8).reshape(-1, 3)[which.ravel()]


BACK, INK, SOFT, _EDGE = "#0e1218", "#d7dbe0", "#8a94a3", "#3a4452"
"""Colours of the background, text, secondary text, and frames."""
CYCLE = (
    "#5aa9e6", "#f2a541", "#74c476", "#e0605e", "#b58bd6", "#c9a27e", "#e58bc0", "#9aa4b0", "#d6cf5a", "#4fc3c7"
)  # fmt: skip
"""Colours of lines and marks, in order."""
_STYLE: Mapping[Any, Any] = MappingProxyType(
    dict.fromkeys(("figure.facecolor", "savefig.facecolor", "axes.facecolor", "legend.facecolor"), BACK)
    | dict.fromkeys(("axes.edgecolor", "grid.color", "legend.edgecolor"), _EDGE)
    | dict.fromkeys(("axes.labelcolor", "axes.titlecolor", "legend.labelcolor"), INK)
    | dict.fromkeys(("text.color", "xtick.color", "ytick.color"), INK)
    | dict.fromkeys(("legend.fontsize", "xtick.labelsize", "ytick.labelsize"), 8)
    | {"font.size": 9, "axes.labelsize": 9, "axes.titlesize": 10, "figure.titlesize": 11}
)


def check_matplotlib() -> None:
    """Raise MissingExtraError if matplotlib is not installed."""
    if find_spec("matplotlib") is None:
        raise MissingExtraError("matplotlib", "picture", "a picture")


@contextmanager
def plotted(
    file: "IO[bytes] | str",
    size_px: tuple[int, int],
    layout: Any = "constrained",
    few_colours: int | None = None,
    dpi: int = 100,
) -> Iterator["Figure"]:
    """Yield a figure in the common style, and write it as PNG afterwards; MissingExtraError if matplotlib is not installed.

    Parameters
    ----------
    layout : engine of matplotlib; None if axes are placed by hand
    few_colours : size of the file's palette, for points and leaves, whose noise is costly in all colours; None for all
    """
    check_matplotlib()
    import matplotlib as mpl
    from cycler import cycler
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context({**_STYLE, "axes.prop_cycle": cycler(color=CYCLE)}):
        figure = Figure(figsize=(size_px[0] / dpi, size_px[1] / dpi), dpi=dpi, layout=layout)
        yield figure
        if few_colours is None:
            figure.savefig(file, format="png", metadata={"Software": "vlp16emu"}, pil_kwargs={"optimize": True})
            return
        from PIL import Image

        canvas: Any = FigureCanvasAgg(figure)  # its methods are untyped
        canvas.draw()
        picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
        # A palette by frequency alone would lose thin coloured lines.
        few = picture.quantize(few_colours, Image.Quantize.MAXCOVERAGE, kmeans=1, dither=Image.Dither.NONE)
        few.save(file, format="PNG", optimize=True)
