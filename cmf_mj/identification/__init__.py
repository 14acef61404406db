"""System identification from records: data, models, their refinement, fits and validation.

    record -> experiment -> arx | instrumental_variable | output_error -> PolynomialModel
           -> plant_response -> fit_response -> ResponseFit
    model  -> simulation_fit, residual_analysis; to_continuous -> loop_errors

Everything but the names of channels and axes is plain linear systems theory; no part of it knows
the simulator.
"""

from cmf_mj.identification.arx import Candidate, Selection, arx, select_orders
from cmf_mj.identification.continuous import from_zero_order_hold, in_field_units, to_continuous
from cmf_mj.identification.data import Experiment, experiment
from cmf_mj.identification.loop import (
    LoopErrors,
    axis_bandwidths,
    closed_loop_response,
    loop_errors,
)
from cmf_mj.identification.model import Orders, PolynomialModel, Root
from cmf_mj.identification.multi_dof import DofComparison, DofScore, compare_dofs
from cmf_mj.identification.plant_response import plant_matrix, plant_response
from cmf_mj.identification.refinement import instrumental_variable, output_error
from cmf_mj.identification.response_fit import (
    ResponseFit,
    fit_response,
    response_deviation,
    select_response_orders,
)
from cmf_mj.identification.validation import (
    Residuals,
    fit_percentage,
    residual_analysis,
    residuals,
    simulated,
    simulation_fit,
)
from cmf_mj.identification.vector_fit import vector_fit

__all__ = [
    "Candidate",
    "DofComparison",
    "DofScore",
    "Experiment",
    "LoopErrors",
    "Orders",
    "PolynomialModel",
    "Residuals",
    "ResponseFit",
    "Root",
    "Selection",
    "arx",
    "axis_bandwidths",
    "closed_loop_response",
    "compare_dofs",
    "experiment",
    "fit_percentage",
    "fit_response",
    "from_zero_order_hold",
    "in_field_units",
    "instrumental_variable",
    "loop_errors",
    "output_error",
    "plant_matrix",
    "plant_response",
    "residual_analysis",
    "residuals",
    "response_deviation",
    "select_orders",
    "select_response_orders",
    "simulated",
    "simulation_fit",
    "to_continuous",
    "vector_fit",
]
