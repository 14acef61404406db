"""The project's Numba decorator: compiled, lock-free, cached on disk, never stale.

Numba's cache asks whether the *file* of a function has changed, not the files of the functions it
calls. The frame loop inlines blocks from a dozen modules, so an edited valve would go on running
as it was. Here the stamp of every cached function is a digest of all sources that compiled code can
take anything from: the modules that import this one, and all they import.
"""

import hashlib
import os
import re
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numba
from numba.core import caching, codegen
from numba.core.compiler import Compiler
from numba.core.environment import lookup_environment

_PACKAGE = Path(__file__).parents[1]
_IMPORT = re.compile(
    r"^\s*from (cmf_mj(?:\.\w+)*) import (\([^)]*\)|.*)|^\s*import (cmf_mj(?:\.\w+)*)", re.MULTILINE
)


def _imported(source: str) -> set[Path]:
    """Files of the package, its root aside, that a source imports from."""
    paths = set()
    for module, names, plain in _IMPORT.findall(source):
        parts = (module or plain).split(".")[1:]
        for name in ["", *re.findall(r"\w+", names)]:
            path = _PACKAGE.joinpath(*parts, *([name] if name else []))
            paths |= {path.with_suffix(".py"), path / "__init__.py"}
    return {path for path in paths if path.is_file()} - {_PACKAGE / "__init__.py"}


def kernel_sources() -> list[Path]:
    """Files that compiled functions stand in or can take a constant or a function from."""
    texts = {path: path.read_text(encoding="utf-8") for path in _PACKAGE.rglob("*.py")}
    pending = {path for path, text in texts.items() if Path(__file__) in _imported(text)}
    reached = set()
    while pending:
        path = pending.pop()
        reached.add(path)
        pending |= _imported(texts[path]) - reached
    return sorted(reached)


@lru_cache
def _digest() -> str:
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in kernel_sources())).hexdigest()


class _PackageStamp:
    _py_file: str

    def get_source_stamp(self) -> str:
        """Digests of all sources that compiled code depends on, and of the function's own file."""
        own = hashlib.sha256(Path(self._py_file).read_bytes()).hexdigest()
        return _digest() + own * (_PACKAGE not in Path(self._py_file).parents)


class UserProvided(_PackageStamp, caching.UserProvidedCacheLocator):  # type: ignore[misc]
    """Cache in NUMBA_CACHE_DIR, where the user or `core.caches` has set it."""


class InTree(_PackageStamp, caching.InTreeCacheLocator):  # type: ignore[misc]
    """Cache next to the sources."""


class UserWide(_PackageStamp, caching.UserWideCacheLocator):  # type: ignore[misc]
    """Cache in the user's cache folder, where the sources cannot be written to."""


class _Index(caching.IndexDataCacheFile):  # type: ignore[misc]
    """Index of a cache that counts as empty where a class in its signatures has moved."""

    def _load_index(self) -> dict[Any, str]:
        try:
            overloads: dict[Any, str] = super()._load_index()
        except (AttributeError, ImportError):
            return {}
        return overloads


caching.IndexDataCacheFile = _Index
numba.config.CACHE_DIR = numba.config.CACHE_DIR or os.environ.get("NUMBA_CACHE_DIR", "")

_LOCATORS = ",".join(f"{__name__}.{c.__name__}" for c in (UserProvided, InTree, UserWide))


class _Whole(codegen.JITCodeLibrary):  # type: ignore[misc]
    """Machine code of a function with all it calls, optimised once, in one piece.

    Numba would optimise each part by itself too, which takes longer and changes nothing.
    """

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout

    def _finalize_specific(self) -> None:
        super()._finalize_specific()
        for variable in self._final_module.global_variables:
            if (environment := lookup_environment(variable.name)) is not None:
                self._codegen.set_env(variable.name, environment)


class _Part(_Whole):
    """Code of a function for its callers to take in: it never becomes machine code by itself."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        return 0

    @property
    def codegen(self) -> "_Part":
        return self

    def set_env(self, name: str, environment: Any) -> None:
        """Leave this to the whole, which alone has an address for it."""


class _Compiler(Compiler):  # type: ignore[misc]
    library: type[_Whole] = _Whole

    def __init__(self, typing: Any, target: Any, library: Any, *settings: Any) -> None:
        library = library or self.library(target.codegen(), "compiled")
        library.enable_object_caching()
        super().__init__(typing, target, library, *settings)


class _PartCompiler(_Compiler):
    library = _Part


def _cached(function: Callable[..., Any], **options: Any) -> Callable[..., Any]:
    """Compile for calls from Python, cached on disk, and as a part of what is compiled.

    What takes the arguments of a call from Python apart is most of the code of a small function
    with many arrays, and most functions are only ever called by others.
    """
    if numba.config.DISABLE_JIT:
        return function
    options |= {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
    before = numba.config.CACHE_LOCATOR_CLASSES
    numba.config.CACHE_LOCATOR_CLASSES = _LOCATORS
    try:
        whole = numba.njit(cache=True, pipeline_class=_Compiler, **options)(function)
    finally:
        numba.config.CACHE_LOCATOR_CLASSES = before
    options |= {"no_cpython_wrapper": True, "pipeline_class": _PartCompiler}
    part = numba.njit(**options)(function)
    whole.get_call_template, whole.get_overload = part.get_call_template, part.get_overload
    return whole


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function in nopython mode, without the interpreter lock, cached on disk.

    Division by zero gives infinity or NaN, as in NumPy: testing for it costs more than dividing.
    Arrays are taken as they are, without counting references, which took a seventh of a control
    frame: the function makes no array, returns none, and calls none that is `allocating`.
    """
    return _cached(function, _nrt=False)


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function into its callers, as `compiled` otherwise.

    For functions that take many arrays and are called each frame from one place: handing the
    arrays over would cost more than the work done with them.
    """
    return _cached(function, _nrt=False, forceinline=True)


def allocating(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function that makes or returns arrays; not for the frame loop."""
    return _cached(function)


@compiled
def assign(target, source):  # type: ignore[no-untyped-def]
    """Copy a vector into another of its length; `target[:] = source` would make an array."""
    for i in range(target.shape[0]):
        target[i] = source[i]
