"""Tree models from the user: meshes in place of grown trees, and their ground truth.

A model is scaled to the size of each tree.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from vlp16emu.doors import Part
from vlp16emu.elementary import atan2, cos, hypot, log, matmul, matvec, norm, sin
from vlp16emu.errors import GeometryError
from vlp16emu.foliage.tiles import EXACT, STEM
from vlp16emu.forest.plants.allometry import BREAST_HEIGHT_M, US_BREAST_HEIGHT_M
from vlp16emu.forest.plants.species import Flora, Species, Trees, find_species, flora
from vlp16emu.forest.plants.stem import STEM_CIRCLE, STEM_PARTS, circles_of, lean_rotation
from vlp16emu.forest.settings import Season, TreeModelFile
from vlp16emu.forest.stand.inventory import COPIED, INVENTORY, hull_m, profiles, volume_m3
from vlp16emu.forest.stand.placement import PlacedThings, about_vertical, plant_surfaces
from vlp16emu.inputs import LARGEST_BYTES, read_bytes
from vlp16emu.types import F8, I8, Mesh, PlantPart, ShapeKey
from vlp16emu.world.settings import LengthUnit, UpAxis
from vlp16emu.world.vectors import places_m

Faces = NDArray[np.uint32]


class LoadedMesh(Protocol):
    """A mesh file that has been read."""

    @property
    def parts(self) -> Sequence[tuple[str, Mesh]]:
        """Name and mesh of each part, relative to `centre_m`."""

    @property
    def centre_m(self) -> F8:
        """Centre (3,) of the file's coordinates."""


class MeshLoader(Protocol):
    """Function that reads a mesh file."""

    def __call__(self, path: Path, *, unit: LengthUnit, up: UpAxis) -> LoadedMesh:
        """Return the parts of a file whose coordinates have a unit and an upward axis."""


LOAD_MESH = Part[MeshLoader]("vlp16emu.extras.meshes.files:load_mesh")


@dataclass(frozen=True, slots=True)
class Outline:
    """A closed section."""

    middle_m: F8  # (2,) centroid
    diameter_m: float  # of the circle with its area
    tape_m: float  # diameter by a taut tape around it


class Cutter:
    """Sections of a mesh that consists of several parts, given by their vertices and faces."""

    def __init__(self, vertices_m: Sequence[F8], faces: Sequence[Faces]) -> None:
        first = np.cumsum([0, *map(len, vertices_m)])
        pieces = zip(faces, first, strict=False)
        corners = np.concatenate([part.astype(np.int64) + begin for part, begin in pieces])
        every_m = np.concatenate(vertices_m)
        # Vertices at equal positions are one, in the order of z, y and x.
        _, kept, number = np.unique(every_m[:, ::-1], axis=0, return_index=True, return_inverse=True)
        self.vertices_m = every_m[kept]
        self.faces = number.ravel()[corners]
        z_m = self.vertices_m[self.faces, 2]
        self.faces = self.faces[np.argsort(z_m.min(axis=1), kind="stable")]
        self._low_m = np.sort(z_m.min(axis=1))

    def cut(self, at_m: float) -> Outline | None:
        """Return the largest closed outline at a height; None if there is none."""
        from scipy.sparse import coo_array  # here: only models of trees need it
        from scipy.sparse.csgraph import connected_components, depth_first_order

        faces = self.faces[: np.searchsorted(self._low_m, at_m)]
        above = self.vertices_m[faces, 2] > at_m
        met = above.any(axis=1)
        faces = faces[met]
        above = above[met]
        start = faces
        end = np.roll(faces, -1, axis=1)
        crosses = above != np.roll(above, -1, axis=1)  # two edges of each face
        low, high = np.minimum(start, end)[crosses], np.maximum(start, end)[crosses]
        edges, edge_of = np.unique(low * len(self.vertices_m) + high, return_inverse=True)
        if not len(edges):
            return None
        ends_m = self.vertices_m[np.column_stack(np.divmod(edges, len(self.vertices_m)))]
        share = (at_m - ends_m[:, 0, 2]) / (ends_m[:, 1, 2] - ends_m[:, 0, 2])
        points_m = ends_m[:, 0, :2] + share[:, None] * (ends_m[:, 1, :2] - ends_m[:, 0, :2])
        a, b = edge_of.reshape(-1, 2).T
        graph = coo_array((np.ones(len(a), np.int8), (a, b)), shape=(len(edges),) * 2).tocsr()
        _, loop = connected_components(graph, directed=False)
        shared = np.bincount(edge_of, minlength=len(edges))
        closed = np.setdiff1d(loop, loop[shared != 2])
        begins = (int(np.argmax(loop == number)) for number in closed.tolist())
        rings = (points_m[depth_first_order(graph, begin, directed=False)[0]] for begin in begins)
        return max(map(_outline, rings), key=lambda outline: outline.diameter_m, default=None)


