"""`vlp16emu cache`: what is kept on disk from run to run."""

from typing import Annotated

import typer

from vlp16emu.cli.arguments import AsJson
from vlp16emu.cli.start import compile_first, starting
from vlp16emu.cli.terminal import count, print_json, print_rows, size
from vlp16emu.errors import InputError

Clear = Annotated[
    bool, typer.Option("--clear", help="Remove all of it; files that are not ours stay where they are.")
]
Compile = Annotated[
    bool,
    typer.Option("--compile", help="Compile the kernels of all runs that are not there, for images and CI."),
]


def cache(*, clear: Clear = False, compile_all: Compile = False, as_json: AsJson = False) -> None:
    """Show what is kept on disk from run to run, and where.

    That is compiled kernels and what worlds were grown into. A run without them takes longer to start,
    and gives the same bytes. VLP16EMU_CACHE_DIR names another folder for worlds (`off` for none),
    VLP16EMU_CACHE_MB how much they may take, NUMBA_CACHE_DIR another one for kernels.
    """
    from vlp16emu.store import user_store

    if clear and compile_all:
        raise InputError("--compile", "found --clear", "one of both")
    if compile_all:
        with starting():
            compile_first(None)
    store = user_store()
    worlds = store.clear() if clear else store.kept()
    folders, files, used = _kernels(clear=clear)
    tree = {
        "cleared": clear,
        "worlds": {
            "folder": store.folder and str(store.folder),
            "files": worlds.files,
            "bytes": worlds.bytes,
            "most_bytes": store.most_bytes,
        },
        "kernels": {"folders": folders, "files": files, "bytes": used},
    }
    if as_json:
        print_json(tree)
        return
    limit = "" if clear else f" of at most {size(store.most_bytes)}"
    print_rows(
        "removed" if clear else "kept on disk",
        {
            "worlds": f"{count(worlds.files)} files, {size(worlds.bytes)}{limit}",
            "": str(store.folder) if store.folder else "no folder: nothing is kept",
            "kernels": f"{count(files)} files, {size(used)}",
            **{" " * (i + 1): folder for i, folder in enumerate(folders)},
        },
    )


def _kernels(*, clear: bool) -> tuple[list[str], int, int]:
    """Folders, number and bytes of compiled kernels; remove them if wanted."""
    from vlp16emu.kernel_cache import compiled_files, remove_compiled

    found = {folder: paths for folder, paths in compiled_files().items() if paths}
    used = sum(path.stat().st_size for paths in found.values() for path in paths)
    for folder in found if clear else ():
        remove_compiled(folder)
    return list(map(str, found)), sum(map(len, found.values())), used
