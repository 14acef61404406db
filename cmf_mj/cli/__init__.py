"""The command line, `cmf`: one module a family of commands."""

from cmf_mj.cli import (
    analysing,
    capacities,
    comparing,
    cueing,
    failing,
    flying,
    hosting,
    identifying,
    linearizing,
    listing,
    measuring,
    operating,
)
from cmf_mj.cli.common import app

__all__ = [
    "analysing",
    "capacities",
    "comparing",
    "cueing",
    "failing",
    "flying",
    "hosting",
    "identifying",
    "linearizing",
    "listing",
    "main",
    "measuring",
    "operating",
]


def main() -> None:
    """Entry point of the `cmf` command."""
    app(prog_name="cmf")
