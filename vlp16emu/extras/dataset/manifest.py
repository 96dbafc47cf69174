"""The list of the files of each walk, `walk.json`, which the manifest of the dataset joins.

A list comes from a folder of the user: its paths stay inside the folder of the walk, and a file counts as
listed only if its size and sha256 are those of the list.
"""

import hashlib
import json
import os
import re
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path, PurePosixPath

from vlp16emu.errors import InputError, OutputError, RunError
from vlp16emu.extras.dataset.spec import DatasetWalk
from vlp16emu.inputs import open_input, parse_json, read_text
from vlp16emu.output import OutputFile
from vlp16emu.trees import Tree

Entry = Tree
"""A walk in its list and in the manifest."""

MANIFEST = "manifest.json"
LIST = "walk.json"  # written last: a folder that has it is complete
WRITTEN_BY = f"vlp16emu {version('vlp16emu')}"
_KEYS = {"path", "bytes", "sha256"}
_HEAD = re.compile(rb'\{\s*"written_by": "vlp16emu [^"]*",\s*"walks": \[')
_HEAD_BYTES = 200
_TAIL = b"]\n}\n"
"""First and last bytes of a manifest that `write_manifest` has written."""


def identity(walk: DatasetWalk) -> Entry:
    """Return all inputs that determine the bytes of a walk."""
    tree = walk.scenario.model_dump(mode="json", by_alias=True, exclude_none=True)
    names = ("name", "folder", "split", "stand", "seed", "path", "sensor", "layout")
    digest = hashlib.sha256(json.dumps(tree, sort_keys=True).encode()).hexdigest()
    entry = {name: getattr(walk, name) for name in names}
    return entry | {"written_by": WRITTEN_BY, "scenario_sha256": digest}


def complete_entry(out: Path, walk: DatasetWalk) -> Entry | None:
    """Return the list of a walk if all its files agree with it and the walk is the same; None if not.

    OutputError if its folder has a file that is not listed, or differs from the list, as it may be a user's
    file; or if the folder is reached through a link.
    """
    folder = out / walk.folder
    if _real(folder) != _real(out) / walk.folder:
        raise OutputError(str(out), f"{walk.folder} is reached through a link", "folders inside it")
    entry = listed(out, walk)
    intact = _intact_files(folder)
    if entry and len(intact) == len(entry["files"]) + 1:
        return entry
    present = {path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir()}
    if strange := present - intact:
        found = f"{min(strange).relative_to(out)} is there, and no {LIST} lists it so"
        raise OutputError(str(out), found, "a new folder, or one of an earlier run")
    if folder.exists() and not folder.is_dir():
        raise OutputError(
            str(out), f"{walk.folder} is there, and is no folder", "a new folder, or one of an earlier run"
        )
    return None


def listed(out: Path, walk: DatasetWalk) -> Entry | None:
    """Return the list of a walk if it is a list of the same walk; its files are not checked. None if not."""
    entry = read_list(out / walk.folder)
    return entry if entry.items() >= identity(walk).items() else None


def write_list(folder: Path, entry: Entry) -> None:
    """Write the list of a walk into its folder; raises OSError."""
    (folder / LIST).write_text(f"{json.dumps(entry, indent=2)}\n", encoding="utf-8")


def described_files(folder: Path) -> list[Entry]:
    """Return path, size and sha256 of all files of a folder."""
    return [_description(path, folder) for path in sorted(folder.rglob("*")) if path.is_file()]


def take_place(made: Path, final: Path) -> None:
    """Move a complete folder to its place, after removal of the listed files of an earlier run.

    Raises RunError if that fails.
    """
    try:
        # The list is removed last: without it, files that are left after a kill would count as a user's.
        for path in sorted(_intact_files(final), key=lambda path: path.name == LIST):
            path.unlink()
        for folder in sorted((path for path in final.rglob("*") if path.is_dir()), reverse=True):
            folder.rmdir()
        final.parent.mkdir(exist_ok=True)
        made.rename(final)
    except OSError as error:
        raise RunError(f"{final}: {error.strerror}; what is made so far is kept") from None


def check_manifest(path: Path) -> None:
    """Raise OutputError if a file that is no manifest is in the place of the manifest."""
    if not os.path.lexists(path):
        return
    expected = "the manifest of a dataset"
    # A manifest may have gigabytes: only its ends are read.
    with open_input(path, expected, OutputError, most_bytes=None, takes_all=True) as file:
        head = file.read(_HEAD_BYTES)
        file.seek(-min(len(_TAIL), len(head)), os.SEEK_END)
        tail = file.read(len(_TAIL))
    if not _HEAD.match(head) or tail != _TAIL:
        raise OutputError(str(path), "is none of ours", expected)


def write_manifest(path: Path, entries: Iterable[Entry]) -> str:
    """Write the manifest and return its sha256; raises the errors of `OutputFile`."""
    text = json.dumps({"written_by": WRITTEN_BY, "walks": list(entries)}, indent=2) + "\n"
    with OutputFile(path) as file, file.writing() as opened:
        opened.write(text.encode())
    return hashlib.sha256(text.encode()).hexdigest()


def is_list_of_files(files: object) -> bool:
    """Return True for a list of tables with path, size and sha256 whose paths stay inside a folder."""
    return isinstance(files, list) and all(
        isinstance(file, dict) and file.keys() == _KEYS and _stays_inside(file["path"]) for file in files
    )


def _stays_inside(path: object) -> bool:
    """Return True for a relative path in its shortest form, without `..`, other than that of the list."""
    if not isinstance(path, str) or "\0" in path:
        return False
    pure = PurePosixPath(path)
    return str(pure) == path and not pure.is_absolute() and ".." not in pure.parts and path not in {".", LIST}


def _intact_files(folder: Path) -> set[Path]:
    """Return the files of a folder that agree with its list, and the list itself."""
    if not (entry := read_list(folder)):
        return set()
    return {folder / file["path"] for file in entry["files"] if _agrees(folder, file)} | {folder / LIST}


def _agrees(folder: Path, file: Entry) -> bool:
    """Return True if a file of a folder has the size and sha256 of its entry, and is reached by no link."""
    path = folder / file["path"]
    try:
        is_file = path.is_file()
    except OSError:  # a name that is too long for a file
        return False
    # What is reached through a link may be anybody's.
    if not is_file or _real(path) != _real(folder) / file["path"]:
        return False
    return path.stat().st_size == file["bytes"] and _description(path, folder) == file


def read_list(folder: Path) -> Entry:
    """Return the list of a walk's folder; empty if there is none, or one that no dataset has written."""
    path = folder / LIST
    if path.is_symlink():
        return {}
    try:
        tree = _parse(read_text(path, "the list of a walk", InputError))
    except InputError:
        return {}
    return tree if is_list_of_files(tree.get("files")) else {}


def _real(path: Path) -> Path:
    """Return a path without links; `Path.resolve` fails for a loop of links."""
    return Path(os.path.realpath(path))


def _parse(text: str) -> Entry:
    """Return a JSON table that a dataset has written; empty for other text."""
    try:
        tree = parse_json(text)
    except ValueError:
        return {}
    return tree if isinstance(tree, dict) and str(tree.get("written_by")).startswith("vlp16emu ") else {}


def _description(path: Path, folder: Path) -> Entry:
    """Return path, size and sha256 of a file in a folder."""
    with open_input(path, "a file of a dataset", InputError, most_bytes=None, takes_all=True) as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return {"path": path.relative_to(folder).as_posix(), "bytes": path.stat().st_size, "sha256": digest}