def _outline(ring_m: F8) -> Outline:
    from scipy.spatial import ConvexHull, QhullError

    at_m = ring_m - ring_m.mean(axis=0)
    twice = at_m[:, 0] * np.roll(at_m[:, 1], -1) - at_m[:, 1] * np.roll(at_m[:, 0], -1)
    middle_m = (at_m + np.roll(at_m, -1, axis=0)) * twice[:, None]
    try:
        girth_m = float(ConvexHull(ring_m).area)  # in the plane, `area` is the perimeter
    except QhullError:
        return Outline(ring_m.mean(axis=0), 0.0, 0.0)
    return Outline(
        ring_m.mean(axis=0) + middle_m.sum(axis=0) / (3.0 * twice.sum()),
        float(np.sqrt(2.0 * abs(twice.sum()) / np.pi)),
        girth_m / np.pi,
    )


_FOOT_SHARE = 0.01  # relative height of the section whose centre is the foot
# stem faces farther from the axis than this many radii plus this distance are not bole
_BOLE = 1.5
_BOLE_M = 0.02
_TILTS = 1024  # classes of leaf faces by their tilt
_KEPT_CUTS = 16_384  # cached sections of a model: more than there are trees in a window
_AROUND = np.array([cos(np.arange(36) * np.pi / 36), sin(np.arange(36) * np.pi / 36)])
"""Directions (2, 36) in which crowns are measured."""


class _Piece(NamedTuple):
    """A part of the file of a model: vertices (v, 3) as in the file, and faces (f, 3)."""

    part: PlantPart
    vertices_m: F8
    faces: Faces


def _pieces_of(section: TreeModelFile) -> list[_Piece]:
    """Read the parts of a model; GeometryError for a part that the file does not have, or without a stem."""
    path = Path(section.file)
    mesh = LOAD_MESH.load()(path, unit=section.unit, up=section.up)
    part_of = {part.name: part.part for part in section.parts}
    names = [name for name, _ in mesh.parts]
    for name in part_of.keys() - set(names):
        raise GeometryError(f"{path}: parts", f"found {name!r}", f"one of {', '.join(names)}")
    pieces = [
        _Piece(
            PlantPart[part_of.get(name, "stem").upper()],
            piece.vertices_m.astype(np.float64) + mesh.centre_m,
            piece.faces,
        )
        for name, piece in mesh.parts
    ]
    if not any(piece.part in STEM_PARTS for piece in pieces):
        raise GeometryError(f"{path}: parts", "no stem", "a part of the file that is the stem")
    return pieces


