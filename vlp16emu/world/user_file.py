"""Reading what the user brings: one kind of error, whatever goes wrong with the file itself."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from vlp16emu.errors import GeometryError

__all__ = ["readable"]


@contextmanager
def readable(path: Path, expected: str) -> Iterator[None]:
    """Tell a file that cannot be read, or is no text where text is read, as a `GeometryError`."""
    try:
        yield
    except OSError as error:
        raise GeometryError(str(path), (error.strerror or "cannot be read").lower(), expected) from None
    except UnicodeDecodeError as error:
        raise GeometryError(str(path), f"no UTF-8 text at byte {error.start}", expected) from None
