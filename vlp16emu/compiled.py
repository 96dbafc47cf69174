"""The hook by which numba keeps compiled kernels as this package wants them."""

import sys
from importlib.machinery import ModuleSpec, PathFinder

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import ModuleType

__all__ = ["keep_compiled"]


def keep_compiled() -> None:
    """Prepare numba as soon as it is loaded, and before any kernel is; loading it here would delay each `--help`."""
    if "numba" in sys.modules:
        _prepare()
    else:
        sys.meta_path.insert(0, _NumbaFinder())


class _NumbaFinder:
    """Finder of one module, numba, which is prepared right after it is loaded."""

    def find_spec(
        self, name: str, path: "Sequence[str] | None" = None, target: "ModuleType | None" = None
    ) -> ModuleSpec | None:
        """Find numba, once."""
        if name != "numba":
            return None
        sys.meta_path.remove(self)
        spec = PathFinder.find_spec(name, path, target)
        if spec is not None and spec.loader is not None:
            load = spec.loader.exec_module

            def load_and_prepare(module: "ModuleType") -> None:
                """Load numba."""
                load(module)
                _prepare()

            spec.loader.exec_module = load_and_prepare  # type: ignore[method-assign]
        return spec


def _prepare() -> None:
    """Set the target of all kernels and where those of this package are kept."""
    from vlp16emu.kernel_cache import prepare_numba

    prepare_numba()
