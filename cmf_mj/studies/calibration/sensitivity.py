"""A calibration examined: what a result owes to each parameter, how far their ranges carry it.

    S = d ln(result) / d ln(parameter),    central difference of the linear loop over +-2 %

for bandwidths and damping ratios alike: 0.5 means that one per cent more of the parameter gives
half a per cent more of the result. The ranges are propagated by a Latin hypercube over all
parameters at once, uniform and independent between `low` and `high`.
"""

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from cmf_mj.core.errors import InputError
from cmf_mj.studies.calibration.definition import MEASURES, Measure, Study, computed
from cmf_mj.studies.calibration.fit import Calibration
from cmf_mj.studies.calibration.trial import Values, Verdict, linear_results, simulated_stability

STEP = 0.02
"""Relative half width of the central difference."""

ENDS = (0.05, 0.95)
"""Quantiles that bound a spread."""


class Sensitivity(NamedTuple):
    """Normalised derivatives of the results of a study."""

    laws: tuple[str, ...]
    parameters: tuple[str, ...]
    derivative: NDArray[np.float64]
    """(laws, `MEASURES`, parameters); NaN where the loop has no such result."""


class Spread(NamedTuple):
    """Distribution of one result over the ranges of the parameters."""

    law: str
    measure: Measure
    nominal: float  #: At the nominal values [Hz or 1].
    low: float  #: 5 % of the stable samples lie below.
    high: float  #: 95 % of the stable samples lie below.
    unstable: float  #: Share of samples whose loop is unstable.


class Examination(NamedTuple):
    """A calibration with its sensitivities, the spread of the velocity law, stability runs."""

    calibration: Calibration
    sensitivity: Sensitivity  #: At the shipped values.
    spread: list[Spread]  #: About the shipped values.
    verdicts: list[Verdict]  #: Step runs with the fitted values.


def examine(
    calibration: Calibration, *, samples: int = 128, jobs: int | None = None
) -> Examination:
    """Add sensitivities, uncertainty and the stability runs of a study that asks for them."""
    study, shipped = calibration.study, calibration.before.values
    return Examination(
        calibration,
        sensitivity(study, shipped),
        spread(study, shipped, ("original", "velocity"), samples=samples),
        simulated_stability(study, calibration.after.values, jobs=jobs),
    )


def sensitivity(study: Study, values: Values, laws: tuple[str, ...] = ()) -> Sensitivity:
    """Normalised derivatives about some values."""
    chosen = laws or study.laws
    names = tuple(parameter.name for parameter in study.parameters)
    slopes = np.full((len(chosen), len(MEASURES), len(names)), np.nan)
    for k, name in enumerate(names):
        ends = []
        for sign in (-1.0, 1.0):
            moved = dict(values) | {name: values[name] * (1.0 + sign * STEP)}
            results = linear_results(study, moved, chosen)
            ends.append([[computed(results[law], m) for m in MEASURES] for law in chosen])
        lower, upper = (np.log(np.array(end)) for end in ends)
        slopes[:, :, k] = (upper - lower) / np.log((1.0 + STEP) / (1.0 - STEP))
    return Sensitivity(chosen, names, slopes)


def spread(
    study: Study,
    values: Values,
    laws: tuple[str, ...] = ("velocity",),
    *,
    samples: int = 128,
    seed: int = 0,
) -> list[Spread]:
    """Propagate the ranges of all parameters to the results of laws.

    `samples` of the Latin hypercube are at least 2, `seed` is its seed.
    """
    if samples < 2:
        raise InputError(f"samples: {samples} must be at least 2")
    parameters = study.parameters
    cube = qmc.LatinHypercube(len(parameters), rng=np.random.default_rng(seed)).random(samples)
    low, high = (np.array([getattr(p, end) for p in parameters]) for end in ("low", "high"))
    runs = []
    for row in low + cube * (high - low):
        drawn = dict(zip((p.name for p in parameters), row.tolist(), strict=True))
        runs.append(linear_results(study, drawn, laws))
    nominal = linear_results(study, values, laws)
    spreads = []
    for law, measure in product(laws, MEASURES):
        known = [computed(run[law], measure) for run in runs if run[law].stable]
        low_end, high_end = np.nanquantile(known or [np.nan], ENDS)
        unstable = 1.0 - float(np.mean([run[law].stable for run in runs]))
        value = computed(nominal[law], measure)
        spreads.append(Spread(law, measure, value, float(low_end), float(high_end), unstable))
    return spreads
