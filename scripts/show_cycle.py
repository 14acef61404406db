"""How does the facility go up, follow its host and come down? One cycle of the operating states."""

import argparse
from pathlib import Path

from cmf_mj import Hexapod, signals
from cmf_mj.cli.common import refuse
from cmf_mj.control.states import Request, State
from cmf_mj.facility.host.stream import from_command
from cmf_mj.facility.operation import operate
from cmf_mj.show.look import save_figure
from cmf_mj.show.operation import overview_figure


def main() -> None:
    """Parse the arguments, run and draw."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--law", default="velocity_integral")
    parser.add_argument("--seconds", type=float, default=34.0, help="length of the run")
    parser.add_argument("--out", type=Path, default=Path("out/cycle.png"))
    options = parser.parse_args()
    command = signals.sine("heave", 0.05, 0.5, cycles=18.0)
    try:
        operation = operate(
            Hexapod(),
            options.law,
            from_command(command, rate=80.0),
            begin=State.OFF,
            requests=[(0.5, Request.ENGAGE), (19.0, Request.OFF)],
            seconds=options.seconds,
            record_every=8,
        )
        save_figure(overview_figure(operation.record), options.out)
    except (ValueError, OSError, FloatingPointError) as error:
        refuse(error)
    print(options.out)


if __name__ == "__main__":
    main()
