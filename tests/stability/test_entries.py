"""Numbers that are none in keys of scenes; tests of readers have those in files, `tests/cli/test_app.py` those in options."""

import math
from collections.abc import Iterator
from typing import Any

import pytest
from pydantic import ValidationError

from vlp16emu.scenario import Scenario, schema


def _resolved(node: Any) -> Any:
    return schema()["$defs"][node["$ref"].rpartition("/")[2]] if "$ref" in node else node


def _trees(node: Any, value: float) -> Iterator[tuple[str, Any]]:
    """Path of each number below a node of the schema, and the smallest tree with a value there."""
    node = _resolved(node)
    if "anyOf" in node:
        for choice in node["anyOf"]:
            yield from _trees(choice, value)
    elif "discriminator" in node:
        name = node["discriminator"]["propertyName"]
        for tag, reference in node["discriminator"]["mapping"].items():
            for path, tree in _trees({"$ref": reference}, value):
                yield path, {name: tag} | tree
    elif node.get("type") == "object":
        for key, child in node.get("properties", {}).items():
            for path, tree in _trees(child, value):
                yield f".{key}{path}", {key: tree}
    elif node.get("type") == "array":
        places = node.get("prefixItems") or [node["items"]]
        for place, child in enumerate(places):
            for path, tree in _trees(child, value):
                others = [1.0] * (len(places) - 1)
                yield f"[{place}]{path}", [*others[:place], tree, *others[place:]]
    elif node.get("type") in ("number", "integer"):
        yield "", value


def _is_found(tree: Any) -> bool:
    """Whether the check of a scene finds the number that is none in a tree."""
    try:
        Scenario.model_validate(tree)
    except ValidationError as error:
        inputs = (finding["input"] for finding in error.errors(include_url=False))
        return any(isinstance(value, float) and not math.isfinite(value) for value in inputs)
    return False


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_no_key_takes_a_number_that_is_none(value):
    """Each key of the schema that takes a number, in a scene with nothing else in it, refuses NaN and infinity; `near_m` may be infinite."""
    tried = [
        (path, tree) for path, tree in _trees(schema(), value) if not (path.endswith("near_m") and value == math.inf)
    ]
    assert len(tried) > 300
    assert [path for path, tree in tried if not _is_found(tree)] == []
