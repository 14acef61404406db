"""Errors of the project: what is refused, and what went wrong in a run.

Catch `CmfError` to tell them from a defect. The command line prints their message alone.
"""


class CmfError(Exception):
    """Any error that this project raises on purpose."""

    __module__ = "cmf_mj"


class InputError(CmfError, ValueError):
    """Refused input; the message names the field, its value and what is allowed."""

    __module__ = "cmf_mj"


class RunError(CmfError, FloatingPointError):
    """The state of a run left its physical bounds."""

    __module__ = "cmf_mj"


class MissingExtraError(CmfError, ImportError):
    """A package of an optional extra is not installed; the message names the extra."""

    __module__ = "cmf_mj"
