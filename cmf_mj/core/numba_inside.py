"""What the compiler takes of Numba's inside: names that no Numba promises to keep.

Code is optimised once, in one piece, without entries for calls from Python where there are none,
and its cache knows the sources of the functions it calls. `compiled` does without where a Numba has
not these names.
"""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba.core import caching, codegen
from numba.core.compiler import Compiler
from numba.core.environment import lookup_environment

_PACKAGE = Path(__file__).parents[1]


class _PackageStamp:
    _py_file: str
    digest: Callable[[], str]  #: Of all sources of compiled code.

    def get_source_stamp(self) -> str:
        """Digests of all sources that compiled code depends on, and of the function's own file."""
        own = hashlib.sha256(Path(self._py_file).read_bytes()).hexdigest()
        return _PackageStamp.digest() + own * (_PACKAGE not in Path(self._py_file).parents)


class UserProvided(_PackageStamp, caching.UserProvidedCacheLocator):  # type: ignore[misc]
    """Cache in NUMBA_CACHE_DIR, where the user or `core` has set it."""


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


def njit(function: Callable[..., Any], digest: Callable[[], str], **options: Any) -> Any:
    """Compile for calls from Python, cached on disk, and as a part of what is compiled.

    What takes the arguments of a call from Python apart is most of the code of a small function
    with many arrays, and most functions are only ever called by others.
    """
    _PackageStamp.digest = staticmethod(digest)
    options["no_cfunc_wrapper"] = True
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
