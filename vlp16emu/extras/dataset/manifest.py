"""The manifest of a dataset: its walks with the sha256 of each file; nothing that it does not list is ever removed."""

import hashlib
import json
import re
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from shutil import rmtree
from typing import Any

from vlp16emu.errors import OutputError, RunError, readable
from vlp16emu.extras.dataset.spec import DatasetWalk
from vlp16emu.output import OutputFile

Entry = dict[str, Any]
"""A walk in the manifest."""

_WRITTEN_BY = f"vlp16emu {version('vlp16emu')}"
_PARTS = ".parts."  # prefix of the folder in which walks are made; the manifest names the folder while it exists
_EVERY_S = 10.0  # least time between writings of the manifest, which is long if walks are many
_LARGEST_BYTES = 10**10


class Manifest:
    """The file that lists the walks of a dataset that are in their places.

    OutputError if the folder `out` has a manifest of another program, or in the place of a walk a file that is not listed.

    A walk is listed before it takes its place, so what stands there and is not listed is someone else's. Manifests of
    shares, made on other machines and copied beside it with their walks, list as well.
    """

    def __init__(self, out: Path, walks: Sequence[DatasetWalk], share: str) -> None:
        self.path, self._out, self._next_s = out / f"manifest{share}.json", out, 0.0
        before: dict[str, Entry] = {}
        for path in sorted(out.glob("manifest.*-*.json")):
            before |= self._read(path)[0]
        own, self._parts = self._read(self.path)
        before |= own
        self.entries: dict[int, Entry] = {}
        """By the number of the walk."""
        self.missing: list[DatasetWalk] = []
        self._ready: list[tuple[Path, Path, set[Path]]] = []
        for walk in walks:
            if (entry := before.get(walk.folder)) is not None:
                self.entries[walk.number] = entry
            if entry is None or not self._is_there(walk, entry):
                self.missing.append(walk)
                if strange := _files_in(out / walk.folder) - self._ours(entry):
                    found = f"{min(strange).relative_to(out)} is there, and {self.path.name} does not list it so"
                    raise OutputError(str(out), found, "a new folder, or one of an earlier run")

    @contextmanager
    def making(self) -> Iterator[Path]:
        """Yield a folder to make walks in; those that are added are in their places at the end, also after an error."""
        if self._parts:
            rmtree(self._out / self._parts, ignore_errors=True)
        try:
            with tempfile.TemporaryDirectory(prefix=_PARTS, dir=self._out, ignore_cleanup_errors=True) as parts:
                self._parts = Path(parts).name
                self._settle()
                try:
                    yield Path(parts)
                finally:
                    self._settle()
        finally:
            self._parts = None
            self.write()

    def add(self, number: int, made: Path, entry: Entry) -> None:
        """List a walk that is complete in a folder of its own, which is to take its place."""
        self._ready.append((made, self._out / entry["folder"], self._ours(self.entries.get(number))))
        self.entries[number] = entry
        if time.monotonic() >= self._next_s:
            self._settle()

    def write(self) -> bytes:
        """Write the file, and return its bytes."""
        parts = {"parts": self._parts} if self._parts else {}
        walks = [entry for _, entry in sorted(self.entries.items())]
        text = json.dumps({"written_by": _WRITTEN_BY, **parts, "walks": walks}, indent=2) + "\n"
        with OutputFile(self.path) as file, file.writing() as opened:
            opened.write(text.encode())
        return text.encode()

    def _settle(self) -> None:
        """List the walks that are ready, and move them to their places, from which files of an earlier run go one by one."""
        self.write()
        while self._ready:
            made, final, stale = self._ready.pop()
            try:
                for path in _files_in(final) & stale:
                    path.unlink()
                for folder in sorted((path for path in final.rglob("*") if path.is_dir()), reverse=True):
                    folder.rmdir()
                final.parent.mkdir(exist_ok=True)
                made.rename(final)
            except OSError as error:
                raise RunError(f"{final}: {error.strerror}; what is made so far is kept") from None
        self._next_s = time.monotonic() + _EVERY_S

    def _ours(self, entry: Entry | None) -> set[Path]:
        """Files of a walk whose content is as the manifest lists it; others are somebody else's."""
        files = [(self._out / entry["folder"] / file["path"], file) for file in entry["files"]] if entry else []
        return {path for path, file in files if _is_as_listed(path, file)}

    def _is_there(self, walk: DatasetWalk, entry: Entry) -> bool:
        """Return whether all files of a walk are as listed, by a run that would list the same."""
        return entry.items() >= identity(walk).items() and len(self._ours(entry)) == len(entry["files"])

    @staticmethod
    def _read(path: Path) -> tuple[dict[str, Entry], str | None]:
        """Read the walks of an earlier run by their folders, and the name of its folder of unfinished walks."""
        if not path.exists():
            return {}, None
        expected = "the manifest of a dataset"
        with readable(path, expected, OutputError, most_bytes=_LARGEST_BYTES):
            text = path.read_text(encoding="utf-8")
        try:
            tree = json.loads(text)
            walks = {walk["folder"]: walk for walk in tree["walks"] if _names(walk)}
            parts = tree.get("parts")
            if tree["written_by"].startswith("vlp16emu ") and re.fullmatch(r"(\.parts\.\w+)?", parts or ""):
                return walks, parts
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            pass
        raise OutputError(str(path), "is none of ours", expected)


def identity(walk: DatasetWalk) -> Entry:
    """Return all that decides the bytes of a walk."""
    tree = walk.scenario.model_dump(mode="json", by_alias=True, exclude_none=True)
    names = ("name", "folder", "split", "stand", "seed", "path", "sensor", "layout")
    digest = hashlib.sha256(json.dumps(tree, sort_keys=True).encode()).hexdigest()
    return {name: getattr(walk, name) for name in names} | {"written_by": _WRITTEN_BY, "scenario_sha256": digest}


def described(path: Path, folder: Path) -> dict[str, Any]:
    """Return name in a folder, size and sha256 of a file."""
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return {"path": path.relative_to(folder).as_posix(), "bytes": path.stat().st_size, "sha256": digest}


def _is_as_listed(path: Path, file: Mapping[str, Any]) -> bool:
    try:
        found = described(path, path.parent)
    except OSError:
        return False
    return (found["bytes"], found["sha256"]) == (file["bytes"], file["sha256"])


def _names(walk: Entry) -> list[tuple[object, ...]]:
    return [(file["path"], file["bytes"], file["sha256"]) for file in walk["files"]]


def _files_in(folder: Path) -> set[Path]:
    return {path for path in (folder, *folder.rglob("*")) if path.is_symlink() or path.is_file()}
