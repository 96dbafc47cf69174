"""Base classes and types of the sections of a scene."""

import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    SerializerFunctionWrapHandler,
    ValidationError,
    ValidationInfo,
    model_serializer,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticKnownError
from pydantic_core.core_schema import tagged_union_schema, union_schema, with_info_plain_validator_function

from vlp16emu.doors import DOORS, Part, door, has_door, plug_ins
from vlp16emu.trees import Table, Tree

DEEPEST = 100  # greatest nesting of tables and lists, and number of names in a dotted key
_DEEP_KEY = re.compile(
    rf"""(?<![\w-])(?:(?:[\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*){{{DEEPEST}}}""", re.ASCII
)
"""A dotted key that is too deep: parsing time grows with the square of its names."""
_LONG_NUMBER = re.compile(r"\b0[xob][0-9a-fA-F_]{3500}")
"""An integer that may have more than 4300 decimal digits, which Python does not print."""


def toml(text: str) -> Tree:
    """Parse TOML.

    Raises ValueError if it is not valid, a key has more than `DEEPEST` names, or a number thousands of
    digits; RecursionError if lists or tables are nested much deeper.
    """
    for refused, what in (
        (_DEEP_KEY, f"a key with more than {DEEPEST} names"),
        (_LONG_NUMBER, "too long a number"),
    ):
        if found := refused.search(text):
            line = text.count("\n", 0, found.start()) + 1
            raise ValueError(f"{what} (at line {line})")
    return tomllib.loads(text)


class ExpectationError(ValueError):
    """What a section expects of its keys, raised by validators.

    Its text ends the error line after "expected".
    """


