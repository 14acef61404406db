"""Comparisons: laws on both plants, degree of freedom by degree of freedom.

Each case is run twice: with the report's chirp, for the frequency response, and with a step, for
damping, steady-state error and stability. Cases share nothing and run on threads.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cmf_mj.control.law import Law, load_law
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.result import Field, Result
from cmf_mj.core.settings import check_distinct
from cmf_mj.core.threads import on_threads
from cmf_mj.machine.cab import load_cab
from cmf_mj.machine.geometry import DOFS
from cmf_mj.plant.hexapod import PLANTS
from cmf_mj.studies.case import AMPLITUDE, CaseResult, dof_amplitude, make_case, run_case

MEASURE_NAMES = (
    *("phase_bandwidth_hz", "gain_bandwidth_hz", "peak_gain_db"),
    *("damping_ratio", "overshoot", "steady_state_error", "stable"),
    *("later_phase_hz", "graze_from_hz", "graze_to_hz"),
)
"""Measures in the table of a comparison."""

PUBLISHED_NAMES = ("phase_bandwidth_hz", "gain_bandwidth_hz", "damping_ratio")
"""Published values in the table of a comparison."""

COMPARISON_FIELDS = (
    Field("plant", of="case.plant"),
    Field("cab", of="case.cab_name"),
    Field("hydraulics", of="case.hydraulics.name"),
    Field("law", of="case.law.name"),
    Field("dof", of="case.dof"),
    *(Field(name, form=".3g", of=f"measures.{name}") for name in MEASURE_NAMES),
    Field("small_motion_phase_hz", form=".3g"),
    *(Field(f"published_{name}", form=".3g", of=f"published.{name}") for name in PUBLISHED_NAMES),
)


def compare(
    laws: Sequence[str | Path | Law] = ("velocity", "position_error_rate", "acceleration"),
    dofs: Sequence[str] = DOFS,
    *,
    plants: Sequence[str] = PLANTS,
    amplitude: float = AMPLITUDE,
    jobs: int | None = None,
    records: str | Path | None = None,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> Result[CaseResult]:
    """Compare control laws in several degrees of freedom on both plants.

    The `laws` are names, TOML files or loaded laws, by default the law flown, and the report's two
    advances on it; `plants` are `hexapod`, `single_legs` or both, with the same hydraulics. The
    `amplitude` of the chirp is in translation [m]; rotations and steps keep the report's
    proportions to it, 0.2 deg and 1 in to 0.33 in. Results do not depend on the threads, `jobs`, by
    default one per core; `records` is a folder for the records of all runs; `progress` is called
    with (cases done, cases in all). Of the `options` `cab` of the hexapod is a name, TOML file or
    loaded cab, by default the GFD; `hydraulics` likewise, by default `hardware`, and `machine`, by
    default that of the cab, or the CMF; `quick` shortens the sweeps; `electronics`, sensors,
    converters and servo electronics, are by default ideal.

    Raises `InputError` for an argument out of range, before anything is run or written; `dofs` are
    some of surge to yaw.

    >>> comparison = cmf_mj.compare(["velocity"], ["heave"], plants=["single_legs"], quick=True)
    >>> round(comparison[0].measures.overshoot, 2)
    0.22
    >>> comparison.to_pandas()[["law", "dof", "damping_ratio"]].round(2)
            law    dof  damping_ratio
    0  velocity  heave           0.43
    """
    machine = load_cab(options.get("cab"), options.get("machine")).machine
    loaded = [load_law(law, machine) for law in laws]
    for argument, names, allowed in (("dofs", dofs, DOFS), ("plants", plants, PLANTS)):
        for name in names:
            check_name(argument, name, allowed)
        if not names:
            raise InputError(f"{argument}: is empty; choose from {', '.join(allowed)}")
    if not loaded:
        raise InputError("laws: is empty; name at least one law")
    check_distinct("laws", [law.name for law in loaded])
    if not (np.isfinite(amplitude) and 0.0 < amplitude <= 0.5):
        raise InputError(f"amplitude: {amplitude} m must be greater than 0 and at most 0.5")
    cases = [
        make_case(law, dof, plant, amplitude=dof_amplitude(dof, amplitude), **options)
        for plant in plants
        for law in loaded
        for dof in dofs
    ]
    folder = Path(records) if records is not None else None
    results = on_threads(lambda case: run_case(case, folder), cases, jobs, progress)
    return Result(results, COMPARISON_FIELDS, digits=6)
