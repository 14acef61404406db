"""A calibration examined: sensitivities, uncertainty and stability of the fitted values."""

from dataclasses import dataclass

from cmf_mj.studies.calibration.fit import Calibration
from cmf_mj.studies.calibration.sensitivity import Sensitivity, Spread, sensitivity, spread
from cmf_mj.studies.calibration.trial import Verdict, simulated_stability


@dataclass(frozen=True)
class Examination:
    """A calibration with its sensitivities, the spread of the velocity law, stability runs."""

    calibration: Calibration
    sensitivity: Sensitivity  #: At the shipped values.
    spread: tuple[Spread, ...]  #: About the shipped values.
    verdicts: tuple[Verdict, ...]  #: Step runs with the fitted values.


def examine(
    calibration: Calibration, *, samples: int = 128, jobs: int | None = None
) -> Examination:
    """Add sensitivities, uncertainty and the stability runs of a study that asks for them."""
    study, shipped = calibration.study, calibration.before.values
    return Examination(
        calibration,
        sensitivity(study, shipped),
        tuple(spread(study, shipped, ("original", "velocity"), samples=samples)),
        tuple(simulated_stability(study, calibration.after.values, jobs=jobs)),
    )
