"""Compilation of kernels, with what numba does for functions that may be called from anywhere left out.

A kernel that is compiled because another one calls it is code for that one only: it gets no entry from Python or from C,
no machine code of its own and no file. If Python calls it one day, it is compiled again, as a whole.
"""

from typing import Any

from numba.core import sigutils
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher

from vlp16emu.kernel_cache import KernelCache


class KernelDispatcher(CPUDispatcher):  # type: ignore[misc]
    """Dispatcher of a kernel."""

    depth = 0
    """How many kernels are being compiled, one for the sake of the other."""

    @classmethod
    def take_over(cls, dispatcher: CPUDispatcher) -> None:
        """Make a dispatcher of numba one of these, with a cache of ours."""
        dispatcher.__class__ = cls
        dispatcher._cache = KernelCache(dispatcher.py_func)
        dispatcher._compiler.pipeline_class = _KernelCompiler

    def compile(self, sig: Any) -> Any:
        """Compile for types of arguments, unless that has been done; what was done for other kernels does not count."""
        with global_compiler_lock:
            types, _ = sigutils.normalize_signature(sig)
            done = self.overloads.get(tuple(types))
            if KernelDispatcher.depth == 0 and done is not None and isinstance(done.entry_point, _Inner):
                del self.overloads[tuple(types)]
            KernelDispatcher.depth += 1
            try:
                return super().compile(sig)
            finally:
                KernelDispatcher.depth -= 1

    def add_overload(self, cres: Any) -> None:
        """Take a compiled kernel in; only one with an entry can be called from Python."""
        if cres.entry_point is not None:
            super().add_overload(cres)
            return
        inner = cres._replace(entry_point=_Inner())
        self.targetctx.insert_user_function(inner.entry_point, cres.fndesc, [cres.library])
        self.overloads[tuple(cres.signature.args)] = inner


class _Inner:
    """Name of a kernel without entry, for those that call it."""


class _KernelCompiler(Compiler):  # type: ignore[misc]
    """Numba's compiler, which makes for inner kernels what other kernels take of them and nothing else."""

    def compile_extra(self, func: Any) -> Any:
        """Compile a function."""
        state = self.state
        state.flags.no_cfunc_wrapper = True
        if KernelDispatcher.depth > 1:
            state.flags.no_cpython_wrapper = state.flags.no_compile = True
            state.library = _InnerLibrary(state.targetctx.codegen(), func.__qualname__)
        return super().compile_extra(func)


class _InnerLibrary(JITCodeLibrary):  # type: ignore[misc]
    """Code that others are linked with; it has no place in the memory of machine code."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True
