"""Each option is declared once, and Python, help and the page of settings agree on it."""

import inspect
import re
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from typing import get_type_hints

import pytest

from vlp16emu import Emulator, replay
from vlp16emu.cli.arguments import RunOptions
from vlp16emu.cli.verb import options_of_function
from vlp16emu.doors import DOORS, door
from vlp16emu.errors import InputError
from vlp16emu.run import options as runs
from vlp16emu.run.options import options_of
from vlp16emu.scenario import schema

VERBS = list(DOORS["verbs"])
CLASSES = [one for _, one in inspect.getmembers(runs, is_dataclass) if one.__module__ == runs.__name__]
METAVARS = {"_s": {"S"}, "_hz": {"HZ"}, "_m": {"M"}, "_deg": {"DEG"}, "_px": {"WxH"}}


@cache
def leaves(verb):
    """Options of a verb."""
    return list(options_of_function(door(verb, "verbs")))


def test_an_option_is_declared_once():
    """Two verbs that share a sentence of help share the declaration, and no verb has a name twice."""
    declared = {}
    for verb in VERBS:
        names = [leaf.name for leaf in leaves(verb)]
        assert len(names) == len(set(names)), verb
        for leaf in leaves(verb):
            assert declared.setdefault(leaf.option.help, leaf.option) is leaf.option, (verb, leaf.name)


@pytest.mark.parametrize("verb", VERBS)
def test_help_has_name_default_and_unit(cli, verb):
    """Each option stands in the help of its verb with its metavar and default; the metavar is the unit
    that its field names."""
    blocks = [" ".join(block.split()) for block in re.split(r"\n  (?=\S)", cli(verb, "--help").out)]
    for leaf in leaves(verb):
        name = leaf.name.partition("/")[0]  # of a pair that switches on and off
        words = [name, *(word for word in (leaf.option.metavar, "|".join(leaf.option.words)) if word)]
        line = next(block for block in blocks if block.split()[:1] == [name])
        assert all(word in line for word in words), line
        if leaf.option.shown is True and leaf.default not in (None, MISSING, True, False):
            assert f"[default: {leaf.default}]" in line
        for unit, metavars in METAVARS.items():
            assert not leaf.field.endswith(unit) or str(leaf.option.metavar).partition("|")[0] in metavars, (
                leaf
            )


@pytest.mark.parametrize("owner", CLASSES, ids=lambda one: one.__name__)
def test_python_has_the_names_and_checks_of_the_command_line(owner):
    """A field outside the limits or the words of its option is refused by Python in the name of the field."""
    given = {field.name: "1" for field in fields(owner) if field.default is MISSING}
    for one in options_of(owner):
        limit = next((limit for limit in (one.option.ge, one.option.gt) if limit is not None), None)
        wrong = "none of them" if one.option.words else None if limit is None else limit - 1
        if wrong is not None:
            with pytest.raises(InputError, match=rf"^{one.field}: found .*; expected "):
                owner(**given | {one.field: wrong})


@pytest.mark.parametrize("name", ["Record", "Send", "Replay", "Stream"])
def test_keyword_arguments_are_the_fields_of_options(name):
    """Editors and mypy know the options as keyword arguments, each with the type of its field."""
    owner = getattr(runs, f"{name}Options")
    assert get_type_hints(getattr(runs, f"{name}Keys")) == get_type_hints(owner)
    assert set(get_type_hints(runs.StreamKeys)) - set(get_type_hints(runs.LiveKeys)) == {"truth"}


def test_python_refuses_what_the_command_line_refuses(tmp_path):
    """A run of no length is no empty file: record, stream and replay refuse it, and names of no option."""
    emulator = Emulator("static_bench", threads=1)
    for call in (lambda **o: emulator.record(tmp_path / "x.pcap", **o), emulator.stream):
        with pytest.raises(
            InputError, match=r"^duration_s: found 0; expected a number above 0 and at most 604800$"
        ):
            call(duration_s=0)
        with pytest.raises(InputError, match=r"^length_s: unknown option; expected one of "):
            call(length_s=1)
    assert runs.SendOptions(speed=20).speed == 20
    with pytest.raises(InputError, match=r"^speed: found 0; expected a number at least 0\.001$"):
        runs.SendOptions(speed=0)
    with pytest.raises(InputError, match=r"^speed: found nan; expected a number at least 0\.001$"):
        replay(tmp_path / "x.pcap", speed=float("nan"))
    assert not list(tmp_path.iterdir())


def test_options_that_make_an_emulator_are_its_parameters():
    """Python has the options of the scene, the workers and the audit by the same names, with the same
    defaults but for the audit."""
    parameters = inspect.signature(Emulator).parameters
    for field in fields(RunOptions):
        assert field.name in parameters
        assert field.name == "audit" or (field.default or ()) == (parameters[field.name].default or ())


def test_options_that_are_settings_agree_with_the_page():
    """An option that changes a key of a scene has that key's limits; SETTINGS.md is made of the same
    schema."""
    keys = schema()["$defs"]["Sensor"]["properties"]
    for one in options_of(runs.StreamOptions):
        if one.field.endswith("_port"):
            key = next(
                kind for kind in (keys[one.field], *keys[one.field].get("anyOf", ())) if "maximum" in kind
            )
            assert (one.option.ge, one.option.le) == (0, key["maximum"])  # 0 asks for a free port
            assert key["minimum"] == 1
    duration = next(one for one in options_of(runs.Span) if one.field == "duration_s")
    key = schema()["properties"]["duration_s"]
    assert (duration.option.gt, duration.option.le) == (key["exclusiveMinimum"], key["maximum"])
    assert runs.StreamOptions(to="10.0.0.1:2370").receiver == ("10.0.0.1", 2370)
    with pytest.raises(InputError, match="to: found an empty text"):  # an empty variable of a script
        runs.StreamOptions(to="")


def test_annotations_may_be_text():
    """A verb of a module with `from __future__ import annotations` has its options."""
    own = {}
    exec(  # as a module of another package
        "from __future__ import annotations\n"
        "from typing import Annotated\n"
        "from vlp16emu.run.options import Option\n"
        "def verb(*, speed_s: Annotated[float, Option('Some time.', 'S', gt=0)] = 1.0) -> None: ...\n",
        own,
    )
    (option,) = options_of_function(own["verb"])
    assert (option.name, option.kind, option.default) == ("--speed", float, 1.0)
