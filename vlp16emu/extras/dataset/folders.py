"""Folders of walks: each lists its own files with their sha256, and the manifest joins these lists. Nothing unlisted is ever removed."""

import hashlib
import json
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path
from typing import Any

from vlp16emu.errors import OutputError, RunError, readable
from vlp16emu.extras.dataset.spec import DatasetWalk
from vlp16emu.output import OutputFile

Entry = dict[str, Any]
"""A walk in its list and in the manifest."""

PARTS = ".vlp16emu.parts"
"""Folder within the dataset in which walks are made; one that is there when a run begins is left from a run that was killed."""
_LIST = "walk.json"  # in the folder of a walk, written last: so a folder that has one is whole
_WRITTEN_BY = f"vlp16emu {version('vlp16emu')}"
_LARGEST_BYTES = 10**10


def finished(out: Path, walk: DatasetWalk) -> Entry | None:
    """Return the list of a walk if all its files are as listed, by a run that would list the same; None if it is to be made.

    OutputError if its place holds a file that is not listed, or not so: it is somebody else's.
    """
    entry = _listed(out / walk.folder)
    ours = _ours(out / walk.folder)
    if entry.items() >= identity(walk).items() and len(ours) == len(entry["files"]) + 1:
        return entry
    if strange := _files_in(out / walk.folder) - ours:
        found = f"{min(strange).relative_to(out)} is there, and no {_LIST} lists it so"
        raise OutputError(str(out), found, "a new folder, or one of an earlier run")
    return None


def list_files(folder: Path, walk: DatasetWalk, beams: int) -> Entry:
    """Write the list of a walk that is complete in a folder, and return it."""
    files = [_described(path, folder) for path in sorted(folder.rglob("*")) if path.is_file()]
    entry = identity(walk) | {"beams": beams, "files": files}
    (folder / _LIST).write_text(f"{json.dumps(entry, indent=2)}\n", encoding="utf-8")
    return entry


def take_place(made: Path, final: Path) -> None:
    """Move a complete folder to its place, from which the listed files of an earlier run go; RunError if it cannot go there."""
    try:
        # The list goes last: without it, what is left after a kill would be somebody else's.
        for path in sorted(_ours(final), key=lambda path: path.name == _LIST):
            path.unlink()
        for folder in sorted((path for path in final.rglob("*") if path.is_dir()), reverse=True):
            folder.rmdir()
        final.parent.mkdir(exist_ok=True)
        made.rename(final)
    except OSError as error:
        raise RunError(f"{final}: {error.strerror}; what is made so far is kept") from None


def check_manifest(path: Path) -> None:
    """Raise OutputError if there is a file in the place of the manifest that is none of ours."""
    if path.exists():
        expected = "the manifest of a dataset"
        with readable(path, expected, OutputError, most_bytes=_LARGEST_BYTES):
            text = path.read_text(encoding="utf-8")
        if not _is_ours(_tree(text)):
            raise OutputError(str(path), "is none of ours", expected)


def write_manifest(path: Path, entries: Iterable[Entry]) -> bytes:
    """Write the manifest of some walks, and return its bytes."""
    text = json.dumps({"written_by": _WRITTEN_BY, "walks": list(entries)}, indent=2) + "\n"
    with OutputFile(path) as file, file.writing() as opened:
        opened.write(text.encode())
    return text.encode()


def identity(walk: DatasetWalk) -> Entry:
    """Return all that decides the bytes of a walk."""
    tree = walk.scenario.model_dump(mode="json", by_alias=True, exclude_none=True)
    names = ("name", "folder", "split", "stand", "seed", "path", "sensor", "layout")
    digest = hashlib.sha256(json.dumps(tree, sort_keys=True).encode()).hexdigest()
    return {name: getattr(walk, name) for name in names} | {"written_by": _WRITTEN_BY, "scenario_sha256": digest}


def _ours(folder: Path) -> set[Path]:
    """Return the files of a folder that are as its list has them, and the list."""
    if not (entry := _listed(folder)):
        return set()
    named = [(folder / file["path"], file) for file in entry["files"]]
    return {path for path, file in named if path.is_file() and _described(path, folder) == file} | {folder / _LIST}


def _listed(folder: Path) -> Entry:
    """Return the list of a folder of ours; empty if there is none."""
    try:
        tree = _tree((folder / _LIST).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    files = tree.get("files") if _is_ours(tree) else None
    is_list = isinstance(files, list) and all(isinstance(file, dict) and "path" in file for file in files)
    return tree if is_list else {}


def _tree(text: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return None


def _is_ours(tree: Any) -> bool:
    return isinstance(tree, dict) and str(tree.get("written_by")).startswith("vlp16emu ")


def _described(path: Path, folder: Path) -> Entry:
    """Return name in a folder, size and sha256 of a file."""
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return {"path": path.relative_to(folder).as_posix(), "bytes": path.stat().st_size, "sha256": digest}


def _files_in(folder: Path) -> set[Path]:
    return {path for path in (folder, *folder.rglob("*")) if path.is_symlink() or path.is_file()}
