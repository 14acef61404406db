"""The command line, `cmf`: one module a family of commands."""

from cmf_mj.cli import (
    analysing,
    capacities,
    comparing,
    failing,
    hosting,
    identifying,
    linearizing,
    listing,
    mapping,
    measuring,
    operating,
    verifying,
)
from cmf_mj.cli.common import app

__all__ = [
    "analysing",
    "capacities",
    "comparing",
    "failing",
    "hosting",
    "identifying",
    "linearizing",
    "listing",
    "main",
    "mapping",
    "measuring",
    "operating",
    "verifying",
]


def main() -> None:
    """Entry point of the `cmf` command."""
    app(prog_name="cmf")
