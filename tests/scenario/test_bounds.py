"""Every key of a scene file, with bad and extreme values: a line that names the key, or a scene.

The schema of the program, which `test_schema.py` holds against a validator of JSON Schema, lists the keys.
"""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import pytest

from vlp16emu.errors import InputError
from vlp16emu.explain import resolved
from vlp16emu.scenario import load, schema

BAD = ("text", "", True, [], [[1]], {}, {"no_such_key": 1}, math.nan)
EXTREME = (1e308, 10**400, -(10**400))


class Place(NamedTuple):
    """A key of a scene: its path, its node of the schema, and the table of the scene around it."""

    path: tuple[str | int, ...]
    node: dict[str, Any]
    scene: dict[str, Any]

    def with_value(self, value: object) -> dict[str, Any]:
        """Return the scene with a value of the key."""
        return put(self.scene, self.path, value)


def put(tree: Any, path: tuple[str | int, ...], value: object) -> Any:
    """Return a copy of a tree with a value at a path."""
    if not path:
        return value
    first, *rest = path
    if isinstance(tree, list):
        return [
            put(item, tuple(rest), value) if number == first else item for number, item in enumerate(tree)
        ]
    return {**tree, first: put(tree.get(first, {}), tuple(rest), value)}


def sample(node: dict[str, Any]) -> Any:
    """Return a value that a node of the schema admits, of a table its required keys."""
    node = resolved(node, schema())
    if "const" in node or "enum" in node:
        return node.get("const", node.get("enum", [None])[0])
    if "anyOf" in node:
        return sample(node["anyOf"][0])
    if "discriminator" in node:
        return table_of(node, next(iter(node["discriminator"]["mapping"])))
    match node["type"]:
        case "object":
            return {key: sample(node["properties"][key]) for key in node.get("required", ())}
        case "array":
            inner = node.get("prefixItems") or [node["items"]] * max(node.get("minItems", 1), 1)
            return [sample(item) for item in inner]
        case "string":
            return "1970-01-01T00:00:00Z" if "format" in node else "x"
        case "boolean":
            return True
    low = node.get("minimum", node.get("exclusiveMinimum", 0))
    high = node.get("maximum", node.get("exclusiveMaximum", low + 2))
    return type(low)((low + high) / 2) if node["type"] == "number" else low


def table_of(node: dict[str, Any], word: str) -> dict[str, Any]:
    """Return a table of a kind."""
    tag = node["discriminator"]
    return {**sample({"$ref": tag["mapping"][word]}), tag["propertyName"]: word}


def places(node: dict[str, Any], path: tuple[str | int, ...], scene: dict[str, Any]) -> Iterator[Place]:
    """Yield all keys below a node, each kind of a table and an item of each list included."""
    node = resolved(node, schema())
    if path:
        yield Place(path, node, scene)
    for kind in node.get("anyOf", ()):
        if kind.get("type") in ("object", "array"):
            yield from places(kind, path, scene)
    for word, ref in node.get("discriminator", {}).get("mapping", {}).items():
        yield from places({"$ref": ref}, path, put(scene, path, table_of(node, word)))
    for key, inner in node.get("properties", {}).items():
        yield from places(inner, (*path, key), put(scene, (*path, key), sample(inner)))
    if node.get("type") == "array":
        for number, item in enumerate(node.get("prefixItems") or [node["items"]]):
            yield from places(item, (*path, number), put(scene, path, sample(node)))


BASE = {
    "schema": 1,
    "title": "Bounds",
    "motion": {"kind": "static"},
    "world": {"kind": "hall", "length_m": 20.0, "width_m": 10.0, "height_m": 5.0},
}
PLACES = [*places(schema(), (), BASE)]
SECTIONS = sorted({str(place.path[0]) for place in PLACES})


def names(line: str, path: tuple[str | int, ...]) -> bool:
    """Return whether a line names a key, or a table around it."""
    words = [str(name) for name in path if isinstance(name, str)]
    return any(word in line for word in words)


@pytest.mark.parametrize("section", SECTIONS)
def test_a_bad_or_extreme_value_is_one_line_that_names_its_key_or_loads(section):
    """Nothing else is raised by values of another type, of no size, or beyond any sensible size."""
    for place in PLACES:
        if place.path[0] != section:
            continue
        for value in (*BAD, *EXTREME):
            try:
                scene = load(place.with_value(value))
            except InputError as error:
                line = str(error)
                assert "\n" not in line
                assert names(line, place.path), f"{place.path} = {value!r:.40}: {line}"
            else:
                assert all(event.end_ns >= event.begin_ns for event in scene.events)


def test_every_number_has_bounds():
    """A number beyond any scene is refused by the limits of its own key."""
    open_ended = set()
    for place in PLACES:
        limits = place.node.keys()
        is_number = place.node.get("type") in ("number", "integer") and "const" not in limits
        is_low = "minimum" in limits or "exclusiveMinimum" in limits
        is_high = "maximum" in limits or "exclusiveMaximum" in limits
        if is_number and "enum" not in limits and not (is_low and is_high):
            open_ended.add(place.path)
    assert not open_ended
