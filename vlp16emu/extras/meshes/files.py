"""Meshes that the user brings: OBJ, PLY, GLB and STL through trimesh, checked before they are scanned.

Refused: coordinates that are not finite, faces whose corners do not exist, files without a face, sizes that
suggest a wrong unit. Dropped and reported: triangles without area. Kept and reported: holes and faces that
are turned inside out, because rays hit both sides.
"""

import codecs
import logging
import re
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from vlp16emu.elementary import matvec, norm
from vlp16emu.errors import GeometryError
from vlp16emu.inputs import LARGEST_BYTES, parsing, read_bytes
from vlp16emu.trees import Tree
from vlp16emu.types import F8, I8, Mesh
from vlp16emu.world.settings import LengthUnit, UpAxis

_log = logging.getLogger(__name__)
Faces = I8
_UNIT_M = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
"""Exact by definition (inch and foot: international agreement of 1959)."""
_KINDS = ".obj", ".ply", ".glb", ".stl"
_SPLIT = dict.fromkeys(("skip_materials", "split_objects", "split_groups", "maintain_order"), True)
_AS_WRITTEN: Tree = {"process": False, "group_material": False, **_SPLIT}  # no face is joined or moved
_TALLEST_M = 500.0
_WIDEST_M = 10_000.0
_SMALLEST_M = 0.001
"""Greatest height, greatest width and least size of an object in a forest."""
# trimesh's own `process` and `validate` drop faces with a NaN without a word, and faces below 1e-8 units.
_FLAT = 1e-7  # height over longest side below which a triangle is a line: the resolution of single precision
_OBJ_BAD_FACE = re.compile(
    rb"^f[ \t]+(?:\S+(?!\S)(?:[ \t]+\S+(?!\S))?[ \t]*\r?$|(?:[^\s0]\S*[ \t]+)*0)", re.MULTILINE
)
"""A face of an OBJ file that trimesh would skip: fewer than three corners, or a corner 0 (they count from
1). Without possessive quantifiers, which match wrongly in Python 3.11.2 (python/cpython issue 106052)."""
_OBJ_ODD_LINE = re.compile(rb"^(?:[ \t]+[vf]|[vf][^\r\n#\t]*[#\t])[^\r\n]*", re.MULTILINE)
"""A vertex or face with a tab, a comment or leading blanks, which trimesh would skip or refuse."""
_OBJ_COMMENT = re.compile(rb"^[ \t]*#[^\r\n]*", re.MULTILINE)
"""A comment, which trimesh would continue in the next line after a backslash at its end."""
_MARKS = MappingProxyType(
    {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
)
"""Byte order marks of text."""
_HALF_CHARACTER = re.compile(rb"(?<=[\x80-\xff])\\(?=\r?$)", re.MULTILINE)
"""A backslash at the end of a line, which may be half a character, and would continue the line."""
_AMID_LETTERS = re.compile(rb"[A-Za-z][\x80-\xff]+[A-Za-z]")


@dataclass(frozen=True, slots=True, eq=False)
class UserMesh:
    """Meshes of a file, ready to be placed."""

    path: Path
    centre_m: F8  # (3,) middle of the bounding box in the file's frame, turned z up
    parts: tuple[tuple[str, Mesh], ...]  # sorted by name; in metres from the centre, z up
    radius_m: float  # radius of the bounding sphere about the centre


def load_mesh(path: Path, *, unit: LengthUnit, up: UpAxis) -> UserMesh:
    """Read a file of meshes.

    Each object or group of an OBJ file and each node of a GLB scene is a part of its own, with its own
    place; other files have one part, named like the file. Colours and textures are not read.

    Raises GeometryError with file, part and element if something cannot be scanned.

    Parameters
    ----------
    path : .obj, .ply, .glb or .stl
    unit : unit of its coordinates
    up : axis that points upwards; y turns to z, and z to -y
    """
    parts = [(name, *_without_empty_faces(f"{path}: {name}", *part)) for name, part in _parts(path)]
    scale = _UNIT_M[unit]
    z_up = [
        (name, _to_z_up(vertices, up) * scale, faces, dropped) for name, vertices, faces, dropped in parts
    ]
    corners = np.array([end for _, v, f, _ in z_up for end in (v[f].min(axis=(0, 1)), v[f].max(axis=(0, 1)))])
    low, high = corners.min(axis=0), corners.max(axis=0)
    _check_size(path, high - low, unit)
    centre = (low + high) / 2
    made = []
    for name, vertices, faces, dropped in z_up:
        own_m = vertices - centre
        made.append((name, Mesh(own_m.astype(np.float32), faces.astype(np.uint32))))
        for finding in _findings(own_m, faces, dropped):
            _log.warning("%s: %s: %s", path, name, finding)
    return UserMesh(path, centre, tuple(made), float(norm(high - low)) / 2)


def _parts(path: Path) -> list[tuple[str, tuple[F8, Faces]]]:
    """Return name, vertices and faces of all parts in the file's frame, sorted by name."""
    scene = _scene(path)
    found = []
    unnamed = list(scene.geometry) in (["geometry"], ["geometry_0"])  # trimesh's names for unnamed geometry
    for node in sorted(scene.graph.nodes_geometry):
        name = path.stem if unnamed else node
        file_T_part, geometry_name = scene.graph[node]
        geometry = scene.geometry[geometry_name]
        faces = np.asarray(getattr(geometry, "faces", ()), np.int64).reshape(-1, 3)
        if len(faces):
            vertices = np.asarray(geometry.vertices, np.float64)
            found.append((name, (_checked_vertices(f"{path}: {name}", vertices, faces, file_T_part), faces)))
        else:
            _log.warning("%s: %s: left out, for it has no face", path, name)
    if not found:
        raise GeometryError(str(path), "no face", "a whole file with a mesh of triangles")
    return found


def _scene(path: Path) -> Any:
    kind = path.suffix.lower()
    if kind not in _KINDS:
        raise GeometryError(str(path), f"found the ending {kind!r}", f"one of {', '.join(_KINDS)}")
    expected = "a mesh in GLB with all its data inside" if kind == ".glb" else f"a mesh in {kind[1:].upper()}"
    content = read_bytes(path, expected, GeometryError, most_bytes=LARGEST_BYTES)
    with parsing(path, expected, GeometryError):
        content = _in_utf8(kind, content)
    if kind == ".obj":
        content = _OBJ_COMMENT.sub(b"", content)
        content = _OBJ_ODD_LINE.sub(lambda line: b" ".join(line[0].partition(b"#")[0].split()), content)
    if kind == ".obj" and (bad := _OBJ_BAD_FACE.search(content)):
        line = content.count(b"\n", 0, bad.start()) + 1
        face = content[bad.start() :].partition(b"\n")[0].decode(errors="replace").strip()
        found = f"found the face {face!r}"
        expected = "three corners or more, counted from 1"
        raise GeometryError(f"{path}, line {line}", found, expected)
    import trimesh

    with parsing(path, expected, GeometryError):
        return trimesh.load_scene(BytesIO(content), file_type=kind[1:], **_AS_WRITTEN)


def _in_utf8(kind: str, content: bytes) -> bytes:
    """Return a mesh with its text in UTF-8.

    Keywords and numbers are ASCII, so an encoding that is guessed wrongly changes names of parts only.
    """
    if kind == ".glb" or (kind == ".stl" and _is_binary_stl(content)):
        return content
    marked = next((codec for mark, codec in _MARKS.items() if content.startswith(mark)), None)
    if marked:
        return content.decode(marked).encode()
    head, end, body = content.partition(b"end_header") if kind == ".ply" else (content, b"", b"")
    try:
        head.decode()
    except UnicodeDecodeError:
        head = _HALF_CHARACTER.sub(b"", head).decode(_code_page(head), "replace").encode()
    return head + end + body


def _code_page(text: bytes) -> str:
    """Guess the encoding of text that is no UTF-8: Chinese (GB 18030) or western (Windows-1252).

    Western text is no Chinese text or one of rare characters, and its accents stand amid other letters.
    """
    try:
        foreign = "".join(re.findall(r"[^\x00-\x7f]+", text.decode("gb18030")))
    except UnicodeDecodeError:
        return "cp1252"
    usual = len(foreign.encode("gb2312", "ignore")) // 2  # the 6763 characters in daily use
    return "gb18030" if 2 * usual > len(foreign) and not _AMID_LETTERS.search(text) else "cp1252"


def _is_binary_stl(content: bytes) -> bool:
    """Return True if the length is that of a header, the number of triangles in it, and 50 bytes for each."""
    return len(content) >= 84 and len(content) == 84 + 50 * int.from_bytes(content[80:84], "little")


def _checked_vertices(where: str, vertices: F8, faces: Faces, file_T_part: F8) -> F8:
    """Return vertices in the file's frame, after a check of both arrays."""
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise GeometryError(
            where, f"found vertices of {vertices.shape[-1]} numbers", "three coordinates each"
        )
    stray = (faces < 0) | (faces >= len(vertices))
    if stray.any():
        face, corner = np.argwhere(stray)[0]
        found = f"corner {faces[face, corner]} in face {face}, counted from 0"
        raise GeometryError(where, found, f"a number from 0 to {len(vertices) - 1}, its vertices")
    used = np.zeros(len(vertices), np.bool_)
    used[faces] = True
    broken = used & ~np.isfinite(vertices).all(axis=1)
    if broken.any():
        vertex = int(broken.argmax())
        raise GeometryError(
            where,
            f"found {vertices[vertex].tolist()} as vertex {vertex}, counted from 0",
            "finite coordinates",
        )
    return matvec(file_T_part[:3, :3], vertices) + file_T_part[:3, 3]


def _without_empty_faces(where: str, vertices: F8, faces: Faces) -> tuple[F8, Faces, int]:
    """Return the vertices in use, the faces that have an area, and the number of faces without."""
    corner = vertices[faces]
    sides = corner - np.roll(corner, 1, axis=1)
    longest2 = (sides * sides).sum(axis=2).max(axis=1)
    area2 = norm(np.cross(sides[:, 0], sides[:, 1]))
    solid = area2 > _FLAT * longest2
    if not solid.any():
        raise GeometryError(where, f"none of its {len(faces)} faces has an area", "a mesh of triangles")
    used, kept = np.unique(faces[solid], return_inverse=True)
    return vertices[used], kept.reshape(-1, 3), int((~solid).sum())


def _to_z_up(vertices: F8, up: UpAxis) -> F8:
    return vertices if up == "z" else np.column_stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]])


