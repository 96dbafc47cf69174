"""The hook by which numba compiles kernels for a fixed processor, and keeps those of this package as it wants them."""

import os
import sys
from importlib.machinery import ModuleSpec, PathFinder

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import ModuleType
    from typing import Any


_TARGETS = {  # targets of the x86-64 psABI and what a processor needs for them, by LLVM's names, the fastest first
    "x86-64-v3": ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe"),
    "x86-64-v2": ("popcnt", "sse4.1", "sse4.2", "ssse3"),
}


_WITHOUT_KERNELS = {"vlp16emu.pytest", "vlp16emu.kernels", "vlp16emu.kernels.hook"}
"""What may be loaded in a program that does not use us: a plugin of pytest is in every session."""


def keep_compiled() -> None:
    """Prepare numba as soon as it and this package are used, and before any kernel is; loading it here would delay each `--help`."""
    sys.meta_path.insert(0, _NumbaFinder())


def _has_kernels(name: str) -> bool:
    return name.startswith("vlp16emu.") and name not in _WITHOUT_KERNELS


class _NumbaFinder:
    """Finder of one module, numba, which is prepared right after it is loaded; or before a module of ours if that is later."""

    def find_spec(
        self, name: str, path: "Sequence[str] | None" = None, target: "ModuleType | None" = None
    ) -> ModuleSpec | None:
        """Find numba, once."""
        if "numba" in sys.modules and _has_kernels(name):
            sys.meta_path.remove(self)
            _prepare()
            return None
        if name != "numba" or not any(map(_has_kernels, list(sys.modules))):
            return None
        sys.meta_path.remove(self)
        spec = PathFinder.find_spec(name, path, target)
        if spec is not None and spec.loader is not None:
            load = spec.loader.exec_module

            def load_and_prepare(module: "ModuleType") -> None:
                load(module)
                _prepare()

            spec.loader.exec_module = load_and_prepare  # type: ignore[method-assign]
        return spec


def _prepare() -> None:
    """Set the target of all kernels, and take over those of this package."""
    from numba.core import config
    from numba.core.dispatcher import Dispatcher
    from numba.np import linalg

    # In the environment: numba reads it again whenever a variable of its own has changed.
    os.environ["NUMBA_CPU_NAME"], os.environ["NUMBA_CPU_FEATURES"] = _target()
    config.reload_config()
    if "numba.np.arraymath" not in sys.modules:
        # It would load scipy.linalg for 0.1 s only to see whether that is there; a kernel that takes it asks once more.
        ensure_blas = linalg.ensure_blas
        linalg.ensure_blas = lambda: setattr(linalg, "ensure_blas", ensure_blas)
    enable_caching = Dispatcher.enable_caching

    def enable_our_caching(dispatcher: "Any") -> None:
        """Take over a kernel of this package; leave those of a program that calls us."""
        from vlp16emu.kernels.compiler import KernelDispatcher  # here: it may be what loads numba

        if dispatcher.py_func.__module__.partition(".")[0] == "vlp16emu":
            KernelDispatcher.take_over(dispatcher)
        else:
            enable_caching(dispatcher)

    Dispatcher.enable_caching = enable_our_caching  # type: ignore[method-assign, assignment]


def _target() -> tuple[str, str]:
    """Name the processor to compile for, and what it has beyond its name.

    `VLP16EMU_TARGET` names another one, for tests; `host` is the one that this runs on.
    """
    from llvmlite import binding

    chosen, has = os.environ.get("VLP16EMU_TARGET"), binding.get_host_cpu_features()
    if chosen == "host":
        return binding.get_host_cpu_name(), has.flatten()
    best = next((name for name, needs in _TARGETS.items() if all(map(has.get, needs))), "generic")
    return chosen or best, ""
