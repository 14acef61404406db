"""The command line, `cmf`: one module a group of commands, in the order a user needs them.

A command imports what it needs when it runs, so that help and completion wait for nothing.
"""

import os
import signal
import sys
import threading
from types import FrameType

# Cases run side by side: a linear algebra's own threads would only wait on the cores they need.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from cmf_mj.cli import (  # noqa: F401
    analyse,
    campaign,
    facility,
    flight,
    machine,
    simulate,
    studies,
)
from cmf_mj.cli.common import app


def main() -> None:
    """Entry point of the `cmf` command.

    An interrupt ends it with status 130, also where a library says instead that it failed, or
    where Python cannot raise it: it is sent again once what was called back has returned.
    """
    ended: list[int] = []
    hooked = False  # Python would ignore what is raised in its hook

    def send_again() -> None:
        timer = threading.Timer(0.01, os.kill, (os.getpid(), ended[-1]))
        timer.daemon = True
        timer.start()

    def end(number: int, frame: FrameType | None) -> None:
        ended.append(number)
        if hooked:
            return send_again()
        signal.default_int_handler(number, frame)

    def unraised(what: "sys.UnraisableHookArgs") -> None:
        nonlocal hooked
        if not (ended and isinstance(what.exc_value, KeyboardInterrupt)):
            return sys.__unraisablehook__(what)
        hooked = True
        send_again()
        hooked = False

    sys.unraisablehook = unraised
    signal.signal(signal.SIGTERM, end)  # clean up, as after Ctrl-C
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not one that is ignored
        signal.signal(signal.SIGINT, end)
    try:
        app(prog_name="cmf")
    except KeyboardInterrupt:  # before a command has begun
        raise SystemExit(130) from None
    except Exception:
        if not ended:
            raise
        raise SystemExit(130) from None