def _check_size(path: Path, extent_m: F8, unit: LengthUnit) -> None:
    """Refuse a size that no object in a forest has; the error suggests the unit that fits."""
    if extent_m[2] <= _TALLEST_M and _SMALLEST_M <= extent_m.max() <= _WIDEST_M:
        return
    size = " x ".join(f"{length:.3g}" for length in extent_m)
    size_of_file = extent_m.max() / _UNIT_M[unit]
    likely = [
        other for other, factor in _UNIT_M.items() if 0.1 <= size_of_file * factor <= 100 and other != unit
    ]
    hint = f" (perhaps its unit is {' or '.join(likely)})" if likely else ""
    expected = (
        f"at most {_TALLEST_M:g} m tall and {_WIDEST_M:g} m wide, at least {_SMALLEST_M * 1000:g} mm{hint}"
    )
    raise GeometryError(str(path), f"measures {size} m with unit = {unit!r}", expected)


def _findings(vertices: F8, faces: Faces, dropped: int) -> list[str]:
    import trimesh

    found = [f"dropped {dropped} of {dropped + len(faces)} faces, which have no area"] if dropped else []
    solid = trimesh.Trimesh(vertices, faces, process=False)
    solid.merge_vertices()
    if holes := len(trimesh.grouping.group_rows(solid.edges_sorted, require_count=1)):
        found.append(f"is not closed: edges with one face only: {holes}")
    if not solid.is_winding_consistent:
        found.append("has faces side by side that look opposite ways")
    elif not holes and solid.volume < 0:
        found.append("is inside out: all its faces look inwards")
    return found
