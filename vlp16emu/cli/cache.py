"""`vlp16emu cache`: what is kept on disk from run to run."""

from typing import Annotated, Any

from vlp16emu.cli.arguments import AsJson
from vlp16emu.cli.printer import count, print_json, print_rows, size
from vlp16emu.cli.start import compile_first
from vlp16emu.errors import InputError
from vlp16emu.options import Option


def cache(
    *,
    clear: Annotated[bool, Option("Remove all of it; files that are not ours stay where they are.")] = False,
    compile_all: Annotated[
        bool, Option("Compile the kernels of all runs that are not there, for images and CI.", name="--compile")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Show what is kept on disk from run to run, and where.

    That is compiled kernels and what worlds were grown into. A run without them takes longer to start,
    and gives the same bytes. VLP16EMU_CACHE_DIR names another folder for worlds (`off` for none),
    VLP16EMU_CACHE_MB how much they may take, NUMBA_CACHE_DIR another one for kernels.
    """
    from vlp16emu.kernels.cache import user_kernels
    from vlp16emu.store import user_store

    if clear and compile_all:
        raise InputError("--compile", "found --clear", "one of both")
    if compile_all:
        compile_first(None)
    tree: dict[str, Any] = {"cleared": clear}
    rows = {}
    for name, kept in ("worlds", user_store()), ("kernels", user_kernels()):
        files, used = kept.clear() if clear else kept.kept()
        folder = str(kept.folder) if kept.folder else None
        tree[name] = {"folder": folder, "files": files, "bytes": used, "most_bytes": kept.most_bytes}
        limit = "" if clear else f" of at most {size(kept.most_bytes)}"
        rows[name] = f"{count(files)} files, {size(used)}{limit}, in {folder or 'no folder: nothing is kept'}"
    if as_json:
        print_json(tree)
    else:
        print_rows("removed" if clear else "kept on disk", rows)
