"""Identification of one leg or degree of freedom from recordings, start to end.

The report's path (chapter 4): leg velocity from the command at the valves. Orders are chosen on a
grid of ARX models by their fit to the run held back; the method asked for then fits the box.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Literal, get_args

from cmf_mj.analysis.frequency_response import FrequencyResponse
from cmf_mj.analysis.identification import (
    BlackBox,
    Continuous,
    Experiment,
    Orders,
    arx,
    experiment,
    fit_percentage,
    output_error,
    plant_response,
    residual_analysis,
    select_orders,
    simulated,
    to_continuous,
)
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.record.record import Record

Method = Literal["arx", "oe"]

SHARE = 0.6  #: Part of a single run that is fitted; the rest validates.

_GRID = [Orders(*one) for one in product(range(2, 8), range(1, 7), range(3))]
_BROAD = ("multisine", "chirp", "noise")


@dataclass(frozen=True)
class Identified:
    """A box of one axis with everything that judges it."""

    axis: str
    box: BlackBox
    validation: Experiment
    estimation_fit: float  #: Of the simulated box to the fitted runs, the least [%].
    validation_fit: float  #: To the run that was not fitted [%].
    residuals: tuple[float, float]  #: Shares of the validation run, see `residual_analysis`.
    continuous: Continuous
    response: FrequencyResponse | None  #: Measured, of the last broad run; None without one.


def identify(
    records: Sequence[Record],
    axis: str,
    *,
    method: Method = "oe",
    orders: tuple[int, int, int] | None = None,
) -> Identified:
    """Identify leg velocity from valve command along a leg or degree of freedom.

    The last record validates, the others are fitted jointly; of a single one the first `SHARE` is
    fitted. `axis` is surge to yaw, or leg_1 and so on; `method` is `arx` or `oe`. Orders are by
    default the fewest parameters of an ARX grid within 0.2 % of the best fit to the last record.
    """
    check_name("method", method, get_args(Method))
    if not records:
        raise InputError("records: none given; at least one is needed")
    runs = [experiment(record, axis) for record in records]
    *fitted, validation = runs if len(runs) > 1 else runs[0].split(SHARE)
    chosen = orders or select_orders(fitted, validation, _GRID)[0][0]
    box = {"arx": arx, "oe": output_error}[method](fitted, chosen)
    broad = [record for record in records if record.signal.kind in _BROAD]
    fits = [fit_percentage(run.output, simulated(box, run)) for run in (*fitted, validation)]
    return Identified(
        *(axis, box, validation, min(fits[:-1]), fits[-1]),
        *(residual_analysis(box, validation), to_continuous(box)),
        plant_response(broad[-1], axis) if broad else None,
    )
