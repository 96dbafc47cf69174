"""Numbers that are none, in every kind of file that a user brings."""

import io
import itertools
import re
import tempfile
from collections.abc import Callable, Iterator, Mapping
from importlib import resources
from pathlib import Path

import numpy as np
import trimesh
from rasterio.io import MemoryFile
from rasterio.transform import Affine

from stability_cases.coordinates import write_plot
from stability_cases.entries import refusal, turned_down
from stability_cases.row import Row

_WORDS = ("nan", "inf", "-inf")
_HERE = (0, 0, 0)
Files = Mapping[str, str | bytes]

_TUM = "0 0 0 1.5 0 0 0 1\n{} 1 0 1.5 0 0 0 1\n1 2 0 1.5 0 0 0 1\n"
_CSV = "t_s,x_m,y_m,z_m,qx,qy,qz,qw\n" + _TUM.replace(" ", ",")
_KITTI = "1 0 0 0 0 1 0 0 0 0 1 1.5\n"
_WAY_CSV = "x_m,y_m,stop_s\n-2,0,0\n0,1,1\n2,0,0\n"
_GPX = '<gpx><trk><trkseg><trkpt lat="62.24" lon="25.75"/><trkpt lat="LAT" lon="LON"/></trkseg></trk></gpx>'
_STEMS = "x,y,species,dbh_cm,height_m,crown_base_m,crown_width_m,lean_deg,lean_azimuth_deg\n"
_STEM = "6,4,norway_spruce,30,24,8,4,1,90"
_OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 X\nf 1 2 3\nf 1 2 4\n"
_PLY = (
    "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 2\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n0 0 X\n3 0 1 2\n3 0 1 3\n"
)


def _each_cell(line: str, word: str, cells: range, mark: str | None = None) -> Iterator[str]:
    """Lines in which one cell after the other is a word."""
    for cell in cells:
        words = line.split(mark)
        words[cell] = word
        yield (mark or " ").join(words)


def _recorded(text: str, kind: str, word: str) -> Iterator[tuple[Files, str]]:
    first, second, *others = text.format("0.5").splitlines(keepends=True)[-3:]
    head = text.splitlines(keepends=True)[:-3]
    for bad in _each_cell(second.strip(), word, range(8), "," if kind == "csv" else None):
        yield {"way": "".join([*head, first, bad + "\n", *others])}, f'format="{kind}"'


def _trajectories(word: str) -> Iterator[tuple[Files, str]]:
    """Files and settings of motions with one bad number."""
    for text, kind in ((_TUM, "tum"), (_CSV, "csv")):
        for files, form in _recorded(text, kind, word):
            yield files, f'motion={{kind="recorded",file="FOLDER/way",{form}}}'
    for bad in _each_cell(_KITTI.strip(), word, range(12)):
        yield {"way": _KITTI + bad}, 'motion={kind="recorded",file="FOLDER/way",format="kitti",rate_hz=10}'
    timed = 'motion={kind="recorded",file="FOLDER/way",format="kitti",times_file="FOLDER/times"}'
    yield {"way": 2 * _KITTI, "times": f"0\n{word}\n"}, timed
    for bad in _each_cell("0,1,1", word, range(3), ","):
        yield ({"way.csv": _WAY_CSV.replace("0,1,1", bad)}, 'motion={kind="walk",way_points_file="FOLDER/way.csv"}')
    for axis, other in (("LAT", "LON"), ("LON", "LAT")):
        text = _GPX.replace(axis, word).replace(other, "25.76")
        yield {"way.gpx": text}, 'motion={kind="walk",way_points_file="FOLDER/way.gpx"}'


def _verdicts(name: str, tries: Callable[[str], Iterator[tuple[Files, str]]], *, plot: bool) -> Iterator[Row]:
    """Try files in a hall or on a plot: all of them from Python, the last one from the command line too."""
    lines, scene, settings = [], "", list[str]()
    with tempfile.TemporaryDirectory() as folder:
        for word in _WORDS:
            for files, setting in tries(word):
                scene = str(write_plot(Path(folder), _HERE, _HERE, walk=False)) if plot else "static_bench"
                for file, content in files.items():
                    Path(folder, file).write_bytes(content.encode() if isinstance(content, str) else content)
                settings = [setting.replace("FOLDER", folder)] if setting else []
                line, named = refusal(scene, *settings), f"{folder}/{[*files][-1]}"
                lines.append(line.replace(f"{folder}/", "") if named in line else "")
        options = [word for setting in settings for word in ("--set", setting)]
        lines.append(turned_down("record", scene, f"{folder}/out.pcap", *options).replace(f"{folder}/", ""))
    yield Row(f"NaN or infinity in {len(lines) - 1} {name}", "not refused by name", lines.count(""), 0, lines[-1])


def trajectory_files() -> Iterator[Row]:
    """Read recorded poses in TUM, CSV and KITTI, waypoints in CSV and GPX."""
    yield from _verdicts("trajectories", _trajectories, plot=False)


