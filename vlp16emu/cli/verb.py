"""Command lines for functions whose parameters are options or dataclasses of options."""

import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, fields
from types import NoneType
from typing import Annotated, Any, get_args

import typer

from vlp16emu.errors import InputError
from vlp16emu.run.options import Declared, Options, declared


def command(function: Callable[..., None]) -> Callable[..., None]:
    """Return a function for typer, with one parameter for each option of `function`.

    A parameter of `function` is `Annotated[type, Option(...)]`, or a dataclass of such fields. A nested
    dataclass is None if none of its options is given. A function without such parameters is returned
    unchanged.
    """
    parameters = inspect.signature(function, eval_str=True).parameters.values()
    options = list(options_of_function(function))
    if parameters and not options:
        return function

    def run(**keys: object) -> None:
        values = {option.name: keys[_key(option)] for option in options}
        for option in options:
            if option.kind is bool and option.default is True:  # its name negates it
                values[option.name] = not values[option.name]
        arguments = {}
        for parameter in parameters:
            arguments[parameter.name] = _value_of(parameter.name, parameter.annotation, values)
        function(**arguments)

    signature = inspect.Signature([_parameter(option) for option in options])
    run.__name__ = function.__name__
    run.__doc__ = function.__doc__
    run.__annotations__ = {key: parameter.annotation for key, parameter in signature.parameters.items()}
    run.__signature__ = signature  # type: ignore[attr-defined]
    return run


def options_of_function(function: Callable[..., None]) -> Iterator[Declared]:
    """Yield the options of a function."""
    for parameter in inspect.signature(function, eval_str=True).parameters.values():
        default = MISSING if parameter.default is inspect.Parameter.empty else parameter.default
        yield from _options_of_annotation(parameter.name, parameter.annotation, default)


def _options_of_annotation(name: str, annotation: object, default: object = MISSING) -> Iterator[Declared]:
    """Yield the option of a parameter or a field, or those of its dataclass."""
    if option := declared(name, annotation, default):
        yield option
    elif owner := _dataclass_in(annotation):
        for field in fields(owner):  # type: ignore[arg-type]
            yield from _options_of_annotation(field.name, field.type, field.default)


def _dataclass_in(annotation: object) -> type[Options] | None:
    """Return the dataclass of options in an annotation; None if there is none."""
    kinds = (annotation, *get_args(annotation))
    return next((kind for kind in kinds if isinstance(kind, type) and issubclass(kind, Options)), None)


def _value_of(name: str, annotation: object, values: Mapping[str, object]) -> object:
    """Return the value of a parameter or a field, by the values of all options.

    It is a dataclass where the annotation has one; None for an optional one if none of its options is given.
    """
    if option := declared(name, annotation):
        return values[option.name]
    owner = _dataclass_in(annotation)
    assert owner
    if NoneType in get_args(annotation) and not _is_given(name, annotation, values):
        return None
    arguments = {}
    for field in fields(owner):  # type: ignore[arg-type]
        if any(_options_of_annotation(field.name, field.type)):
            arguments[field.name] = _value_of(field.name, field.type, values)
    return owner(**arguments)


def _is_given(name: str, annotation: object, values: Mapping[str, object]) -> bool:
    """Return True if an option of an optional dataclass is given; InputError if one beside it is missing."""
    options = list(_options_of_annotation(name, annotation))
    defaults = {option.name: None if option.default is MISSING else option.default for option in options}
    given = [option for option in options if values[option.name] != defaults[option.name]]
    missing = [option for option in options if option.default is MISSING and values[option.name] is None]
    if given and missing:
        expected = f"{missing[0].name} {missing[0].option.metavar} beside it"
        raise InputError(given[0].name, f"found no {missing[0].name}", expected)
    return bool(given)


def _key(option: Declared) -> str:
    """Return the parameter name for an option; the underscore keeps `--from` from being a keyword."""
    letters = (letter if letter.isalnum() else "_" for letter in option.name)
    return "_" + "".join(letters).strip("_").lower()


def _parameter(option: Declared) -> inspect.Parameter:
    """Return the parameter from which typer makes an option or an argument."""
    meaning = option.option
    default = None if option.default is MISSING else option.default
    kind: Any = object | None  # click would read two values for a tuple

    def read(text: object) -> object:
        """Read the text of an option; other values are defaults, and stay."""
        if not isinstance(text, str) or text is default:  # typer reads defaults too
            return text
        return meaning.read(option.name, option.kind, text)

    metavar = meaning.metavar or "|".join(meaning.words)
    if option.kind is bool:
        kind = bool if option.default is not None else bool | None
        default = False if option.default is not None else None
        info = typer.Option(option.name, help=meaning.help)
    elif option.kind is list:
        kind = list[str] | None
        info = typer.Option(option.name, help=meaning.help, metavar=meaning.metavar)
    elif option.name.startswith("-"):
        info = typer.Option(
            option.name, help=meaning.help, metavar=metavar, parser=read, show_default=meaning.shown
        )
    else:
        kind = option.kind
        default = inspect.Parameter.empty
        info = typer.Argument(metavar=option.name, help=meaning.help, parser=read, show_default=False)
    annotation = Annotated[kind, info]
    return inspect.Parameter(
        _key(option), inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation
    )
