"""What several tests share; runs are computed once a suite, by whichever worker needs one first."""

import csv
import fcntl
import os
import pickle
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import control
import numpy as np
from numpy.typing import ArrayLike, NDArray
from typer.testing import CliRunner

from cmf_mj import (
    Hexapod,
    SingleLegs,
    bandwidths,
    frequency_response,
    load_machine,
    signals,
    simulate,
)
from cmf_mj.analysis.frequency_response import Bandwidths
from cmf_mj.analysis.linear.assembly import linearize
from cmf_mj.analysis.linear.loop import closed_loop
from cmf_mj.analysis.linear.plants import leg_model
from cmf_mj.analysis.measures import Measures, measure_loop
from cmf_mj.analysis.published import published_results
from cmf_mj.cli.common import app
from cmf_mj.core.units import INCH, STANDARD_GRAVITY
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.kinematics import leg_jacobian, pose_to_legs
from cmf_mj.studies.case import AMPLITUDE, ROTATION_PER_TRANSLATION

FOLDER = "CMF_MJ_SHARED_RUNS"
"""Variable of the environment with the folder that all workers of a suite see."""

WORKING_STROKE = 37.5 * INCH  #: Leg travel of the CMF's control law either way [m] (section 3.2.1).

Result = TypeVar("Result")


def cmf(*arguments: object, code: int = 0) -> str:
    """What a line of the command prints, which ends with a status."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == code, result.output
    return result.output


def rows_of(path: Path) -> list[dict[str, str]]:
    """Rows of a CSV file by the names of its header."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def data_rows(name: str) -> list[dict[str, str]]:
    """Rows of a data file of the pages."""
    return rows_of(Path(__file__).parents[1] / "docs" / "data" / f"{name}.csv")


def axial_gravity(pose: ArrayLike) -> NDArray[np.float64]:
    """What accelerometers along the legs read at rest, n . g by the kinematics [m/s^2]."""
    rows = [-STANDARD_GRAVITY * leg_jacobian(one)[:, 2] for one in np.reshape(pose, (-1, 6))]
    return np.reshape(rows, np.shape(pose))


def projected_gravity(pose: ArrayLike, distance: float) -> NDArray[np.float64]:
    """Eq C.3, |(I - r/L P) g|, with r from the upper gimbal to the moving part's centre of mass."""
    along, length = axial_gravity(pose), pose_to_legs(pose) + load_machine().geometry.neutral
    return np.hypot(along, (1.0 - distance / length) * np.sqrt(STANDARD_GRAVITY**2 - along**2))


def once(name: str, compute: Callable[[], Result]) -> Result:
    """What `compute` gives, from the worker that computed it first."""
    folder = os.environ.get(FOLDER)
    if folder is None:
        return compute()
    target = Path(folder) / f"{name}.pickle"
    with target.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not target.exists():
            target.write_bytes(pickle.dumps(compute()))
        result: Result = pickle.loads(target.read_bytes())
    return result


@cache
def chirp_bandwidths(
    plant: str,
    law: str,
    dof: str,
    cab: str = "gfd",
    hydraulics: str = "hardware",
    cuts: int = 1,
    share: float = 1.0,
) -> Bandwidths:
    """Bandwidths by the report's chirp: 0.33 in or 0.2 deg, 0.01 to 10 Hz in 100 s.

    `cuts` mechanical steps make a frame; no gimbal opens by 10 um. `share` is of the amplitude.
    """

    def compute() -> Bandwidths:
        scale = share * (1.0 if DOFS.index(dof) < 3 else ROTATION_PER_TRANSLATION)
        machine = (
            Hexapod(cab, hydraulics, timestep=1.0 / 2048.0 / cuts)
            if plant == "hexapod"
            else SingleLegs(hydraulics)
        )
        record = simulate(machine, law, signals.chirp(dof, AMPLITUDE * scale), record_every=16)
        assert record["gimbal_error"].max() < 10e-6
        return bandwidths(frequency_response(record))

    return once(f"chirp-{plant}-{law}-{dof}-{cab}-{hydraulics}-{cuts}-{share}", compute)


def printed(table: str, law: str, of: str = "nonlinear", dof: str = "heave") -> Any:
    """A row of the report's result tables, a `Published` whose numbers are there."""
    return next(
        row
        for row in published_results()
        if (row.table, row.law, row.of, row.dof) == (table, law, of, dof)
    )


@cache
def report_leg() -> control.StateSpace:
    """One linearised leg of the `report` set."""
    return leg_model(linearize(SingleLegs("report")), 1)


class LawsOnLeg(dict[str, Measures]):
    """Laws around `report_leg`, measured when first asked for."""

    def __missing__(self, law: str) -> Measures:
        """Measure a law."""
        self[law] = measure_loop(closed_loop(law, report_leg()))
        return self[law]


SINGLE = LawsOnLeg()


def circuit(names: tuple[str, ...]) -> list[str]:
    """A way that goes from each name to each other once, back to its beginning (Hierholzer)."""
    left = {name: [other for other in names if other != name] for name in names}
    way, stack = [], [names[0]]
    while stack:
        if left[stack[-1]]:
            stack.append(left[stack[-1]].pop())
        else:
            way.append(stack.pop())
    return way[::-1]
