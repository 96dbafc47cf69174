"""All that depends on private interfaces of numba: a cache of our own, and inner kernels without code.

A kernel that is compiled because
another one calls it is code for that one only: it gets no entry from Python or C, no machine code of its own
and no file. If Python calls it later, it is compiled again in full.
"""

import sys
from collections.abc import Iterable
from functools import cache

import numba
from llvmlite import binding
from numba.core import sigutils
from numba.core.caching import NullCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, compile_result
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher
from numba.core.registry import CPUDispatcher
from numba.core.serialize import dumps

from vlp16emu.kernels.cache import KernelCache, NumbaObject


def take_over_kernels() -> None:
    """Let kernels of this package have our dispatcher and cache.

    Kernels of other programs stay with numba.
    """
    enable_caching = Dispatcher.enable_caching

    def enable_our_caching(dispatcher: CPUDispatcher) -> None:
        if dispatcher.py_func.__module__.partition(".")[0] == "vlp16emu":
            KernelDispatcher.take_over(dispatcher)
        else:
            enable_caching(dispatcher)

    Dispatcher.enable_caching = enable_our_caching  # type: ignore[method-assign, assignment]


def check_interfaces() -> None:
    """Compile a kernel that calls another one through all interfaces, store it and load it.

    Raises any exception if an interface has changed.
    """

    def twice(x: float) -> float:
        return 2.0 * x

    inner = numba.njit(nogil=True, error_model="numpy", _nrt=False, forceinline=True)(twice)
    KernelDispatcher.take_over(inner)

    def outer_function(x: float) -> float:
        return float(inner(x)) + 1.0

    outer = numba.njit(nogil=True, error_model="numpy", _nrt=False)(outer_function)
    KernelDispatcher.take_over(outer)
    result = outer.compile((numba.types.float64,))
    found = outer(2.0)
    if result is None or found != 5.0:
        raise RuntimeError(f"a kernel gives {found} instead of 5.0")
    kernel_bytes(next(iter(outer.overloads.values())))


def kernel_bytes(result: NumbaObject) -> bytes:
    """Return the stored form of a compiled kernel, for `load_kernel`.

    Its code for linking, half of numba's form, is left out.
    """
    library, described, environment, types, *_, environments = result._reduce()
    name, _, (code, _) = library
    full = [inner for inner in environments if inner.consts]  # the others name modules that are not needed
    return bytes(dumps((name, code, described, environment, types, full)))


def load_kernel(
    context: NumbaObject,
    name: str,
    code: bytes,
    described: NumbaObject,
    environment: NumbaObject,
    types: object,
    environments: Iterable[NumbaObject],
) -> object:
    """Make a kernel from its stored parts, for calls from Python.

    Its code for linking, half of the file, is not stored. Unlike `CompileResult._rebuild`, it loads nothing
    that only compilation needs.
    """
    _declare_runtime()
    codegen = context.codegen()
    library = codegen.create_library(name)
    library.enable_object_caching()
    library._set_compiled_object(code)
    library._finalize_final_module()
    codegen._engine._defined_symbols.add(described.llvm_cpython_wrapper_name)
    # LLVM calls Python for the code: what a signal's handler raises there is lost, and the kernel has no
    # address.
    if not library.get_pointer_to_function(described.llvm_cpython_wrapper_name):
        raise KeyboardInterrupt
    entry = context.get_executable(library, described, environment)
    for inner in environments:
        codegen.set_env(inner.env_name, inner)
    return compile_result(
        target_context=context,
        entry_point=entry,
        fndesc=described,
        signature=types,
        environment=environment,
        objectmode=False,
    )


@cache
def _declare_runtime() -> None:
    """Declare the functions of numba's runtime to LLVM; numba's `initialize` also compiles for 0.05 s."""
    from numba.core.runtime import _nrt_python

    for name, address in _nrt_python.c_helpers.items():
        binding.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)


class KernelDispatcher(CPUDispatcher):  # type: ignore[misc]
    """Dispatcher of a kernel."""

    depth = 0  # nesting depth of kernels that are compiled for a calling kernel

    @classmethod
    def take_over(cls, dispatcher: CPUDispatcher) -> None:
        """Convert numba's dispatcher into this class, with our cache."""
        dispatcher.__class__ = cls
        dispatcher.kept = KernelCache(dispatcher.py_func)
        dispatcher._compiler.pipeline_class = _KernelCompiler

    @property
    def _cache(self) -> NumbaObject:
        """Cache for kernels that Python calls; for inner kernels None, as files lack code for linking."""
        return NullCache() if KernelDispatcher.depth else self.kept

    def get_call_template(self, args: NumbaObject, kws: NumbaObject) -> NumbaObject:
        """Compile for a kernel that calls this one, ours or a user program's."""
        with global_compiler_lock:
            KernelDispatcher.depth += 1
            try:
                return super().get_call_template(args, kws)
            finally:
                KernelDispatcher.depth -= 1

    def compile(self, sig: NumbaObject) -> NumbaObject:
        """Compile for argument types unless already done: for Python, or as an inner kernel."""
        with global_compiler_lock:
            args, _ = sigutils.normalize_signature(sig)
            done = self.overloads.get(tuple(args))
            if done and (
                done.library is None if KernelDispatcher.depth else isinstance(done.entry_point, _Inner)
            ):
                del self.overloads[tuple(args)]
            return super().compile(sig)

    def add_overload(self, cres: NumbaObject) -> None:
        """Add a compiled kernel; only one with an entry can be called from Python."""
        if cres.entry_point is not None:
            super().add_overload(cres)
            return
        inner = cres._replace(entry_point=_Inner())
        self.targetctx.insert_user_function(inner.entry_point, cres.fndesc, [cres.library])
        self.overloads[tuple(cres.signature.args)] = inner


class _Inner:
    """Name of a kernel without entry, for its callers."""


class _KernelCompiler(Compiler):  # type: ignore[misc]
    """Numba's compiler, limited for inner kernels to the parts that calling kernels use."""

    def __init__(self, *args: NumbaObject, **options: NumbaObject) -> None:
        if "numba.np.arraymath" not in sys.modules:
            # It would load scipy.linalg (0.1 s) only to check that it exists; a kernel that uses it checks
            # again.
            from numba.np import linalg

            ensure_blas = linalg.ensure_blas
            linalg.ensure_blas = lambda: setattr(linalg, "ensure_blas", ensure_blas)
        super().__init__(*args, **options)

    def compile_extra(self, func: NumbaObject) -> NumbaObject:
        state = self.state
        state.flags.no_cfunc_wrapper = True
        if KernelDispatcher.depth:
            state.flags.no_cpython_wrapper = state.flags.no_compile = True
            state.library = _InnerLibrary(state.targetctx.codegen(), func.__qualname__)
        return super().compile_extra(func)


class _InnerLibrary(JITCodeLibrary):  # type: ignore[misc]
    """Code that is linked into callers; it has no machine code of its own in memory."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True
