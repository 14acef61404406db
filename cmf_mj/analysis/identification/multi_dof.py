"""Models of all degrees of freedom: one for all, one each, or one matrix.

The report identified heave and took that model for every leg and every motion (section 4.4). Three
claims about the same run, in which all degrees of freedom move at once:

    shared   y_i = G_heave u_i        the heave model everywhere
    single   y_i = G_i u_i            a model per degree of freedom, of its command alone
    matrix   y_i = sum_j G_ij u_j     a row of the full matrix

scored by the fit (NRMSE) of their simulation to a run that was not used. All three take commands
and velocities mapped to degrees of freedom by the Jacobian (`experiment`).
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from cmf_mj.analysis.identification.arx import arx, as_experiments
from cmf_mj.analysis.identification.data import Experiment
from cmf_mj.analysis.identification.model import Orders, PolynomialModel
from cmf_mj.analysis.identification.validation import simulation_fit
from cmf_mj.core.errors import InputError

Fitter = Callable[[Experiment | Sequence[Experiment], Orders], PolynomialModel]


class DofScore(NamedTuple):
    """Validation fits of one degree of freedom [%]."""

    axis: str
    shared: float  #: With the model of the shared axis.
    single: float  #: With the model of its command alone.
    matrix: float  #: With its row of the matrix.


class DofComparison(NamedTuple):
    """Models per degree of freedom and how well each fits."""

    scores: tuple[DofScore, ...]
    shared: str  #: The axis whose model stands for all.
    models: tuple[PolynomialModel, ...]  #: Of each axis: one input, one output.
    matrix: PolynomialModel  #: All inputs to all outputs.


def compare_dofs(
    estimation: Experiment | Sequence[Experiment],
    validation: Experiment,
    orders: Orders | tuple[int, int, int],
    *,
    shared: str = "heave",
    fitter: Fitter = arx,
) -> DofComparison:
    """Identify models of every axis and score them on another run.

    Args:
        estimation: runs with as many outputs as inputs, output i along the axis of input i.
        validation: another run of the same signals.
        orders: of all models.
        shared: axis whose model is tried everywhere.
        fitter: `arx`, `instrumental_variable`, `output_error` or another such function.

    Raises:
        InputError: outputs that do not pair with inputs, an axis the runs do not have, or as the
            fitter does.
    """
    runs = as_experiments(estimation)
    axes = [name.removesuffix("_command") for name in runs[0].input_names]
    if len(runs[0].output_names) != len(axes):
        raise InputError(
            f"estimation: has {len(axes)} inputs and {len(runs[0].output_names)} outputs; "
            "allowed: one output an input"
        )
    if shared not in axes:
        raise InputError(f"shared: {shared!r} is not one of {', '.join(axes)}")
    chosen = Orders(*orders).check()
    alone = [_alone(runs, i) for i in range(len(axes))]
    models = [fitter(series, chosen) for series in alone]
    matrix = fitter(runs, chosen)
    matrix_fit = simulation_fit(matrix, validation)
    common = models[axes.index(shared)]
    scores = []
    for i, axis in enumerate(axes):
        (tried,) = _alone([validation], i)
        scores.append(
            DofScore(
                axis,
                float(simulation_fit(common.labelled_like(tried), tried)[0]),
                float(simulation_fit(models[i], tried)[0]),
                float(matrix_fit[i]),
            )
        )
    return DofComparison(tuple(scores), shared, tuple(models), matrix)


def _alone(runs: list[Experiment], i: int) -> list[Experiment]:
    return [run.select([run.input_names[i]], [run.output_names[i]]) for run in runs]
