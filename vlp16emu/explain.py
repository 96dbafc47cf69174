"""Conversion of pydantic's findings into one line in the terms of the user's file."""

import difflib
import json
import math
from collections.abc import Iterator
from datetime import date, datetime, time

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from vlp16emu.trees import Tree

Node = Tree  # of a JSON Schema

_MISSING = "missing"
_UNKNOWN = ("extra_forbidden", "unexpected_keyword_argument")
"""Pydantic's names for the error "unknown key", of a model and of a dataclass."""
_MOST_PLACES = 3  # most tables with a key that one line names: more would not help
_MOST_KEYS = 8  # most keys of another table that one line names


def explain(error: ValidationError, schema: Node) -> tuple[str, str, str]:
    """Return key path, finding and expectation of the most helpful error; for missing keys, of all of them.

    The message of a validator of our own is the expectation. `schema` is the JSON Schema of the file.
    """
    # A misspelt key is also reported as missing; the misspelling is the more helpful message.
    findings = sorted(error.errors(include_url=False), key=lambda e: e["type"] not in _UNKNOWN)
    first, *others = (_in_words(finding, schema) for finding in findings)
    missing = [first, *(other for other in others if other[1] == first[1])]
    if first[1] != _MISSING or len(missing) == 1:
        return first
    paths = ", ".join(path for path, _, _ in missing)
    return paths, _MISSING, ", ".join(f"{path} = {words}" for path, _, words in missing)


def _in_words(finding: ErrorDetails, schema: Node) -> tuple[str, str, str]:
    keys, parent, node = _walk(finding["loc"], schema)
    kind = finding["type"]
    if kind in _UNKNOWN:
        return _path(keys), "unknown key", _valid_places(keys, parent, schema)
    if kind.startswith("union_tag"):
        tag = node["discriminator"]["propertyName"]
        choice = {"enum": list(node["discriminator"]["mapping"])}
        found = f"found {_as_text(finding['input'][tag])}" if tag in finding["input"] else _MISSING
        return _path([*keys, tag]), found, expected(choice)
    if kind == "missing":
        return _path(keys), _MISSING, expected(node)
    found = f"found {_as_text(finding['input'])}"
    if (key := _key_of(finding["input"], node, schema)) is not None:
        return _path(keys), found, f"a table, as by {_path([*keys, key])} = {_as_text(finding['input'])}"
    if kind == "value_error":
        return _path(keys), found, finding["msg"].removeprefix("Value error, ")
    words = expected(node)
    return (
        _path(keys),
        found,
        words.replace("a number", "a finite number") if kind == "finite_number" else words,
    )


def expected(node: Node) -> str:
    """Return in words the values that a node of the schema admits."""
    if "enum" in node or "const" in node:
        *others, last = [_as_text(value) for value in node.get("enum", [node.get("const")])]
        return f"{', '.join(others)} or {last}" if others else last
    if "discriminator" in node:
        tags = expected({"enum": list(node["discriminator"]["mapping"])})
        return f"a table with {node['discriminator']['propertyName']} = {tags}"
    if "anyOf" in node:
        return " or ".join(map(expected, _values(node)))
    kind = node["type"]
    if kind in ("integer", "number"):
        return f"{'a whole number' if kind == 'integer' else 'a number'} {_bounds(node)}".rstrip()
    if kind == "array":
        if "prefixItems" in node:
            return f"a list of {node['minItems']} numbers"
        ends = {"minItems": "of at least", "maxItems": "of at most"}
        return " ".join(["a list", *(f"{word} {node[key]}" for key, word in ends.items() if key in node)])
    if node.get("format") == "date-time":
        return "a date and time with its offset from UTC, such as 2026-05-20T09:00:00Z"
    return {"object": "a table", "string": "a text in quotes", "boolean": "true or false"}[kind]


def resolved(node: Node, schema: Node) -> Node:
    """Return the node behind a reference; for an optional node, the type of its value if it has one."""
    kinds = _values(node)
    node = kinds[0] if len(kinds) == 1 else node
    return schema["$defs"][node["$ref"].rpartition("/")[2]] if "$ref" in node else node


def _values(node: Node) -> list[Node]:
    """Return the alternatives of a node, without that of a missing value."""
    return [kind for kind in node.get("anyOf", ()) if kind.get("type") != "null"]


