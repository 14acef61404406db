"""The command line, `cmf`: one module a family of commands."""

from cmf_mj.cli import (
    analysing,
    calibrating,
    capacities,
    comparing,
    failing,
    hosting,
    identifying,
    linearizing,
    listing,
    measuring,
    operating,
    reporting,
)
from cmf_mj.cli.common import app

__all__ = [
    "analysing",
    "calibrating",
    "capacities",
    "comparing",
    "failing",
    "hosting",
    "identifying",
    "linearizing",
    "listing",
    "main",
    "measuring",
    "operating",
    "reporting",
]


def main() -> None:
    """Entry point of the `cmf` command."""
    app(prog_name="cmf")
