"""The command line, `cmf`: one module a group of commands, in the order a user needs them.

A command imports what it needs when it runs, so that help and completion wait for nothing.
"""

import os
import signal

# Cases run side by side: a linear algebra's own threads would only wait on the cores they need.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from cmf_mj.cli import analyse, export, facility, flight, machine, report, simulate, studies, watch  # noqa: E501, F401, I001
from cmf_mj.cli.common import app


def main() -> None:
    """Entry point of the `cmf` command."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # clean up, as after Ctrl-C
    try:
        app(prog_name="cmf")
    except KeyboardInterrupt:  # before a command has begun
        raise SystemExit(130) from None
    except ImportError as error:  # an extension that is interrupted says that it failed
        cause: BaseException | None = error
        while isinstance(cause, ImportError):
            cause = cause.__cause__
        if not isinstance(cause, KeyboardInterrupt):
            raise
        raise SystemExit(130) from None
