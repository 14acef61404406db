"""The command line, `cmf`: one module a family of commands."""

from cmf_mj.cli import (
    analysing,
    capacities,
    comparing,
    driving,
    failing,
    hosting,
    identifying,
    linearizing,
    listing,
    measuring,
    operating,
    running,
    watching,
)
from cmf_mj.cli.common import app

__all__ = [
    "analysing",
    "capacities",
    "comparing",
    "driving",
    "failing",
    "hosting",
    "identifying",
    "linearizing",
    "listing",
    "main",
    "measuring",
    "operating",
    "running",
    "watching",
]


def main() -> None:
    """Entry point of the `cmf` command."""
    app(prog_name="cmf")
