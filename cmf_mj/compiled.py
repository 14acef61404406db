"""The project's Numba decorator: compiled, lock-free, cached on disk, never stale.

Numba's cache asks whether the *file* of a function has changed, not the files of the functions it
calls. The frame loop inlines blocks from a dozen modules, so an edited valve would go on running
as it was. Here the stamp of every cached function is a digest of all sources of the package.
"""

import hashlib
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numba
from numba.core import caching


@lru_cache
def _digest() -> str:
    sources = sorted(Path(__file__).parent.rglob("*.py"))
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in sources)).hexdigest()


class _PackageStamp:
    def get_source_stamp(self) -> str:
        """Digest of all sources of the package."""
        return _digest()


class UserProvided(_PackageStamp, caching.UserProvidedCacheLocator):  # type: ignore[misc]
    """Cache in NUMBA_CACHE_DIR, where the user has set it."""


class InTree(_PackageStamp, caching.InTreeCacheLocator):  # type: ignore[misc]
    """Cache beside the sources."""


class UserWide(_PackageStamp, caching.UserWideCacheLocator):  # type: ignore[misc]
    """Cache in the user's cache folder, where the sources cannot be written to."""


_LOCATORS = ",".join(f"{__name__}.{c.__name__}" for c in (UserProvided, InTree, UserWide))


def _cached(function: Callable[..., Any], **options: bool) -> Callable[..., Any]:
    before = numba.config.CACHE_LOCATOR_CLASSES
    numba.config.CACHE_LOCATOR_CLASSES = _LOCATORS
    try:
        return numba.njit(nogil=True, cache=True, error_model="numpy", **options)(function)
    finally:
        numba.config.CACHE_LOCATOR_CLASSES = before


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function in nopython mode, without the interpreter lock, cached on disk.

    Division by zero gives infinity or NaN, as in NumPy: testing for it costs more than dividing.
    """
    return _cached(function)


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function into its callers, as `compiled` otherwise.

    For functions that take many arrays and are called each frame from one place: handing the
    arrays over would cost more than the work done with them.
    """
    return _cached(function, forceinline=True)
