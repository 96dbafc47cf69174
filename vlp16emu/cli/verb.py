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
    parameters = inspect.signature(function).parameters.values()
    leaves = list(leaves_of(function))
    if parameters and not leaves:
        return function

    def run(**values: object) -> None:
        values = {leaf.name: values[_key(leaf)] for leaf in leaves}
        for leaf in leaves:
            if leaf.kind is bool and leaf.default is True:  # its name negates it
                values[leaf.name] = not values[leaf.name]
        function(**{one.name: _value_of(one.name, one.annotation, values) for one in parameters})

    signature = inspect.Signature([_parameter(leaf) for leaf in leaves])
    run.__name__ = function.__name__
    run.__doc__ = function.__doc__
    run.__annotations__ = {name: one.annotation for name, one in signature.parameters.items()}
    run.__signature__ = signature  # type: ignore[attr-defined]
    return run


def leaves_of(function: Callable[..., None]) -> Iterator[Declared]:
    """Yield the options of a function."""
    for one in inspect.signature(function).parameters.values():
        yield from _leaves(one.name, one.annotation, one.default)


def _dataclass_in(annotation: object) -> type[Options] | None:
    """Return the dataclass of options in an annotation; None if there is none."""
    kinds = (annotation, *get_args(annotation))
    return next((kind for kind in kinds if isinstance(kind, type) and issubclass(kind, Options)), None)


def _leaves(name: str, annotation: object, default: object) -> Iterator[Declared]:
    if one := declared(name, annotation, MISSING if default is inspect.Parameter.empty else default):
        yield one
    elif owner := _dataclass_in(annotation):
        for field in fields(owner):  # type: ignore[arg-type]
            yield from _leaves(field.name, field.type, field.default)


def _value_of(name: str, annotation: object, values: Mapping[str, object]) -> object:
    """Return a value, or a dataclass with its values.

    It is None for an optional dataclass if none of its options is given.
    """
    if one := declared(name, annotation):
        return values[one.name]
    owner = _dataclass_in(annotation)
    assert owner
    if NoneType in get_args(annotation):
        leaves = list(_leaves(name, annotation, MISSING))
        given = [
            leaf
            for leaf in leaves
            if values[leaf.name] != (None if leaf.default is MISSING else leaf.default)
        ]
        if not given:
            return None
        if missing := [leaf for leaf in leaves if leaf.default is MISSING and values[leaf.name] is None]:
            wanted = f"{missing[0].name} {missing[0].option.metavar} beside it"
            raise InputError(given[0].name, f"found no {missing[0].name}", wanted)
    named = [(field.name, field.type) for field in fields(owner)]  # type: ignore[arg-type]
    return owner(
        **{key: _value_of(key, kind, values) for key, kind in named if list(_leaves(key, kind, MISSING))}
    )


def _key(leaf: Declared) -> str:
    """Return the parameter name for an option; the underscore keeps `--from` from being a keyword."""
    return "_" + "".join(c if c.isalnum() else "_" for c in leaf.name).strip("_").lower()


def _parameter(leaf: Declared) -> inspect.Parameter:
    """Return the parameter from which typer makes an option or an argument."""
    option = leaf.option
    default = None if leaf.default is MISSING else leaf.default
    kind: Any = object | None  # click would read two values for a tuple
    if leaf.kind is bool:
        kind, default = (bool | None, None) if leaf.default is None else (bool, False)
        info = typer.Option(leaf.name, help=option.help)
    elif leaf.kind is list:
        kind = list[str] | None
        info = typer.Option(leaf.name, help=option.help, metavar=option.metavar)
    else:

        def read(text: object) -> object:  # typer reads defaults too
            return (
                option.read(leaf.name, leaf.kind, text)
                if isinstance(text, str) and text is not default
                else text
            )

        metavar = option.metavar or "|".join(option.words)
        if leaf.name.startswith("-"):
            info = typer.Option(
                leaf.name, help=option.help, metavar=metavar, parser=read, show_default=option.shown
            )
        else:
            kind = leaf.kind
            default = inspect.Parameter.empty
            info = typer.Argument(metavar=leaf.name, help=option.help, parser=read, show_default=False)
    annotation = Annotated[kind, info]
    return inspect.Parameter(
        _key(leaf), inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation
    )
