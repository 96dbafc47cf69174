"""`vlp16emu compare` and `vlp16emu fit`: what distinguishes two units, and the settings of one."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from vlp16emu.cli.arguments import AsJson, CaptureFile
from vlp16emu.cli.printer import print_json, print_rows
from vlp16emu.options import Option

if TYPE_CHECKING:
    from vlp16emu.extras.compare import Compared


def compare(
    file: CaptureFile,
    other: Annotated[Path, Option("The capture to compare it with.", name="OTHER.pcap")],
    *,
    picture: Annotated[
        Path | None, Option("Draw spectra and histograms; needs the extra 'picture'.", "OUT.png")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compare two captures, ours or real ones, by what distinguishes units.

    Each statistic comes with the difference as a multiple of the spread of real units; above 1 real units do not differ so much. A
    minute of each capture is read at most. Scatter of ranges and of reflectivity also depends on what a capture shows:
    walls compare with walls, foliage with foliage.
    """
    from vlp16emu.extras.compare import compared, draw, read_sequences
    from vlp16emu.extras.plots import check_matplotlib
    from vlp16emu.output import OutputFile, spare

    if picture is not None:
        check_matplotlib()
        spare((file, other), picture)
    sequences = read_sequences(file), read_sequences(other)
    rows = compared(*sequences)
    if picture is not None:
        with OutputFile(picture, where=f"--picture {picture}") as output, output.writing() as opened:
            draw(opened, *sequences, (file.name, other.name))
    apart = [row.name for row in rows if row.apart]
    if as_json:
        found = [row._asdict() for row in rows]
        print_json({"files": [str(file), str(other)], "apart": apart, "statistics": found})
        return
    print_rows(
        f"{file} and {other}", {"": "     first     second   distance", **{row.text: _line(row) for row in rows}}
    )
    print(f"{len(apart)} of {len(rows)} statistics differ by more than real units do")


def _line(row: "Compared") -> str:
    unlike = [name for name, is_unlike in zip(("first", "second"), row.unlike, strict=True) if is_unlike]
    notes = (["differs"] if row.apart else []) + [f"{name} like no real unit" for name in unlike]
    return f"{row.first:10.4g} {row.second:10.4g} {row.distance:10.2f}  {', '.join(notes)}".rstrip()


def fit(
    file: CaptureFile, *, out: Annotated[Path | None, Option("Write them to a file instead.", "UNIT.toml")] = None
) -> None:
    """Print the [noise] and [sensor] tables of the unit that made a capture, for a scene file.

    The beat of its ranges has the phase of the capture's first pulse. A minute is read at most.
    """
    from vlp16emu.extras.compare import fitted, read_sequences
    from vlp16emu.output import OutputFile, spare

    if out is not None:
        spare((file,), out)
    text = _toml(fitted(read_sequences(file)))
    if out is None:
        print(text, end="")
        return
    with OutputFile(out, where=f"--out {out}") as output, output.writing() as opened:
        opened.write(text.encode())
    print(f"wrote {out}")


def _toml(tables: dict[str, dict[str, object]]) -> str:
    """Write tables of numbers, texts and truths, which are written as in JSON."""
    return "\n".join(
        f"[{name}]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in table.items())
        for name, table in tables.items()
    )
