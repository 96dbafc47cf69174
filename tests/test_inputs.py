"""The one way in for files of users."""

import os
from pathlib import Path
from threading import Event, Thread

import numpy as np
import pytest

from vlp16emu.errors import InputError, TrajectoryError
from vlp16emu.inputs import open_input, parse_json, parsing, read_bytes, read_text, readable


def test_a_pipe_is_read_to_its_end(tmp_path):
    """A FIFO whose writer comes later is waited for, where a pipe makes sense."""
    path = tmp_path / "pipe"
    os.mkfifo(path)
    writer = Thread(target=lambda: path.write_bytes(b"x" * 300_000))
    writer.start()
    with open_input(path, "bytes", InputError, takes_pipes=True) as file:
        content = file.read()
    writer.join()
    assert content == b"x" * 300_000


def test_an_event_ends_the_wait_for_a_pipe(tmp_path):
    """A FIFO that nobody writes ends, as if empty, when the event is set."""
    path = tmp_path / "pipe"
    os.mkfifo(path)
    stop = Event()
    stop.set()
    with open_input(path, "bytes", InputError, takes_pipes=True, stop=stop) as file:
        assert file.read() == b""


def test_a_file_that_grows_is_bounded():
    """Files of the system have size 0 and content; one beyond the limit is refused while it is read."""
    with pytest.raises(InputError, match=r"found \d\d+ bytes; expected words of at most 10 bytes"):
        read_bytes(Path("/proc/self/status"), "words", InputError, most_bytes=10)


def test_nothing_stays_open(tmp_path):
    """Refused, read or interrupted: no descriptor is left."""
    path = tmp_path / "a"
    path.write_bytes(b"abc")
    os.mkfifo(tmp_path / "pipe")
    before = sum(1 for _ in Path("/proc/self/fd").iterdir())
    for most_bytes in (2, 3):
        try:
            read_bytes(path, "bytes", InputError, most_bytes=most_bytes)
        except InputError:
            assert most_bytes == 2
    with pytest.raises(KeyboardInterrupt), open_input(path, "bytes", InputError):
        raise KeyboardInterrupt
    stop = Event()
    stop.set()
    with open_input(tmp_path / "pipe", "bytes", InputError, takes_pipes=True, stop=stop):
        pass
    assert sum(1 for _ in Path("/proc/self/fd").iterdir()) == before


@pytest.mark.parametrize(
    ("fault", "found"),
    [
        (KeyError("x"), "cannot be read: 'x'"),
        (OverflowError(), "cannot be read: OverflowError"),
        (np.linalg.LinAlgError("Singular matrix\nmore"), "cannot be read: Singular matrix"),
        (RecursionError("too deep"), "cannot be read: too deep"),
        (MemoryError(), "needs more memory than there is"),
        (UnicodeDecodeError("utf-8", b"a\xff", 1, 2, "bad"), "no UTF-8 text at byte 1"),
        (OSError(5, "Input/output error"), "input/output error"),
        (OSError("Not a gzipped file"), "Not a gzipped file"),
    ],
)
@pytest.mark.parametrize("door", [parsing, readable])
def test_what_a_library_raises_is_an_input_error(tmp_path, door, fault, found):
    """Any exception while a file is read is one line of the caller's class, with its first line as reason."""
    path = tmp_path / "a.x"
    path.write_text("x")
    with pytest.raises(TrajectoryError) as caught, door(path, "an x", TrajectoryError):
        raise fault
    assert str(caught.value) == f"{path}: {found}; expected an x"


def test_our_own_errors_and_interrupts_pass(tmp_path):
    """Errors that name a line, and Ctrl-C, are left as they are."""
    for fault in (InputError("line 3", "x", "y"), KeyboardInterrupt()):
        with pytest.raises(type(fault)) as caught, parsing(tmp_path, "an x", TrajectoryError):
            raise fault
        assert caught.value is fault


def test_text_has_line_feeds_and_no_mark(tmp_path):
    """A byte order mark is dropped, and the ends of lines of Windows are line feeds."""
    path = tmp_path / "a.txt"
    path.write_bytes(b"\xef\xbb\xbfH\xc3\xb6he\r\nm\rn")
    assert read_text(path, "text", InputError) == "Höhe\nm\nn"


def test_a_link_to_itself_is_refused(tmp_path):
    """A loop of links gives the system's reason."""
    path = tmp_path / "loop"
    path.symlink_to(path)
    with pytest.raises(InputError, match="too many levels of symbolic links; expected text"):
        read_text(path, "text", InputError)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"a": "\\uD800"}', r"'\\ud800' is half a character"),
        ('["\\udc00b"]', r"'\\udc00' is half a character"),
        ("[" * 100_000, "maximum recursion depth"),
        ("{", "Expecting property name"),
        ("1" * 5000, "Exceeds the limit"),
    ],
)
def test_json_of_users_has_one_error(text, said):
    """Invalid JSON, JSON that is too deep, and lone surrogates raise ValueError, and no other exception."""
    with pytest.raises(ValueError, match=said):
        parse_json(text)


def test_escapes_of_whole_characters_are_json():
    """A pair of escapes is one character (RFC 8259, section 7), and an escaped backslash begins none."""
    assert parse_json(r'["\ud834\udd1e", "\\ud800"]') == ["\U0001d11e", r"\ud800"]
