"""Errors of the project: what is refused, and what went wrong in a run.

Catch `CmfError` to tell them from a defect. The command line prints their message alone.
"""


class CmfError(Exception):
    """Any error that this project raises on purpose."""


class InputError(CmfError, ValueError):
    """Refused input; the message names the field, its value and what is allowed."""


class RunError(CmfError, FloatingPointError):
    """The state of a run left its physical bounds."""


class MissingExtraError(CmfError, ImportError):
    """A package of an optional extra is not installed; the message names the extra."""
