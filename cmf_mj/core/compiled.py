"""The project's Numba decorator: compiled, lock-free, cached on disk, never stale.

Numba's cache asks whether the *file* of a function has changed, not the files of the functions it
calls. The frame loop inlines blocks from a dozen modules, so an edited valve would go on running
as it was. Here the cache is a folder named after a digest of all sources that compiled code can
take anything from: the modules that import this one, and all they import. The folders of earlier
sources are removed.
"""

import hashlib
import os
import re
import shutil
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numba

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
def digest() -> str:
    """Digest of all sources that compiled code depends on."""
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in kernel_sources())).hexdigest()


@lru_cache
def _folder() -> str:
    """Where the compiled code of these sources is kept, below the cache that Numba is given."""
    cache = numba.config.CACHE_DIR or os.environ.get("NUMBA_CACHE_DIR")
    parent = Path(cache or _PACKAGE / "core" / "__pycache__")
    prefix = f"cmf_mj-{hashlib.sha256(bytes(_PACKAGE)).hexdigest()[:8]}"
    folder = parent / f"{prefix}-{digest()[:16]}"
    if not folder.is_dir():
        for old_folder in set(parent.glob(f"{prefix}-*")) - {folder}:
            shutil.rmtree(old_folder, ignore_errors=True)
    return str(folder)


def _compile(function: Callable[..., Any], **flags: bool) -> Callable[..., Any]:
    """Compile a function with flags of Numba's, to be kept in the folder of these sources."""
    if numba.config.DISABLE_JIT:
        return function
    options = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
    user_cache, numba.config.CACHE_DIR = numba.config.CACHE_DIR, _folder()
    try:
        return numba.njit(cache=True, **options, **flags)(function)
    finally:
        numba.config.CACHE_DIR = user_cache


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function in nopython mode, without the interpreter lock, cached on disk.

    Division by zero gives infinity or NaN, as in NumPy: testing for it costs more than dividing.
    Arrays are taken as they are, without counting references, which took a seventh of a control
    frame: the function makes no array, returns none, and calls none that is `allocating`.
    """
    return _compile(function, _nrt=False)


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function into its callers, as `compiled` otherwise.

    For functions that take many arrays and are called each frame from one place: handing the
    arrays over would cost more than the work done with them.
    """
    return _compile(function, _nrt=False, forceinline=True)


def allocating(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function that makes or returns arrays; not for the frame loop."""
    return _compile(function)


@compiled
def assign(target, source):  # type: ignore[no-untyped-def]
    """Copy a vector into another of its length; `target[:] = source` would make an array."""
    for i in range(target.shape[0]):
        target[i] = source[i]


@compiled
def multiply(matrix, vector, product):  # type: ignore[no-untyped-def]
    """Write a matrix (n, m) times a vector (m,)."""
    for i in range(matrix.shape[0]):
        total = 0.0
        for j in range(matrix.shape[1]):
            total += matrix[i, j] * vector[j]
        product[i] = total


@compiled
def multiply_transposed(matrix, vector, product):  # type: ignore[no-untyped-def]
    """Write the transpose of a matrix (n, m) times a vector (n,)."""
    for j in range(matrix.shape[1]):
        total = 0.0
        for i in range(matrix.shape[0]):
            total += matrix[i, j] * vector[i]
        product[j] = total