class Section(BaseModel):
    """A frozen table of the scenario file; an unknown key or a wrong type is an error."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)

    either_or: ClassVar[frozenset[str]] = frozenset()
    """Sets of keys that exclude one another."""

    @model_serializer(mode="wrap")
    def _without_excluded_keys(self, write: SerializerFunctionWrapHandler) -> Tree:
        """Leave out keys that another key excludes, so that a written scenario can be read again."""
        tree: Tree = write(self)
        given = self.either_or & self.model_fields_set
        ruled_out = self.either_or - given if given else frozenset()
        return {key: value for key, value in tree.items() if key not in ruled_out}


class Preset(Section):
    """A table with a key that sets the values of all keys that are not given."""

    presets: ClassVar[Mapping[str, Mapping[str, object]]]
    preset_key: ClassVar[str] = "preset"

    @model_validator(mode="before")
    @classmethod
    def _from_preset(cls, table: object) -> object:
        if not isinstance(table, dict):
            return table
        preset = table.get(cls.preset_key, cls.model_fields[cls.preset_key].default)
        return {**cls.presets.get(preset, {}), **table} if isinstance(preset, str) else table


@dataclass(frozen=True)
class OneOf:
    """Annotation of a table of one of several sections, selected by its tag.

    The section is from this or another package, or from a program.

    Only the selected section is searched and imported.
    """

    base: type[Section]
    """Base class of the sections; a class that a program defines is found by the value of its tag."""
    group: str
    """Group of `doors.DOORS`."""
    tag: str = "kind"
    """Key that selects the section."""
    default: str | None = None
    """Value of the tag in a table without it."""

    def __get_pydantic_core_schema__(self, _source: object, _handler: GetCoreSchemaHandler) -> CoreSchema:
        return with_info_plain_validator_function(self._validate)

    def __get_pydantic_json_schema__(
        self, _schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        choices = {word: section.__pydantic_core_schema__ for word, section in self.sections().items()}
        return handler(tagged_union_schema(choices, discriminator=self.tag))

    def sections(self) -> dict[object, type[Section]]:
        """Return all sections by the words that select them, ours first."""
        ours: dict[object, type[Section]] = {
            word: door(word, self.group) for word in DOORS[self.group] if has_door(word, self.group)
        }
        defined = {
            word: section
            for word, section in self._subclasses(self.base)
            if not has_door(str(word), self.group)  # loaded, and perhaps left out
        }
        return {**ours, **dict(plug_ins(self.group)), **defined}

    def _section(self, word: object) -> type[Section] | None:
        if not isinstance(word, str):
            return None
        defined = {} if word in DOORS[self.group] else dict(self._subclasses(self.base))
        if word not in defined and has_door(word, self.group):
            section: type[Section] = door(word, self.group)
            return section
        return defined.get(word)

    def _subclasses(self, base: type[Section]) -> Iterator[tuple[object, type[Section]]]:
        for section in base.__subclasses__():
            if (field := section.model_fields.get(self.tag)) is not None:
                yield from ((word, section) for word in get_args(field.annotation))
            yield from self._subclasses(section)

    def _validate(self, value: object, info: ValidationInfo) -> Section:
        if isinstance(value, self.base):
            return value
        if not isinstance(value, dict):
            raise PydanticKnownError("dict_type")
        table = value if self.default is None else {self.tag: self.default} | value
        if (section := self._section(table.get(self.tag))) is None:
            raise PydanticKnownError(
                "union_tag_invalid", {"discriminator": self.tag, "tag": "", "expected_tags": ""}
            )
        try:
            return section.model_validate(table, context=info.context)
        except ValidationError as error:  # with the word in the path, as in pydantic's own unions
            findings: list[Any] = [
                {**e, "loc": (table[self.tag], *e["loc"])} for e in error.errors(include_url=False)
            ]
            raise ValidationError.from_exception_data(error.title, findings) from None


@dataclass(frozen=True)
class LazySection:
    """Annotation of a table whose section is outside the core.

    The first scene with that table loads the section.
    """

    part: Part[type[Section]]
    """The section."""

    def __get_pydantic_core_schema__(self, _source: object, _handler: GetCoreSchemaHandler) -> CoreSchema:
        return with_info_plain_validator_function(self._validate)

    def __get_pydantic_json_schema__(
        self, _schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        # A union with one member gives a reference in the page; a section alone would be written out each
        # time.
        if not self.part.is_installed:
            return {}
        return handler(union_schema([self.section.__pydantic_core_schema__]))

    @property
    def section(self) -> type[Section]:
        """The section itself."""
        return self.part.load()

    def _validate(self, value: object, info: ValidationInfo) -> Section:
        if isinstance(value, self.section):
            return value
        return self.section.model_validate(value, context=info.context)


def _from_scene_folder(file: str, info: ValidationInfo) -> str:
    return str(Path(info.context["folder"], file)) if info.context else file


SceneFile = Annotated[str, Field(min_length=1), AfterValidator(_from_scene_folder)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]
Angle = Annotated[float, Field(ge=-180, le=180)]
Positive = Annotated[float, Field(gt=0, le=1e6)]
NonNegative = Annotated[float, Field(ge=0, le=1e6)]
"""Times and lengths; longer than any scene, of 604800 s, and than any path."""
Place = Annotated[float, Field(ge=-2e7, le=2e7)]
"""A coordinate in the world, in m; map coordinates are within half the earth's circumference."""
MapPoint = Annotated[tuple[Place, Place, Place], Field(strict=False)]  # easting, northing and height, in m
Size = Annotated[float, Field(ge=1e-3, le=1e4)]  # an extent in the world, in m
Fraction = Annotated[float, Field(ge=0, le=1)]


def merge_tables(base: Table, own: Table) -> Tree:
    """Return the keys of both tables, with the values of `own` for common ones.

    Tables of one kind are merged likewise.
    """
    both = {**base, **own}
    for key in base.keys() & own.keys():
        if isinstance(base[key], dict) and isinstance(own[key], dict) and _same_kind(base[key], own[key]):
            both[key] = merge_tables(base[key], own[key])
    return both


def _same_kind(base: Table, own: Table) -> bool:
    # a relief has its own numbers
    return "relief" not in own and bool(own.get("kind", base.get("kind")) == base.get("kind"))
