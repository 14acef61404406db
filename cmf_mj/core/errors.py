"""Errors of the project: what is refused, and what went wrong in a run.

Catch `CmfError` to tell them from a defect. The command line prints their message alone.
"""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from importlib import import_module
from typing import Any


class CmfError(Exception):
    """Any error that this project raises on purpose.

    >>> try:
    ...     cmf_mj.load_law("fast.toml")
    ... except cmf_mj.CmfError as error:
    ...     print(error)
    fast.toml: cannot be read: there is no such file
    """

    __module__ = "cmf_mj"


class InputError(CmfError, ValueError):
    """Refused input; the message names the field, its value and what is allowed.

    >>> try:
    ...     cmf_mj.Hexapod("gdf")
    ... except cmf_mj.InputError as error:
    ...     print(error)
    cab: 'gdf' is not one of gfd, rfd, ifd nor a .toml file; did you mean gfd?
    """

    __module__ = "cmf_mj"


class NoPoseError(InputError):
    """Legs that no pose of the platform has, such as those of a run that flew apart.

    >>> try:
    ...     cmf_mj.legs_to_pose([1.5, 0, 0, 0, 0, 0])
    ... except cmf_mj.NoPoseError as error:
    ...     print(str(error)[:45])
    legs: no platform pose has the leg extensions
    """

    __module__ = "cmf_mj"


class NotLinearError(InputError):
    """A plant without a linearisation at a pose: overlap, dry friction, a stop that bears.

    >>> issubclass(cmf_mj.NotLinearError, cmf_mj.InputError)
    True
    """

    __module__ = "cmf_mj"


class RunError(CmfError, FloatingPointError):
    """The state of a run left its physical bounds.

    >>> issubclass(cmf_mj.RunError, cmf_mj.CmfError)
    True
    """

    __module__ = "cmf_mj"


class MissingExtraError(CmfError, ModuleNotFoundError):
    """A package of an optional extra is not installed; the message names the extra.

    >>> issubclass(cmf_mj.MissingExtraError, ModuleNotFoundError)
    True
    """

    __module__ = "cmf_mj"


@contextmanager
def within(where: object) -> Iterator[None]:
    """Put `where` the refused thing stands, such as a file, before refusals that lack it."""
    try:
        yield
    except InputError as error:
        if str(error).startswith(str(where)):
            raise
        raise InputError(f"{where}: {error}") from error


def reason(error: BaseException) -> str:
    """The message of another library's error, in one line of at most 300 characters."""
    return " ".join(str(error).split())[:300]


def require(package: str, extra: str) -> Any:
    """Import a package that comes with an optional extra of this project, or say which one."""
    try:
        return import_module(package)
    except ImportError as error:
        text = f"{package} is not installed: pip install 'cmf-mj[{extra}]'"
        raise MissingExtraError(text, name=error.name) from error


def similar(name: object, known: Iterable[str]) -> str:
    """A question for the most similar of the known names, empty where none is."""
    return "".join(f"; did you mean {match}?" for match in get_close_matches(str(name), known, 1))


def unknown_name(field: str, name: object, known: Iterable[str], more: str = "") -> InputError:
    """The error for a name that is not known: it lists those that are, and the most similar.

    `more` says what else is allowed, e.g. ` nor a .toml file`.
    """
    names = list(known)
    question = similar(name, names)
    return InputError(f"{field}: {name!r} is not one of {', '.join(names)}{more}{question}")


def check_name(field: str, name: str, known: Iterable[str], more: str = "") -> str:
    """The name, if it is known, else `unknown_name`."""
    if name not in known:
        raise unknown_name(field, name, known, more)
    return name