class TreeModel:
    """A tree model from the user, with its foot at the origin.

    The foot is the centre of the stem at the file's height 0, or at the stem's lower end if it does not reach
    0. Deciduous leaves are left out in the leaf-off season. Raises GeometryError for a part that the file
    does not have, or a stem without a closed section at breast height.
    """

    def __init__(self, section: TreeModelFile, species: Species, season: Season) -> None:
        self.path = Path(section.file)
        self.species = species
        sheds = species.foliage is not None and not species.foliage.is_borne(season)
        pieces = _pieces_of(section)
        stems = [piece for piece in pieces if piece.part in STEM_PARTS]
        low_m = min(piece.vertices_m[:, 2].min() for piece in stems)
        high_m = max(piece.vertices_m[:, 2].max() for piece in stems)
        ground_m = 0.0 if low_m <= 0.0 < high_m else low_m
        self.height_m = float(max(piece.vertices_m[:, 2].max() for piece in pieces)) - ground_m
        up_m = [piece.vertices_m - [0.0, 0.0, ground_m] for piece in stems]
        self._stem = Cutter(up_m, [piece.faces for piece in stems])
        self._cuts = lru_cache(maxsize=_KEPT_CUTS)(self._stem.cut)
        foot_m = np.append(self._cut(_FOOT_SHARE * self.height_m).middle_m, ground_m)
        self._stem.vertices_m[:, :2] -= foot_m[:2]
        self._cuts.cache_clear()
        self._cut(BREAST_HEIGHT_M)
        self._profile_m = self._circles(low_m - ground_m, high_m - ground_m)
        volumes_m3 = [abs(volume_m3(_used_vertices(each.vertices_m - foot_m, each.faces))) for each in pieces]
        by_part = list(zip(pieces, volumes_m3, strict=True))
        self._stem_m3 = sum(volume for piece, volume in by_part if piece.part in STEM_PARTS)
        self._wood_m3 = sum(volume for piece, volume in by_part if piece.part != PlantPart.LEAF)
        rows = list[tuple[int, int, Mesh]]()
        for piece in pieces:
            left = piece.faces[:0] if sheds and piece.part == PlantPart.LEAF else piece.faces
            rows += self._meshes(piece.part, piece.vertices_m - foot_m, left)
        self.parts, self.far_parts, self.meshes = zip(*rows, strict=True)
        """Parts of each mesh, for labels of points and for the far medium; branches of a stem part are a
        separate mesh."""
        self._keep_measures()
        text = f"{section.model_dump_json(exclude={'file'})} {sheds}"
        content = read_bytes(self.path, "a mesh", GeometryError, most_bytes=LARGEST_BYTES)
        self.content = hashlib.sha256(content + text.encode()).hexdigest()[:32]

    def far_stems(self, world_T_model: F8, rows: I8) -> NDArray[np.void]:
        """Stems as `STEM` of placements (n, 3, 4) whose first surfaces are in rows (n,)."""
        across = norm(world_T_model[:, :, 0])
        middle_m = matvec(world_T_model[:, None, :, :3], self._profile_m[:, :3])
        stems = profiles(world_T_model[:, :, 3], middle_m, across[:, None] * self._profile_m[:, 3], 0)
        stems["flare_m"] = -1.0
        stems["row"] = rows[:, None] + self.far_parts.index(EXACT)
        return stems

    def outline(self, height_m: float, above_m: float) -> Outline:
        """Return the stem's section at a height over the foot of the model scaled to `height_m`.

        Its width is as in the file.
        """
        return self._cut(above_m * self.height_m / height_m)

    def circles(self, trees: Trees) -> NDArray[np.void]:
        """Circles `STEM_CIRCLE` along the stems of trees (n,), from the ground to the tip, tree by tree."""
        profile_m = self._profile_m[self._profile_m[:, 2] >= 0.0]
        world_T = self.world_T_model(trees)
        across = self.scale(trees)[:, 0]
        up_m = matvec(world_T[:, None, :, :3], profile_m[:, :3])
        at_m = places_m(trees)[:, None] + up_m
        radius_m = across[:, None] * profile_m[:, 3]
        circles = circles_of(trees, 1, PlantPart.STEM, at_m, radius_m)
        circles["above_foot_m"] = up_m[..., 2]
        return circles.ravel()

    def scale(self, trees: Trees) -> F8:
        """Scale (n, 2) for trees: across, to match their DBH, and along the axis."""
        upright = cos(np.radians(trees["lean_deg"]))
        own_m = [
            self.outline(height_m, BREAST_HEIGHT_M).diameter_m for height_m in trees["height_m"].tolist()
        ]
        return np.column_stack([trees["dbh_m"] / own_m, trees["height_m"] / upright / self.height_m])

    def world_T_model(self, trees: Trees) -> F8:
        """Return the transforms (n, 3, 4) of trees."""
        lean = lean_rotation(trees["lean_deg"], trees["lean_towards_deg"])
        across, along = self.scale(trees).T
        stretched = (
            about_vertical(trees["crown_azimuth_deg"]) * np.column_stack([across, across, along])[:, None]
        )
        foot_m = places_m(trees)
        return np.concatenate([matmul(lean, stretched), foot_m[..., None]], axis=2)

    def measure(self, row: np.void, tree: Trees) -> None:
        """Fill in the fields of a row `INVENTORY` that follow from the meshes of one tree (1,)."""
        (world_T,) = self.world_T_model(tree)
        height_m = float(tree["height_m"][0])
        turn = world_T[:, :3]
        foot_m = world_T[:, 3]
        (across, along) = self.scale(tree)[0].tolist()
        breast, us = (self.outline(height_m, at_m) for at_m in (BREAST_HEIGHT_M, US_BREAST_HEIGHT_M))
        middle_m = np.append(breast.middle_m, BREAST_HEIGHT_M * self.height_m / height_m)
        row["x_breast_m"], row["y_breast_m"] = (matvec(turn, middle_m) + foot_m)[:2]
        row["dbh_us_m"] = across * us.diameter_m
        row["girth_over_pi_m"] = across * breast.tape_m
        whole_m, crown_m = (matvec(turn, corners_m) for corners_m in (self._corners_m, self._crown_corners_m))
        for axis, name in enumerate("xy"):
            row[f"{name}_min_m"] = foot_m[axis] + whole_m[:, axis].min()
            row[f"{name}_max_m"] = foot_m[axis] + whole_m[:, axis].max()
        row["crown_base_m"] = row["height_m"]
        row["top_m"] = whole_m[:, 2].max()
        if len(crown_m):
            row["crown_base_m"] = crown_m[:, 2].min()
            row["crown_width_m"] = np.ptp(matvec(_AROUND.T, crown_m[:, :2]), axis=0).mean()
        size = across * across * along
        row["stem_m3"] = size * self._stem_m3
        row["wood_m3"] = size * self._wood_m3
        # Faces across the axis scale with the square of the width, upright ones with width and height.
        level_m2, upright_m2 = self._leaf_m2
        row["leaf_m2"] = hypot(across * across * level_m2, across * along * upright_m2).sum()
        sizes = (np.array([row[name]]) for name in ("dbh_m", "height_m", "crown_base_m"))
        row["biomass_kg"] = self.species.biomass_kg(*sizes)[0]

    def _keep_measures(self) -> None:
        """Keep the inputs of a tree's row.

        They are the corners of the hulls of tree and crown, and leaf faces by their normals.
        """
        rows = list(zip(self.parts, self.meshes, strict=True))
        leaves = [mesh for part, mesh in rows if part == PlantPart.LEAF]
        branches = [mesh for part, mesh in rows if part not in (*STEM_PARTS, PlantPart.LEAF)]
        crown = leaves if any(len(mesh.faces) for mesh in leaves) else branches
        self._corners_m, self._crown_corners_m = (
            hull_m(np.concatenate([np.zeros((0, 3)), *(mesh.vertices_m for mesh in meshes)]))
            for meshes in (self.meshes, crown)
        )
        faces_m = [mesh.vertices_m.astype(np.float64)[mesh.faces] for mesh in leaves]
        sides = [np.cross(face[:, 1] - face[:, 0], face[:, 2] - face[:, 0]) / 2 for face in faces_m]
        side_m2 = np.concatenate([np.zeros((0, 3)), *sides])
        level_m2 = np.abs(side_m2[:, 2])
        upright_m2 = hypot(side_m2[:, 0], side_m2[:, 1])
        tilt = (atan2(level_m2, upright_m2) * (_TILTS / np.pi * 2.0)).astype(int).clip(max=_TILTS - 1)
        self._leaf_m2 = [np.bincount(tilt, m2, _TILTS) for m2 in (level_m2, upright_m2)]

    def _circles(self, low_m: float, high_m: float) -> F8:
        """Centres and radii (16, 4) of the stem, denser at the butt.

        They are interpolated linearly where the stem cannot be cut.
        """
        share = np.square(np.linspace(0.0, 1.0, 16))
        at_m = low_m + share * (high_m - low_m)
        cuts = [
            self._stem.cut(low_m + height * (high_m - low_m))
            for height in share.clip(1e-3, 1.0 - 1e-3).tolist()
        ]
        with_cut = [i for i, cut in enumerate(cuts) if cut is not None]
        found = np.array([[*cut.middle_m, cut.diameter_m / 2] for cut in cuts if cut is not None])
        x_m, y_m, radius_m = (np.interp(at_m, at_m[with_cut], column) for column in found.T)
        return np.column_stack([x_m, y_m, at_m, radius_m])

    def _meshes(self, part: PlantPart, vertices_m: F8, faces: Faces) -> list[tuple[int, int, Mesh]]:
        """Part, part in the far medium and mesh for one part of the file.

        A stem is split into bole and branches.
        """
        if part not in STEM_PARTS:
            return [(part, part, _used_vertices(vertices_m, faces))]
        x, y, at_m, radius = self._profile_m.T
        x_m, y_m, radius_m = (np.interp(vertices_m[:, 2], at_m, column) for column in (x, y, radius))
        near = hypot(vertices_m[:, 0] - x_m, vertices_m[:, 1] - y_m) < _BOLE * radius_m + _BOLE_M
        bole = near[faces].all(axis=1)
        return [
            (part, EXACT, _used_vertices(vertices_m, faces[bole])),
            (part, part, _used_vertices(vertices_m, faces[~bole])),
        ]

    def _cut(self, at_m: float) -> Outline:
        outline = self._cuts(at_m)
        if outline is None:
            found = f"no closed section of the stem at {at_m:.2f} m of its {self.height_m:.2f} m"
            raise GeometryError(str(self.path), found, "one, since breast height comes to lie there")
        return outline