def _stems(word: str) -> Iterator[tuple[Files, str]]:
    for cells in (range(2), range(3, 9)):  # between them is the species
        for bad in _each_cell(_STEM, word, cells, ","):
            yield {"plot.csv": f"{_STEMS}{bad}\n"}, ""


def stem_lists() -> Iterator[Row]:
    """Read trees with a place or a size that is none."""
    yield from _verdicts("stem lists", _stems, plot=True)


def _binary(kind: str, number: float) -> bytes:
    """Write two triangles in STL or GLB, one with a bad corner."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, number]], np.float64)
    solid = trimesh.Trimesh(corners, [[0, 1, 2], [0, 1, 3]], process=False)
    if kind == "stl":
        content = np.zeros(2, np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")]))
        content["corners"] = corners[solid.faces]
        return b"\0" * 80 + np.uint32(2).tobytes() + content.tobytes()
    exported: bytes = solid.export(file_type="glb")
    return exported


def _meshes(word: str) -> Iterator[tuple[Files, str]]:
    yield {"box.obj": _OBJ.replace("X", word)}, ""
    for suffix, content in (
        ("ply", _PLY.replace("X", word)),
        ("stl", _binary("stl", float(word))),
        ("glb", _binary("glb", float(word))),
    ):
        place = f'file="FOLDER/mesh.{suffix}",unit="m",up="z",places=[{{x_m=4.0,y_m=3.0}}]'
        yield {f"mesh.{suffix}": content}, f"world.meshes=[{{{place}}}]"


def mesh_files() -> Iterator[Row]:
    """Read corners that are nowhere in OBJ, PLY, STL and GLB."""
    yield from _verdicts("meshes", _meshes, plot=True)


def _tiff(height: float = 0.0, east: float = -61.0, cell: float = 2.0) -> bytes:
    """Write a GeoTIFF of flat ground about the origin, with one bad number."""
    heights = np.zeros((61, 61), np.float32)
    heights[30, 30] = height
    place = Affine(cell, 0.0, east, 0.0, -cell, 61.0)
    with MemoryFile() as memory:
        with memory.open(
            driver="GTiff", width=61, height=61, count=1, dtype="float32", crs="EPSG:25832", transform=place
        ) as file:
            file.write(heights, 1)
        return bytes(memory.getbuffer())


def _npy(height: float) -> bytes:
    heights, file = np.zeros((61, 61)), io.BytesIO()
    heights[30, 30] = height
    np.save(file, heights)
    return file.getvalue()


def _grounds(word: str) -> Iterator[tuple[Files, str]]:
    """Height grids with one bad number."""
    number = float(word)
    row, bad_row = (" ".join([*["0"] * 30, middle, *["0"] * 30]) + "\n" for middle in ("0", word))
    header = "ncols 61\nnrows 61\nxllcenter -60\nyllcenter -60\ncellsize 2\n"
    yield {"ground.asc": header + 30 * row + bad_row + 30 * row}, ""
    for key in ("ncols 61", "nrows 61", "xllcenter -60", "yllcenter -60", "cellsize 2"):
        yield {"ground.asc": header.replace(key, f"{key.split()[0]} {word}") + 61 * row}, ""
    yield ({"ground.npy": _npy(number)}, 'world.dem={file="FOLDER/ground.npy",cell_m=2.0,corner_m=[-61.0,-61.0]}')
    for bad in ({"height": number}, {"east": number}, {"cell": number}):
        yield {"ground.tif": _tiff(**bad)}, 'world.dem={file="FOLDER/ground.tif"}'


def ground_files() -> Iterator[Row]:
    """Read heights, corners and cells of grids in ASCII, NumPy and GeoTIFF."""
    yield from _verdicts("height grids", _grounds, plot=True)


def _plants(word: str) -> Iterator[tuple[Files, str]]:
    """Give birches under another name, a third of its numbers bad, one after the other."""
    shipped = resources.files("vlp16emu.forest").joinpath("species.toml").read_text(encoding="utf-8")
    start = shipped.index("[tree.silver_birch]")
    birch = shipped[start : shipped.index("[tree.", shipped.index("[tree.silver_birch.crown.twigs]") + 1)]
    bare = re.sub(r" *#.*", "", birch).replace("silver_birch", "birch_2").replace("number = 1", "number = 1001")
    numbers = re.finditer(r"(?<=[ \[])-?\d[\d.]*(?=[\],\n])", bare)
    for number in itertools.islice(numbers, _WORDS.index(word), None, len(_WORDS)):
        text = bare[: number.start()] + word + bare[number.end() :]
        yield {"plants.toml": text}, 'world.species_file="FOLDER/plants.toml"'


def species_files() -> Iterator[Row]:
    """Read species with a measure that is none."""
    yield from _verdicts("species files", _plants, plot=True)
