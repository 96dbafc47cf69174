"""The JSON Schema of the scene file."""

import json
import math

from vlp16emu.scenario import load, schema
from vlp16emu.settings import Section

TABLES = {"scene": schema(), **schema()["$defs"]}


def test_the_schema_speaks_the_files_language():
    """It is JSON of its draft with the key `schema`, the limits of rpm and the kinds of motion; every
    table forbids keys that it does not name."""
    assert json.loads(json.dumps(schema()))["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    tree = schema()
    assert tree["properties"]["schema"] == {
        "const": 1,
        "description": "Version of this file format.",
        "type": "integer",
    }
    rpm = tree["$defs"]["Sensor"]["properties"]["rpm"]
    assert (rpm["minimum"], rpm["maximum"], rpm["default"]) == (300, 1200, 600)
    assert set(tree["properties"]["motion"]["discriminator"]["mapping"]) == {
        "live",
        "recorded",
        "static",
        "walk",
    }
    assert len(TABLES) > 10
    assert all(table["additionalProperties"] is False for table in TABLES.values())


def sections(base=Section):
    """Yield the classes of all tables that are loaded."""
    yield base
    for section in base.__subclasses__():
        yield from sections(section)


def test_no_table_takes_a_number_that_is_none():
    """NaN and infinity are refused by every table of the schema; but `near_m` may be infinite."""
    schema()
    assert len(found := list(sections())) > 60
    assert [section for section in found if section.model_config["allow_inf_nan"]] == []
    assert load("birch_walk", ["world.near_m=inf"]).world.near_m == math.inf
