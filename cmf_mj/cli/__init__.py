"""The command line, `cmf`: one module a family of commands."""

from cmf_mj.cli import (
    analysing,
    calibrating,
    capacities,
    comparing,
    cueing,
    driving,
    failing,
    flying,
    hosting,
    identifying,
    linearizing,
    listing,
    mapping,
    measuring,
    operating,
    reporting,
    running,
    studying,
    tuning,
    verifying,
    watching,
)
from cmf_mj.cli.common import app

__all__ = [
    "analysing",
    "calibrating",
    "capacities",
    "comparing",
    "cueing",
    "driving",
    "failing",
    "flying",
    "hosting",
    "identifying",
    "linearizing",
    "listing",
    "main",
    "mapping",
    "measuring",
    "operating",
    "reporting",
    "running",
    "studying",
    "tuning",
    "verifying",
    "watching",
]


def main() -> None:
    """Entry point of the `cmf` command."""
    app(prog_name="cmf")
