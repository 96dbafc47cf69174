"""What a caster makes of shapes and tiles as bundles of arrays, as a store keeps them."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from vlp16emu.raycast.build import Shape, shape_of
from vlp16emu.raycast.cloud import Cloud, Library, cloud_of
from vlp16emu.raycast.medium import Block
from vlp16emu.raycast.voxel import LAW_BIT, LAW_MASK
from vlp16emu.store import Bundle, recalled
from vlp16emu.types import ShapeKey, World

__all__ = ["packed_block", "recalled_cloud", "recalled_shape", "unpacked_block"]


def recalled_shape(world: World, key: ShapeKey) -> Shape:
    """Faces of a shape, grown where no store has them."""
    name = world.shape_name(key)
    return recalled(
        name and f"faces {name}", lambda: shape_of(world.shape(key)), _packed_shape, _unpacked_shape
    )


def _packed_shape(shape: Shape) -> Bundle:
    """Put faces into arrays."""
    named = {f"{i} {j}": array for i, faces in enumerate(shape.faces) for j, array in enumerate(faces)}
    return {"radius_m": np.array(shape.radius_m), **named}


def _unpacked_shape(bundle: Bundle) -> Shape:
    """Take faces out of arrays."""
    meshes = len(bundle) // 2
    faces = tuple((bundle[f"{i} 0"], bundle[f"{i} 1"]) for i in range(meshes))
    return Shape(faces, float(bundle["radius_m"]))  # type: ignore[arg-type]  # as they were put there


def recalled_cloud(world: World, key: ShapeKey, parts: NDArray[np.uint8]) -> Cloud:
    """Measure a shape, of `PlantPart`s (meshes,), where no store has it."""
    name = world.shape_name(key)
    return recalled(
        name and f"cloud {name} {parts.tolist()}",
        lambda: cloud_of(world.shape(key), parts),
        lambda cloud: {field.name: np.asarray(getattr(cloud, field.name)) for field in fields(cloud)},
        lambda bundle: Cloud(**{**bundle, "radius_m": float(bundle["radius_m"])}),  # type: ignore[arg-type]
    )


def packed_block(block: Block, library: Library, names: Sequence[str]) -> Bundle:
    """Put a block into arrays, with its laws by the names of shapes: libraries have them in an order of their own."""
    laws, law = np.unique((block.owner >> LAW_BIT) & LAW_MASK, return_inverse=True)
    shape = np.searchsorted(library.first_law, laws.astype(np.int64), side="right") - 1
    used, of = np.unique(shape, return_inverse=True)
    return {
        **{field.name: np.asarray(getattr(block, field.name)) for field in fields(block)},
        "owner": _with_law(block.owner, law),
        "law_shape": of,
        "law_mesh": laws.astype(np.int64) - library.first_law[shape],
        "shapes": np.frombuffer(json.dumps([names[i] for i in used.tolist()]).encode(), np.uint8),
    }


def unpacked_block(bundle: Bundle, library: Library, place: Mapping[str, int]) -> Block:
    """Take a block out of arrays, for a library with shapes at these places by name."""
    rest = dict(bundle)
    which = np.array([place[name] for name in json.loads(rest.pop("shapes").tobytes())], np.int64)
    law = library.first_law[which[rest.pop("law_shape")]] + rest.pop("law_mesh")
    owner = rest["owner"].astype(np.uint64, copy=False)
    rest["owner"] = _with_law(owner, law[(owner >> LAW_BIT) & LAW_MASK])
    return Block(**{**rest, "bottom": int(rest["bottom"])})  # type: ignore[arg-type]


def _with_law(owner: NDArray[np.uint64], law: NDArray[np.int64]) -> NDArray[np.uint64]:
    """Give owners other laws."""
    return (owner & ~(LAW_MASK << LAW_BIT)) | (law.astype(np.uint64) << LAW_BIT)
