"""All errors in one tree; every message says where, what was found and what was expected.

The command line exits with 2 for bad input (`InputError`, `MissingExtraError`) and with 1 for a run that
failed.
"""

_LONGEST = 1_000
_LONGEST_FOUND = 120
"""Most characters shown of the parts of an error line: file or key, and finding."""


class Vlp16emuError(Exception):
    """Base of all errors that vlp16emu raises on purpose."""

    exit_code = 1


class InputError(Vlp16emuError):
    """Bad input, reported in one line; long parts are truncated.

    Parameters
    ----------
    where : file, key path, packet number or argument
    found : what was found there
    expected : what was expected; None if the finding alone is clear
    at_m : x and y in the world where it was found; None if it has no place
    """

    exit_code = 2

    def __init__(
        self, where: str, found: str, expected: str | None = None, *, at_m: tuple[float, float] | None = None
    ) -> None:
        self.at_m = at_m
        self.where = one_line(where)
        self.found = one_line(found, _LONGEST_FOUND)
        self.expected = None if expected is None else one_line(expected)
        super().__init__(where, found, expected)

    def __str__(self) -> str:
        line = f"{self.where}: {self.found}"
        return line if self.expected is None else f"{line}; expected {self.expected}"


class ScenarioError(InputError):
    """A scene file that cannot be read as a scene."""


class GeometryError(InputError):
    """A mesh, terrain or stand that cannot be scanned."""


class TrajectoryError(InputError):
    """A path or trajectory that cannot be followed."""


class PacketError(InputError):
    """Bytes that are not a VLP-16 packet."""


class CaptureError(InputError):
    """A file that is not a readable capture."""


class OutputError(InputError):
    """A file or port that cannot be opened for output."""


class MissingExtraError(Vlp16emuError):
    """An optional library is not installed.

    Parameters
    ----------
    library : name of the missing library
    extra : name of the extra that brings it
    purpose : what it is needed for
    """

    exit_code = 2

    def __init__(self, library: str, extra: str, purpose: str) -> None:
        self.library = library
        self.extra = extra
        self.purpose = purpose
        super().__init__(library, extra, purpose)

    def __str__(self) -> str:
        return f"{self.purpose} needs {self.library}: pip install 'vlp16emu[{self.extra}]'"


class RunError(Vlp16emuError):
    """A run that started well and could not be finished."""


def printable(text: str) -> str:
    """Return a text in one line, with control characters escaped.

    Text from outside, as a sentence of a receiver or the name of a file, would otherwise steer the terminal.
    """
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def one_line(text: str, most: int = _LONGEST) -> str:
    """Return a text in one line of at most `most` characters, with control characters escaped."""
    line = printable(text[: most + 1])
    return line if len(line) <= most else f"{line[: most - 3]}..."
