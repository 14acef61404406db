"""Models of all degrees of freedom: one for all, one each, or one matrix.

The report identified heave and took that model for every leg and every motion (section 4.4). Three
claims about the same run, in which all degrees of freedom move at once:

    shared   y_i = G_heave u_i        the heave model everywhere
    single   y_i = G_i u_i            a model per degree of freedom, of its command alone
    matrix   y_i = sum_j G_ij u_j     a row of the full matrix

scored by the fit (NRMSE) of their simulation to a run that was not used. All three take commands
and velocities mapped to degrees of freedom by the Jacobian (`experiment`).
"""

from dataclasses import replace
from typing import NamedTuple

from cmf_mj.analysis.identification.arx import arx
from cmf_mj.analysis.identification.data import Experiment
from cmf_mj.analysis.identification.model import Orders, PolynomialModel
from cmf_mj.analysis.identification.validation import simulation_fit
from cmf_mj.core.errors import check_name


class DofScore(NamedTuple):
    """Validation fits of one degree of freedom [%]."""

    axis: str
    shared: float  #: With the model of the shared axis.
    single: float  #: With the model of its command alone.
    matrix: float  #: With its row of the matrix.


class DofComparison(NamedTuple):
    """How well three kinds of models fit each degree of freedom."""

    scores: tuple[DofScore, ...]
    shared: str  #: The axis whose model stands for all.
    model: PolynomialModel  #: Of that axis: one input, one output.


def compare_dofs(
    estimation: Experiment,
    validation: Experiment,
    orders: Orders | tuple[int, int, int],
    *,
    shared: str = "heave",
) -> DofComparison:
    """Identify ARX models of every axis and score them on another run.

    Output i of the runs is along the axis of input i; `shared` is the axis whose model is tried
    everywhere.
    """
    axes = [name.removesuffix("_command") for name in estimation.input_names]
    common = arx(_alone(estimation, axes.index(check_name("shared", shared, axes))), orders)
    matrix_fit = simulation_fit(arx(estimation, orders), validation)
    scores = []
    for i, axis in enumerate(axes):
        run = _alone(validation, i)
        labels = {name: getattr(common, name) for name in ("input_names", "output_names")}
        everywhere = simulation_fit(common, replace(run, **labels))[0]
        single = simulation_fit(arx(_alone(estimation, i), orders), run)[0]
        scores.append(DofScore(axis, float(everywhere), float(single), float(matrix_fit[i])))
    return DofComparison(tuple(scores), shared, common)


def _alone(run: Experiment, i: int) -> Experiment:
    """Input i and output i."""
    one = slice(i, i + 1)
    return replace(
        run,
        input=run.input[:, one],
        output=run.output[:, one],
        input_names=run.input_names[one],
        output_names=run.output_names[one],
        input_units=run.input_units[one],
        output_units=run.output_units[one],
    )
