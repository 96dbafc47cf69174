"""The exception tree."""

import inspect

from vlp16emu import errors

CLASSES = [thing for _, thing in inspect.getmembers(errors, inspect.isclass) if thing.__module__ == errors.__name__]


def test_bad_input_exits_with_2_and_a_failed_run_with_1():
    """The command line's exit code follows from the class."""
    for error in CLASSES:
        is_input = issubclass(error, errors.InputError | errors.MissingExtraError)
        assert error.exit_code == (2 if is_input else 1), error


def test_an_input_error_says_where_found_and_expected():
    """The line reads `where: found; expected ...`, and stops after the finding where that says it all."""
    assert str(errors.InputError("a.toml: x", "found 3", "1 or 2")) == "a.toml: x: found 3; expected 1 or 2"
    assert str(errors.InputError("a.toml", "is empty")) == "a.toml: is empty"


def test_a_missing_extra_says_how_to_get_it():
    """The line names the library, what it is for and the command that installs it."""
    line = str(errors.MissingExtraError("matplotlib", "picture", "drawing"))
    assert line == "drawing needs matplotlib: pip install 'vlp16emu[picture]'"
