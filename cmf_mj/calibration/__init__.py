"""Calibration: which parameters were fitted to which published numbers, and what that is worth.

`load_study` gives a study, `calibrate` fits its free parameters, `residual_rows` puts every
printed number beside a computed one, `sensitivity` and `spread` say what a result owes to each
parameter and how far their ranges carry it.
"""

from cmf_mj.calibration.definition import Measure, Parameter, Row, Study, load_studies, load_study
from cmf_mj.calibration.fit import Calibration, Residual, Stage, calibrate, residual_rows
from cmf_mj.calibration.sensitivity import Sensitivity, Spread, sensitivity, spread
from cmf_mj.calibration.trial import (
    Measured,
    Verdict,
    least_damping,
    linear_results,
    plant_of,
    simulated_results,
    simulated_stability,
    starting_values,
)

__all__ = [
    "Calibration",
    "Measure",
    "Measured",
    "Parameter",
    "Residual",
    "Row",
    "Sensitivity",
    "Spread",
    "Stage",
    "Study",
    "Verdict",
    "calibrate",
    "least_damping",
    "linear_results",
    "load_studies",
    "load_study",
    "plant_of",
    "residual_rows",
    "sensitivity",
    "simulated_results",
    "simulated_stability",
    "spread",
    "starting_values",
]
