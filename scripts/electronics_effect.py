"""What do sensors, converters and servo electronics cost? Bandwidths of every law with and without.

Writes `comparison.md` and `comparison.csv`: -90 deg and -3 dB bandwidths and peak gain on the
hexapod, ideal and with the shipped noisy electronics, and the changes between.
"""

import argparse
from pathlib import Path

from cmf_mj.cli.common import refuse
from cmf_mj.control.law import law_names
from cmf_mj.core.result import Table, number
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.studies.case import CaseResult
from cmf_mj.studies.comparison import compare

HEADER = (
    "law",
    "dof",
    "-90 deg ideal [Hz]",
    "with electronics",
    "change",
    "-3 dB ideal [Hz]",
    "with electronics",
    "change",
    "peak ideal [dB]",
    "with electronics",
    "step",
)


def _cells(before: float, after: float) -> list[str]:
    """Both bandwidths and the change; a dash where there is none."""
    change = f"{100.0 * (after / before - 1.0):+.1f} %"
    numbers = (f"{before:.2f}", f"{after:.2f}", change)
    return ["-" if "nan" in number else number for number in numbers]


def line(without: CaseResult, with_electronics: CaseResult) -> list[str]:
    """A row of the table."""
    ideal, real = without.measures, with_electronics.measures
    cells = [without.case.law.name, without.case.dof]
    for before, after in (
        (ideal.phase_bandwidth_hz, real.phase_bandwidth_hz),
        (ideal.gain_bandwidth_hz, real.gain_bandwidth_hz),
    ):
        cells += _cells(before, after)
    cells += [number(row.peak_gain_db, ".1f") for row in (ideal, real)]
    verdicts = ["stable" if row.stable else "unstable" for row in (ideal, real)]
    return [*cells, " to ".join(dict.fromkeys(verdicts))]


def main() -> None:
    """Parse the arguments, run both and write the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--laws", default="all")
    parser.add_argument("--dofs", default="heave,surge")
    parser.add_argument("--quick", action="store_true", help="sweep in 30 s instead of 100 s")
    parser.add_argument("--jobs", type=int)
    parser.add_argument("--out", type=Path, default=Path("out/electronics"))
    options = parser.parse_args()
    try:
        laws = list(law_names()) if options.laws == "all" else options.laws.split(",")
        ideal, real = (
            compare(
                laws,
                options.dofs.split(","),
                plants=["hexapod"],
                quick=options.quick,
                jobs=options.jobs,
                electronics=electronics,
            )
            for electronics in (None, ElectronicsSettings())
        )
    except (ValueError, OSError, FloatingPointError) as error:
        refuse(error)
    lines = [line(before, after) for before, after in zip(ideal, real, strict=True)]
    table = Table("", HEADER, lines)
    table.save(options.out / "comparison.csv")
    print(table.save(options.out / "comparison.md"))


if __name__ == "__main__":
    main()
