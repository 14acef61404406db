"""Sealed changes in the second engine: `python tests/crosscheck/foreign_guides.py`.

As scripts/guides.py, but the hidden machine, a laboratory hexapod or that of `--machines`, has a
constant supply, and Exudyn records it through the tests of foreign_guides.toml. The diagnosis
simulates the data sheet's machine with the project's own engine.
"""

import sys
from pathlib import Path

from cmf_mj.facility.run import Run
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.record.record import Record
from cmf_mj.studies.guide import Bench, GuideSettings, make_bench

HERE = Path(__file__).resolve()
sys.path += [str(HERE.parents[1]), str(HERE.parents[2] / "scripts")]

import guides  # noqa: E402

from crosscheck.foreign import data_sheet  # noqa: E402
from crosscheck.machine import Machine  # noqa: E402
from crosscheck.recordings import recorded  # noqa: E402

TOLERANCE = 1e-5
"""Of steps; positions are then 0.01 um off at most, and pressures 10 Pa."""


def on_bench(guide: GuideSettings, machine: str) -> Bench:
    """A machine with a constant supply."""
    return make_bench(guide, machine, hydraulics=data_sheet(machine).parameters)


def record(run: Run) -> Record:
    """Let Exudyn do a run."""
    assert isinstance(run.plant, Hexapod)
    return recorded(run, Machine(run.plant, tolerance=TOLERANCE))


WAY = guides.Way(on_bench, record)

if __name__ == "__main__":
    many = {"changes": 30, "nothings": 60, "repetitions": 1}
    where = {"out": "out/foreign_guides", "guide": str(HERE.with_suffix(".toml"))}
    guides.main(WAY, machines="lab@2", **many, **where)
