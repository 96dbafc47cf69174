"""The scene file's own description, for editors and for our error lines."""

import ast
import inspect
from functools import cache
from itertools import pairwise
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import CoreSchema
from pydantic_core.core_schema import ModelSchema

from vlp16emu.scenario.model import Scenario


class _InOurWords(GenerateJsonSchema):
    """Leave out the titles that repeat the keys, and describe keys by their docstrings.

    Pydantic's `use_attribute_docstrings` parses the source of all sections at each start of the program, for 0.1 s.
    """

    def model_schema(self, schema: ModelSchema) -> JsonSchemaValue:
        """Add the descriptions of a section's keys."""
        table, section = super().model_schema(schema), schema["cls"]
        for name, text in _docstrings(section).items():
            field = section.model_fields.get(name)
            if field is not None and field.description is None:
                table["properties"][field.alias or name]["description"] = text
        return table

    def field_title_should_be_set(self, schema: CoreSchema | Any) -> bool:  # noqa: ARG002  # pydantic's signature
        """Leave titles out: they would only repeat the keys."""
        return False


@cache
def schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a scene file; the same object every time, so do not write to it."""
    tree = Scenario.model_json_schema(schema_generator=_InOurWords)
    return {"$schema": GenerateJsonSchema.schema_dialect} | tree | {"title": "vlp16emu scene"}


def _docstrings(section: type[BaseModel]) -> dict[str, str]:
    """Return the strings that follow the keys of a section and of its base classes."""
    found: dict[str, str] = {}
    for owner in reversed(section.__mro__[: section.__mro__.index(BaseModel)]):
        try:
            source = inspect.getsource(owner)
        except OSError:  # a class without source, made from a table, describes its keys itself
            continue
        (body,) = ast.parse(source).body
        assert isinstance(body, ast.ClassDef)
        for key, text in pairwise(body.body):
            match key, text:
                case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(words))):
                    found[name] = inspect.cleandoc(words)
    return found
