"""What does acceleration feedback do in rotation? Roll, pitch and yaw on both plants.

The question the 2014 report could not answer: its model had no moments of inertia. Runs the law
flown, position error rate feedback, and every reading of its acceleration feedback, with nominal
machines; the figures lay all of them over one another. `cmf study rotation` varies what nobody
published.
"""

import argparse
from pathlib import Path

from cmf_mj.cli.common import refuse
from cmf_mj.cli.simulate import run_comparison
from cmf_mj.plant.hexapod import PLANTS

LAWS = [
    *("velocity", "position_error_rate", "acceleration", "acceleration_eq_3_6"),
    *("acceleration_opposing", "acceleration_d2"),
]


def main() -> None:
    """Parse the arguments and run the study."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cab", default="gfd", help="gfd, rfd, ifd or a TOML file")
    parser.add_argument("--hydraulics", default="hardware", help="report, hardware or a TOML file")
    parser.add_argument("--jobs", type=int, help="threads; default one a core")
    parser.add_argument("--out", type=Path, default=Path("out/compare_rotational"))
    parser.add_argument("--quick", action="store_true", help="sweep in 30 s instead of 100 s")
    parser.add_argument("--no-records", action="store_true", help="do not keep the records")
    options = parser.parse_args()
    try:
        run_comparison(
            LAWS,
            ["roll", "pitch", "yaw"],
            options.out,
            plants=list(PLANTS),
            cab=options.cab,
            hydraulics=options.hydraulics,
            jobs=options.jobs,
            quick=options.quick,
            records=not options.no_records,
        )
    except (ValueError, OSError) as error:
        refuse(error)


if __name__ == "__main__":
    main()
