"""Files of plots: the picture of a report as PNG, SVG or PDF, with the same bytes for the same report."""

import io
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import IO, TYPE_CHECKING, Any

from vlp16emu.errors import InputError, OutputError
from vlp16emu.inputs import parse_json, read_text
from vlp16emu.libraries import check_extra
from vlp16emu.output import OutputFile
from vlp16emu.trees import Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Report = Table
Look = dict[str, Any]  # keyword arguments of matplotlib
"""Tree of JSON types, as `--json` prints it; its member `report` names the verb."""

INK = "#222222"
SOFT = "#6b6b6b"
FAINT = "#d9d9d9"
"""Colours of text and the truth, of secondary text, and of grids."""
BLUE = "#0072b2"
ORANGE = "#e69f00"
GREEN = "#009e73"
VERMILION = "#d55e00"
PURPLE = "#cc79a7"
SKY = "#56b4e9"
"""Colours that readers with colour vision deficiency distinguish (Okabe and Ito, Color Universal Design,
2008)."""

_DRAWN = ("accuracy", "compare", "forest", "plan", "score")  # reports, each drawn by a module of this room
_FORMATS: Mapping[str, Look] = MappingProxyType(
    {
        ".png": {"format": "png", "metadata": {"Software": "vlp16emu"}},
        ".svg": {"format": "svg", "metadata": {"Date": None, "Creator": "vlp16emu"}},
        ".pdf": {
            "format": "pdf",
            "metadata": {"CreationDate": None, "Creator": "vlp16emu", "Producer": None},
        },
    }
)
"""Arguments of `savefig` by ending: without dates, the same figure has the same bytes."""
_STYLE: Mapping[str, object] = MappingProxyType(
    {
        "axes.axisbelow": True,
        "axes.edgecolor": SOFT,
        "axes.grid": True,
        "axes.labelcolor": INK,
        "axes.spines.right": False,
        "axes.spines.top": False,
        "axes.titlelocation": "left",
        "axes.titlesize": 13,
        "axes.titleweight": "bold",
        "figure.dpi": 100,
        "figure.titlesize": 16,
        "figure.titleweight": "bold",
        # comes with matplotlib, so fonts of the machine do not change a picture
        "font.family": "DejaVu Sans",
        "font.size": 12,
        "grid.color": FAINT,
        "grid.linewidth": 0.7,
        "legend.fontsize": 11,
        "legend.framealpha": 0.9,
        "lines.linewidth": 1.8,
        "savefig.dpi": 100,
        "svg.fonttype": "none",  # text stays text
        "svg.hashsalt": "vlp16emu",
        "text.color": INK,
        "xtick.color": SOFT,
        "ytick.color": SOFT,
    }
)


@contextmanager
def plotting(
    path: Path | None, inputs: Iterable[Path] = (), where: str = "--plot"
) -> Iterator[Callable[[Report], None]]:
    """Open a plot before any long work, and yield the function that draws a report into it.

    Without a path that function does nothing. Raises OutputError for another ending than .png, .svg and .pdf,
    or a file that cannot be written; MissingExtraError without matplotlib.

    Parameters
    ----------
    inputs : files that the run reads, which the plot may not replace
    where : the option in error lines
    """
    if path is None:
        yield lambda _: None
        return
    if path.suffix.lower() not in _FORMATS:
        raise OutputError(f"{where} {path}", f"found the ending {path.suffix!r}", ".png, .svg or .pdf")
    check_matplotlib()
    with OutputFile(path, where=f"{where} {path}", inputs=inputs) as output:

        def draw(report: Report) -> None:
            with output.writing() as file:
                file.write(picture_of(report, path.suffix))

        yield draw


def check_matplotlib() -> None:
    """Raise MissingExtraError if matplotlib is not installed, or too old."""
    check_extra("plot", "a plot")


def picture_of(report: Report, suffix: str) -> bytes:
    """Return the picture of a report as a file with an ending of `_FORMATS`.

    Raises InputError as `figure_of`.
    """
    import matplotlib.style

    file = io.BytesIO()
    with matplotlib.style.context(["default", dict(_STYLE)]), _drawing(report), warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a name may have characters that the font lacks
        figure_of(report).savefig(file, **_FORMATS[suffix.lower()])
    return _in_few_colours(file) if suffix.lower() == ".png" else file.getvalue()


def _in_few_colours(file: IO[bytes]) -> bytes:
    """Return a PNG with a palette of 256 colours: a third of the size, and lines on paper have no more."""
    from PIL import Image  # comes with matplotlib

    few = io.BytesIO()
    with Image.open(file) as image:
        palette = image.convert("RGB").quantize(256, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
        palette.save(few, format="PNG", optimize=True)
    return few.getvalue()


def figure_of(report: Report) -> "Figure":
    """Draw a report; InputError if it has no picture, or lacks a member.

    Artists that show data have an id (`gid`), which is in SVG files too.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    verb = report.get("report")
    if verb not in _DRAWN:
        raise InputError("report", f"found {verb}", f"a report of {', '.join(_DRAWN)} with --json")
    figure = Figure(layout="constrained")
    FigureCanvasAgg(figure)  # not the canvas of a window, whatever the machine has
    draw: Callable[[Figure, Report], None] = import_module(f"vlp16emu.extras.plot.{verb}").draw
    with _drawing(report):
        draw(figure, report)
    return figure


@contextmanager
def _drawing(report: Report) -> Iterator[None]:
    """Raise InputError for a report whose members cannot be drawn."""
    verb = report.get("report")
    try:
        yield
    except (ArithmeticError, AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        expected = f"what `vlp16emu {verb} --json` prints"
        raise InputError(f"report of {verb}", f"cannot be drawn ({error!r})", expected) from error


def plain_logarithm(axes: "Axes", names: str = "xy") -> None:
    """Label the logarithmic ones of the axes x and y with plain numbers at 1, 2 and 5 of each decade."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    for axis in (getattr(axes, f"{name}axis") for name in names):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())


def read_report(path: Path) -> Report:
    """Read a report that `--json` has printed into a file; InputError if it is no JSON object."""
    text = read_text(path, "a report in JSON", InputError)
    try:
        report = parse_json(text)
    except ValueError as error:
        raise InputError(str(path), f"no JSON ({error})", "a report that --json has printed") from None
    if not isinstance(report, dict):
        raise InputError(str(path), "found no JSON object", "a report that --json has printed")
    return report
