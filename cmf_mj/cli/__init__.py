"""The command line, `cmf`: one module a group of commands, in the order a user needs them.

A command imports what it needs when it runs, so that help and completion wait for nothing.
"""

from cmf_mj.cli import simulate, watch, analyse, facility, flight, studies, report  # noqa: F401, I001
from cmf_mj.cli.common import app


def main() -> None:
    """Entry point of the `cmf` command."""
    app(prog_name="cmf")
