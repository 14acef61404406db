"""Identification of one leg or degree of freedom from recordings or simulated runs, start to end.

The report's path (chapter 4): leg velocity from the command at the valves, position by integration,
the model closed with the law and compared with the measured loop as in Table 4-1. Orders are chosen
on a grid of ARX models by their fit to the validation run; the model is then refined.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

from cmf_mj import signals
from cmf_mj.analysis.frequency_response import FrequencyResponse, frequency_response
from cmf_mj.analysis.identification.continuous import (
    LoopErrors,
    ResponseFit,
    in_field_units,
    loop_errors,
    to_continuous,
)
from cmf_mj.analysis.identification.data import Experiment, experiment, plant_response
from cmf_mj.analysis.identification.estimation import Selection, arx, output_error, select_orders
from cmf_mj.analysis.identification.model import (
    Orders,
    PolynomialModel,
    Residuals,
    residual_analysis,
    simulation_fit,
)
from cmf_mj.analysis.measures import step_metrics
from cmf_mj.control.law import Law, law_names
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.record.record import Record
from cmf_mj.signals.signal import Command
from cmf_mj.studies.case import Case, dof_amplitude

Method = Literal["arx", "oe"]
Signal = Literal["multisine", "chirp", "noise", "pulse", "sine"]

SHARE = 0.6  #: Part of a single run that is fitted; the rest validates.

HIGHEST = 16.0  #: Highest frequency of the simulated broad excitations [Hz], above the oil modes.

_GRID = {"na": range(2, 8), "nb": range(1, 7), "nk": range(0, 3)}
_BROAD = ("multisine", "chirp", "noise")


@dataclass(frozen=True)
class Identified:
    """A model of one axis with everything that judges it."""

    axis: str
    law: str  #: Name; empty where it is not known.
    selection: Selection | None  #: Orders tried; None where the caller chose them.
    model: PolynomialModel
    validation: Experiment
    estimation_fit: float  #: Of the simulated model to the fitted runs, the least [%].
    validation_fit: float  #: To the run that was not fitted [%].
    residuals: Residuals  #: Of the validation run.
    continuous: ResponseFit  #: Leg velocity per full command [m/s].
    response: FrequencyResponse | None
    """Measured from command to velocity, of the last broad run; None without one."""
    loop: LoopErrors | None  #: Closed with the law; None without a law or a broad run.


def identify(
    records: Sequence[Record],
    axis: str,
    *,
    method: Method = "oe",
    orders: Orders | tuple[int, int, int] | None = None,
    law: str | Law | None = None,
    step: Record | None = None,
) -> Identified:
    """Identify leg velocity from valve command along a leg or degree of freedom.

    The last record validates, the others are fitted jointly; of a single one the first `SHARE` is
    fitted. `axis` is surge to yaw, or leg_1 and so on; `method` is `arx` or `oe`. Default orders
    are the fewest parameters of an ARX grid within 0.2 % of the best validation fit, without poles
    at the Nyquist frequency, which no machine has and given orders are refused for. `law` drove
    the records, by default the shipped one they name; `step` is a step under it, to compare the
    loop's damping with.
    """
    check_name("method", method, get_args(Method))
    if not records:
        raise InputError("records: none given; at least one is needed")
    series = [experiment(record, axis) for record in records]
    *estimation, validation = series if len(series) > 1 else series[0].split(SHARE)
    fit, selection = {"arx": arx, "oe": output_error}[method], None
    if orders is None:
        selection = select_orders(estimation, validation, **_GRID)
        orders = selection.best().orders
    model = fit(estimation, Orders(*orders))
    while poles := model.nyquist_poles:
        left = () if selection is None else selection.without(model.orders)
        if not left:
            where = f"a pole at {poles[0]:.3f}, the Nyquist frequency of {0.5 / model.step:g} Hz"
            raise InputError(f"orders: {tuple(orders)} put {where}; allowed: others")
        selection = Selection(left)
        model = fit(estimation, selection.best().orders)
    continuous = to_continuous(model)
    broad = [r for r in records if r.signal.kind in _BROAD]
    recorded = records[-1].metadata.get("law")
    name = law if law is not None else (str(recorded) if recorded in law_names() else None)
    loop = None
    if broad and name is not None:
        measured = frequency_response(broad[-1], axis)
        stepped = None if step is None else step_metrics(step, axis)
        loop = loop_errors(in_field_units(continuous.rational), name, measured, stepped)
    called = name.name if isinstance(name, Law) else (name or "")
    return Identified(
        *(axis, called, selection, model, validation),
        min(float(simulation_fit(model, run)[0]) for run in estimation),
        float(simulation_fit(model, validation)[0]),
        residual_analysis(model, validation),
        continuous,
        plant_response(broad[-1], axis) if broad else None,
        loop,
    )


def excitation(kind: Signal, dof: str, amplitude: float | None = None, *, seed: int = 0) -> Command:
    """A command to identify from, along one degree of freedom.

    `multisine` and `noise` reach 16 Hz, `pulse` takes 1 s, `sine` has 1 Hz. `amplitude` is the peak
    [m or rad], by default the report's 0.33 in or 0.2 deg.
    """
    check_name("signal", kind, get_args(Signal))
    size = dof_amplitude(dof) if amplitude is None else amplitude
    options: dict[str, dict[str, Any]] = {
        "multisine": {"stop": HIGHEST, "spectrum": "acceleration", "fade": 1.0, "seed": seed},
        "noise": {"stop": HIGHEST, "duration": 60.0, "seed": seed},
        "sine": {"frequency": 1.0},
    }
    command: Command = getattr(signals, kind)(dof, size, **options.get(kind, {}))
    return command


def simulated_records(case: Case, kind: Signal = "multisine") -> list[Record]:
    """A run to fit and one of another multisine to validate."""
    fitted = excitation(kind, case.dof, case.size)
    return [case.run(fitted), case.run(excitation("multisine", case.dof, case.size, seed=1))]