def _used_vertices(vertices_m: F8, faces: Faces) -> Mesh:
    used, corners = np.unique(faces, return_inverse=True)
    return Mesh(vertices_m[used].astype(np.float32), corners.reshape(-1, 3).astype(np.uint32))


_ALIKE = 1.25  # models within this factor of the least stretching are equally good


@dataclass(frozen=True, slots=True)
class ModelKey:
    """Key of a model's shape."""

    number: int  # among the models of the scene
    content: str  # digest of all its inputs


class TreeModels:
    """The models of a scene, each for trees of its species.

    Raises GeometryError for an unknown species, or a file that cannot be scanned.
    """

    def __init__(
        self, files: Sequence[TreeModelFile] = (), plants: Flora | None = None, season: Season = "leaf_on"
    ) -> None:
        self._plants = plants or flora()
        keys = [f"world.tree_models.{i}.species" for i in range(len(files))]
        species = [
            find_species([file.species], self._plants.trees, key)[0]
            for file, key in zip(files, keys, strict=True)
        ]
        self._models = [TreeModel(file, kind, season) for file, kind in zip(files, species, strict=True)]
        self._species = [model.species.number for model in self._models]

    def has(self, trees: Trees) -> NDArray[np.bool_]:
        """Return a mask (n,) of the trees that have a model."""
        return np.isin(trees["species"], self._species)

    def place(self, trees: Trees) -> list[PlacedThings]:
        """Place trees (n,) that all have models, grouped by model."""
        placed = []
        for i, trees_of in self._by_model(trees):
            model = self._models[i]
            keys = [ModelKey(i, model.content)] * len(trees_of)
            rows = plant_surfaces(trees_of, model.parts, self._plants)
            placed.append(PlacedThings(keys, model.world_T_model(trees_of), rows, trees_of))
        return placed

    def shape(self, key: ModelKey) -> tuple[Mesh, ...]:
        """Meshes of a model."""
        return self._models[key.number].meshes

    def far_parts(self, key: ShapeKey) -> tuple[int, ...] | None:
        """Return the parts of a model's meshes in the far medium; None for any other shape."""
        return self._models[key.number].far_parts if isinstance(key, ModelKey) else None

    def far_stems(self, keys: Sequence[ShapeKey], world_T_shape: F8, rows: I8) -> NDArray[np.void]:
        """Stems as `STEM` of the placements (n,) that are models, by their first surfaces."""
        model_of = np.array([key.number if isinstance(key, ModelKey) else -1 for key in keys], np.int64)
        stems = (
            model.far_stems(world_T_shape[model_of == i], rows[model_of == i])
            for i, model in enumerate(self._models)
        )
        return np.concatenate([np.zeros(0, STEM), *stems])

    def inventory(self, trees: Trees) -> NDArray[np.void]:
        """Return the inventory (n,) `INVENTORY` of trees that all have models, from their meshes.

        The crown begins with the lowest leaf, or branch where there are no leaves; its width is the mean over
        all directions. One side of each leaf face counts.
        """
        rows = np.zeros(len(trees), INVENTORY)
        for name in COPIED:
            rows[name] = trees[name]
        for i, row in enumerate(rows):
            tree = trees[i : i + 1]
            self._models[self._choose_model(tree)].measure(row, tree)
        return rows

    def circles(self, trees: Trees) -> NDArray[np.void]:
        """Circles `STEM_CIRCLE` along the stems of trees that all have models."""
        trees_of = (self._models[i].circles(trees_of) for i, trees_of in self._by_model(trees))
        return np.concatenate([np.zeros(0, STEM_CIRCLE), *trees_of])

    def _by_model(self, trees: Trees) -> list[tuple[int, Trees]]:
        chosen = np.array([self._choose_model(trees[i : i + 1]) for i in range(len(trees))], np.int64)
        return [(i, trees[chosen == i]) for i in np.unique(chosen).tolist()]

    def _choose_model(self, tree: Trees) -> int:
        """Choose the model of one tree (1,) by its size.

        Among equally good ones the last digits of its azimuth decide.
        """
        fits = [i for i, number in enumerate(self._species) if number == tree["species"][0]]
        if len(fits) == 1:
            return fits[0]
        stretch = [
            abs(float(log(across / along))) for i in fits for across, along in self._models[i].scale(tree)
        ]
        good = [i for i, ratio in zip(fits, stretch, strict=True) if ratio <= min(stretch) + log(_ALIKE)]
        return good[int(tree["crown_azimuth_deg"][0] * 1e6) % len(good)]
