"""The scene file's own description, for editors and for our error lines."""

from functools import cache
from typing import Any

from pydantic.json_schema import GenerateJsonSchema
from pydantic_core import CoreSchema

from vlp16emu.scenario.model import Scenario

__all__ = ["schema"]


class _WithoutTitles(GenerateJsonSchema):
    """Leave out the titles that repeat the keys."""

    def field_title_should_be_set(self, schema: CoreSchema | Any) -> bool:  # noqa: ARG002  # pydantic's signature
        """Leave titles out: they would only repeat the keys."""
        return False


@cache
def schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of a scene file; the same object every time, so do not write to it."""
    tree = Scenario.model_json_schema(schema_generator=_WithoutTitles)
    return {"$schema": GenerateJsonSchema.schema_dialect} | tree | {"title": "vlp16emu scene"}
