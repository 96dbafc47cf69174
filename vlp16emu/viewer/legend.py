"""What colours mean, and what is wrong with packets, as HTML beside the page."""

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

from vlp16emu.viewer.layers import Entries, colours_of_scale

_STOPS = 9
"""Colours of a gradient."""
_BOX = "margin:0.3em 1em;font-size:0.85em;line-height:1.5"
_DOT = "display:inline-block;width:0.8em;height:0.8em;margin-right:0.5em;border-radius:2px"


def legend_of(entries: Entries) -> str:
    """Write the legend of a layer."""
    if entries is None:
        return f'<div style="{_BOX}">each plant or thing in its own colour, what is none in grey</div>'
    if isinstance(entries, Mapping):
        rows = (
            f'<span style="{_DOT};background:rgb{rgb}"></span>{escape(name.replace("_", " "))}'
            for name, rgb in entries.items()
        )
        return f'<div style="{_BOX}">{"<br>".join(rows)}</div>'
    least, most, unit = entries
    colours = colours_of_scale(np.linspace(least, most, _STOPS), least, most).tolist()
    stops = ",".join(f"rgb{tuple(rgb)}" for rgb in colours)
    bar = f'<div style="height:0.8em;border-radius:2px;background:linear-gradient(to right,{stops})"></div>'
    ends = f"<span>{least:g}</span><span>{most:.3g} {escape(unit)}</span>"
    return (
        f'<div style="{_BOX}">{bar}<div style="display:flex;justify-content:space-between">{ends}</div></div>'
    )


def list_of(lines: Sequence[str]) -> str:
    """Write lines of text."""
    return f'<div style="{_BOX}">{"<br>".join(map(escape, lines))}</div>'