def _walk(loc: tuple[int | str, ...], schema: Node) -> tuple[list[int | str], Node, Node]:
    """Follow pydantic's path down the schema: the keys that the file has, the last table, the last node."""
    keys: list[int | str] = []
    parent = node = resolved(schema, schema)
    for part in loc:
        if "discriminator" in node:  # pydantic puts the union's tag into the path; the file does not have it
            node = resolved({"$ref": node["discriminator"]["mapping"][part]}, schema)
            continue
        if "anyOf" in node:  # of plain values: what follows names the alternative that was tried
            break
        keys.append(part)
        parent = node
        if isinstance(part, int):
            ahead = node["prefixItems"][part] if "prefixItems" in node else node["items"]
        else:
            ahead = node.get("properties", {}).get(part) or node.get("additionalProperties")
        node = resolved(ahead if isinstance(ahead, dict) else {}, schema)
    return keys, parent, node


def _path(keys: list[int | str]) -> str:
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys).lstrip(".") or "scene"


def _valid_places(keys: list[int | str], parent: Node, schema: Node) -> str:
    """Return where an unknown key would be valid, or the nearest known key.

    A key is valid in a table of another kind, or in other tables.
    """
    homes = [(path, tag) for path, tag in _all_keys(schema, schema) if path[-1] == keys[-1]]
    if beside := [tag for path, tag in homes if list(path) == keys and tag is not None]:
        name, _, own = beside[0]
        choice = f"{_path([*keys[:-1], name])} = {expected({'enum': [value for _, value, _ in beside]})}"
        keys_of_it = [key for key in own if key not in parent["properties"]]
        others = f", with {', '.join(keys_of_it)}" if len(keys_of_it) <= _MOST_KEYS else ""
        return f"{choice} beside it{others}"
    places = list(dict.fromkeys(_path(list(path)) for path, _ in homes))
    if 0 < len(places) <= _MOST_PLACES:
        return " or ".join(places)
    near = difflib.get_close_matches(str(keys[-1]), parent["properties"], n=1)
    return f"{near[0]}, the nearest known one" if near else f"one of {', '.join(parent['properties'])}"


Tag = tuple[str, str, list[str]]  # key and value that select the kind of a table, and its keys


def _all_keys(
    node: Node, schema: Node, path: tuple[str, ...] = (), tag: Tag | None = None
) -> Iterator[tuple[tuple[str, ...], Tag | None]]:
    """Yield the paths of all keys outside lists, with the tag that their table needs."""
    node = resolved(node, schema)
    for value, variant in _variants(node):
        kind = resolved(variant, schema)
        own = node["discriminator"]["propertyName"], value, list(kind["properties"])
        yield from _all_keys(kind, schema, path, own)
    for name, inner in node.get("properties", {}).items():
        yield (*path, name), tag
        yield from _all_keys(inner, schema, (*path, name))


def _variants(node: Node) -> list[tuple[str, Node]]:
    return [(tag, {"$ref": ref}) for tag, ref in node.get("discriminator", {}).get("mapping", {}).items()]


def _key_of(value: object, node: Node, schema: Node) -> str | None:
    """Return the key of a table that admits `value`, which was given in place of the table."""
    if isinstance(value, str):
        for kind in (node, *(resolved(variant, schema) for _, variant in _variants(node))):
            for name, inner in kind.get("properties", {}).items():
                choice = resolved(inner, schema)
                if value in choice.get("enum", [choice.get("const")]):
                    return str(name)
    return None


def _as_text(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, list):
        return f"a list of {len(value)}"
    if isinstance(value, datetime | date | time):
        return value.isoformat()
    text = json.dumps(value, ensure_ascii=False) if isinstance(value, str) else str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _bounds(node: Node) -> str:
    low, high = node.get("minimum", -math.inf), node.get("maximum", math.inf)
    if "multipleOf" in node:
        return f"from {low} to {high} in steps of {node['multipleOf']}"
    if low > -math.inf and high < math.inf:
        return f"from {_number(low)} to {_number(high)}"
    words = {
        "minimum": "at least",
        "exclusiveMinimum": "above",
        "maximum": "at most",
        "exclusiveMaximum": "below",
    }
    return " and ".join(f"{word} {_number(node[key])}" for key, word in words.items() if key in node)


def _number(limit: float) -> str:
    return str(limit) if isinstance(limit, int) else f"{limit:.10g}"
