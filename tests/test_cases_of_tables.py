"""Tables, grids and meshes as other programs write them: files of kinds that people reported, in `cases`.

Each has the content of a file of `scenes/own_plot`, or of a solid that words describe.
"""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from vlp16emu.cli.app import run
from vlp16emu.errors import GeometryError
from vlp16emu.extras.score.files import read_stems
from vlp16emu.forest.ground.dem import DemHeights
from vlp16emu.forest.plants.species import flora
from vlp16emu.forest.settings import Dem
from vlp16emu.forest.stand.given_stand import read_stem_list

CASES = Path(__file__).parent / "cases"
PLOT = Path(__file__).parents[1] / "scenes" / "own_plot"
ORIGIN_M = (412300.0, 5412600.0, 486.0)


def trees_of(path):
    return read_stem_list(path, flora().trees, ORIGIN_M)


@pytest.mark.parametrize("name", ["23-stems-excel-de.csv", "23c-stems-NA.csv"])
def test_a_stem_list_of_excel_or_r_has_the_trees_of_the_plain_one(name):
    """German Excel writes `;`, decimal commas and a byte order mark; R writes NA for an empty cell
    (ezbookkeeping#458, readr#749)."""
    assert np.array_equal(trees_of(CASES / name), trees_of(PLOT / "stems.csv"))


def test_a_stem_list_in_the_windows_code_page_is_refused_with_the_way_out():
    """The line names the place, the character, and how Excel writes UTF-8."""
    message = r"23d-stems-cp1252.csv, line 2: no UTF-8 text: byte f6, in Windows-1252 'ö'; expected UTF-8"
    with pytest.raises(GeometryError, match=message):
        trees_of(CASES / "23d-stems-cp1252.csv")


@pytest.mark.parametrize(
    ("name", "columns", "delimiter"),
    [("23e-found-de.csv", ("x", "y", "dbh"), ";"), ("b10-stems-dbh0.csv", ("X", "Y", "DBH"), ",")],
)
def test_found_stems_are_read_and_0_is_no_dbh(name, columns, delimiter):
    """`score` reads the delimiters of stem lists; 3DFin writes a DBH of 0 where no circle was reliable
    (3DFin#92). Python's csv gives the same cells."""
    with (CASES / name).open(encoding="utf-8-sig", newline="") as file:
        rows = list(csv.DictReader(file, delimiter=delimiter))
    cells = np.array([[float(row[column].replace(",", ".")) for column in columns] for row in rows])
    found = np.array([(stem.x_m, stem.y_m, stem.dbh_m) for stem in read_stems(CASES / name)], np.float64)
    dbh = cells[:, 2]
    dbh[dbh == 0] = np.nan
    assert np.array_equal(found, cells, equal_nan=True)


def test_cells_that_are_nearly_square_are_those_of_the_grid_in_squares():
    """GDAL's AAIGrid driver writes dx and dy where they differ, here by 1e-5 (gama#3754): the ground of the
    same heights in cells of 2 m, but for 0.2 mm of place."""
    x_m, y_m = np.meshgrid(np.linspace(-28, 28, 50), np.linspace(-28, 28, 50))
    heights_m = [
        DemHeights(Dem(file=str(path)), origin_m=ORIGIN_M).height_m(x_m, y_m)
        for path in (CASES / "b11-dxdy.asc", PLOT / "ground.asc")
    ]
    assert heights_m[0] == pytest.approx(heights_m[1], abs=5e-4)


def test_a_mesh_in_the_windows_code_page_is_the_solid_that_it_describes():
    """A box of 1 m x 1 m x 2 m with a name and a comment in Windows-1252 (trimesh#2355)."""
    pytest.importorskip("trimesh", reason="the extra meshes is not installed")
    from vlp16emu.extras.meshes.files import load_mesh

    mesh = load_mesh(CASES / "b09-cp1252.obj", unit="m", up="z")
    ((name, part),) = mesh.parts
    assert name == "Kanzel_Süd"
    corners = part.vertices_m[part.faces].astype(np.float64)
    volume_m3 = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert volume_m3 == pytest.approx(2.0)


def test_a_trajectory_from_zero_is_taken_with_the_offset_that_is_found(tmp_path, capsys):
    """Times from 1 s on, as of KITTI and DLO (glim#52), are those of the capture less 1779267599 s."""
    capture = tmp_path / "bench.pcap"
    setting = "sensor.rpm=1200"
    assert run(["record", "static_bench", str(capture), "--duration", "0.12", "--set", setting]) == 0
    capsys.readouterr()
    way = CASES / "b12-times-from-zero.tum"
    words = [str(capture), str(tmp_path / "o.ply"), "--trajectory", str(way), "--json"]
    assert run(["points", *words, "--time-offset", "auto"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["time_offset_s"] == -1779267599
    assert summary["points"]
