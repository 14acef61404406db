"""Does another engine compute the same motion? The plant and Exudyn on the same valve commands.

Errors of leg extensions and chamber pressures, and the CPU time, over the mechanical step: table,
data and figure. Needs the extra `verification`: `python tests/crosscheck --help`. With `--loops`
instead closed loops in MuJoCo by settings, against the IFToMM library of benchmark problems; with
`--crane` the hydraulic crane, a published benchmark; with `--second` numbers by other tools.
"""

import argparse
import sys
from pathlib import Path

from cmf_mj.cli.common import progress_bar, refuse, show, written_text
from cmf_mj.core.errors import CmfError, InputError

sys.path.append(str(Path(__file__).resolve().parents[1]))


def main() -> None:
    """Write `work_precision.png`, `.csv` and `.md`."""
    from crosscheck.crane_comparison import save_crane
    from crosscheck.loops import save_loops
    from crosscheck.report import save_verification, verification_table
    from crosscheck.second import save_second
    from crosscheck.verification import verify

    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cab", default="gfd", help="name or TOML file")
    parser.add_argument("--hydraulics", default="report", help="a set without losses")
    parser.add_argument("--seconds", type=float, default=4.0, help="simulated time [s]")
    parser.add_argument("--finest", type=int, default=8, help="most steps to a frame: 4, 8, 16")
    parser.add_argument("--crane", action="store_true", help="the hydraulic crane instead")
    parser.add_argument("--loops", action="store_true", help="closed loops of MuJoCo instead")
    parser.add_argument("--second", action="store_true", help="numbers by other tools instead")
    parser.add_argument("--out", type=Path, default=Path("out/verification"))
    given = parser.parse_args()
    others = (
        *((given.loops, save_loops), (given.crane, save_crane)),
        (given.second, save_second),
    )
    for chosen, save in others:
        if chosen:
            print(written_text(save(given.out), given.out))
            return
    try:
        if not 0.0 < given.seconds <= 600.0:
            raise InputError(f"seconds: {given.seconds} must be more than 0 and at most 600")
        if given.finest < 4 or given.finest & (given.finest - 1):
            raise InputError(f"finest: {given.finest} must be a power of two, at least 4")
        parts = [2**i for i in range(given.finest.bit_length())]
        with progress_bar() as progress:
            result = verify(
                given.cab, given.hydraulics, seconds=given.seconds, parts=parts, progress=progress
            )
    except CmfError as error:
        refuse(error)
    paths = save_verification(result, given.out)
    show(verification_table(result), written_text(paths, given.out))


if __name__ == "__main__":
    main()
