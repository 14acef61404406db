"""Gain search: the fastest law that keeps the limits in all degrees of freedom and cabs at once.

What is searched is `FREE`; what is given: the set's speed, lags and leak rate, the modes, the
authority, the integral gain and the corner of the load feedback. Minimised by CMA-ES (N. Hansen,
package `cma`), over all cabs, degrees of freedom and sets of valve gains,

    -min(-90 deg bandwidth, f_rate) + excess of peak, overshoot and tail over `Limits`,

each excess in units of its weight, f_rate the frequency to which the plan's reference can follow
the chirp. So that the loop has margins, peak and tail are limited too with all valves faster by
`FASTER`.
"""

import warnings
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj import units
from cmf_mj.control.law import Gains, Law
from cmf_mj.control.load_feedback import LoadFeedback
from cmf_mj.control.plan import Plan
from cmf_mj.parameters import load_hydraulics
from cmf_mj.plant import Hexapod, SingleLegs
from cmf_mj.tuning.evaluation import CHIRP, LinearCab, Worth, evaluate, linear_cab
from cmf_mj.tuning.nominal import CABS, nominal_modes

HEAVY = 2
"""Modes of the pair of surge and sway, which have gains of their own."""

FASTER = 1.5
"""Factor on all valve gains at which the loop must still be well damped."""

FREE = {
    "first_pair": (4.0, 20.0),
    "first_damping": (0.35, 1.2),
    "second_pair": (6.0, 45.0),
    "second_damping": (0.4, 1.2),
    "pole": (8.0, 60.0),
    "rate_frequency": (4.0, 9.0),
    "position_heavy": (15.0, 50.0),
    "position_light": (15.0, 60.0),
    "velocity_heavy": (-0.5, 2.0),
    "velocity_light": (-0.5, 2.0),
    "load_heavy": (-3.0, 3.0),
    "load_light": (-3.0, 3.0),
}
"""Bounds of what is searched: Hz, 1, %/in, %/(in/s), %/klbf."""

START = (9.2, 0.38, 36.0, 0.95, 14.5, 5.6, 23.0, 21.5, 0.33, -0.07, 0.6, 1.9)
"""Where the search starts: the shipped law, of earlier searches."""


Seeds = Sequence[int | None]
"""Sets of valve gains, `valve_gains`."""


class Limits(NamedTuple):
    """What a law has to keep."""

    peak_db: float = 2.0
    overshoot: float = 0.18
    tail: float = 0.05
    """Largest distance from the demand 0.63 s after a step."""
    margin_db: float = 6.0
    """Peak with all valves faster by `FASTER`."""


_WEIGHTS = Limits(0.3, 0.03, 0.05, 1.0)


class Found(NamedTuple):
    """What a search found."""

    law: Law
    worth: Worth
    cost: float
    evaluations: int


class Template(NamedTuple):
    """What is the same for all candidates."""

    name: str
    law: Law
    rate: NDArray[np.float64]
    """Largest modal amplitude of the chirp over cabs and degrees of freedom, (6,) [in]."""
    cabs: tuple[LinearCab, ...]


def make_template(name: str, title: str, cabs: Sequence[str] = CABS) -> Template:
    """Law without what is searched, and the linear plants it is judged on.

    Args:
        name: of the law.
        title: for figures and tables.
        cabs: names.
    """
    plants = [Hexapod(cab) for cab in cabs]
    modes = {plant.cab: nominal_modes(plant) for plant in plants}
    legs = SingleLegs()
    linear = tuple(linear_cab(plant) for plant in plants)
    moved = [
        np.abs(np.array(modes[cab.cab].shape) @ cab.jacobian * CHIRP).max(axis=1) for cab in linear
    ]
    law = Law(
        name=name,
        title=title,
        coordinates="hydraulic_modes",
        modes=modes | {legs.mounting: nominal_modes(legs)},
        direct_gain=Gains(error_integral=10.0),
    )
    return Template(name, law, np.max(moved, axis=0) / units.INCH, linear)


def candidate(template: Template, values: Sequence[float]) -> Law:
    """The law of some values of `FREE`, rounded as its table prints them."""
    at = dict(zip(FREE, (float(f"{v:.4g}") for v in values), strict=True))
    given = load_hydraulics("hardware")

    def six(name: str) -> tuple[float, ...]:
        return (at[f"{name}_heavy"],) * HEAVY + (at[f"{name}_light"],) * (6 - HEAVY)

    rate = 2.0 * np.pi * at["rate_frequency"] * template.rate
    plan = Plan(
        speed=given.leg_speed.value,
        drive_lag=given.drive_lag.value,
        valve_lag=given.valve_lag.value,
        leak_rate=given.leak_rate.value,
        pairs=(
            (at["first_pair"], at["first_damping"]),
            (at["second_pair"], at["second_damping"]),
        ),
        pole=at["pole"],
        rate=tuple(float(f"{v:.4g}") for v in rate),
        authority=88.0,
        position=six("position"),
        velocity=six("velocity"),
    )
    load = LoadFeedback(gain=six("load"), corner=0.5)
    return template.law.model_copy(update={"plan": plan, "load_feedback": load})


def cost(
    law: Law, rate_frequency: float, template: Template, limits: Limits, seeds: Seeds
) -> float:
    """What is minimised."""
    worth = evaluate(law, template.cabs, seeds)
    faster = evaluate(law, template.cabs, (None,), scale=FASTER)
    worst = (
        (worth.peak_db.max(), limits.peak_db, _WEIGHTS.peak_db),
        (worth.overshoot.max(), limits.overshoot, _WEIGHTS.overshoot),
        (max(worth.settled.max(), faster.settled.max()), limits.tail, _WEIGHTS.tail),
        (faster.peak_db.max(), limits.margin_db, _WEIGHTS.margin_db),
    )
    excess = sum(max(0.0, (value - limit) / weight) for value, limit, weight in worst)
    found = -min(float(worth.phase_hz.min()), rate_frequency) + excess
    return float(found) if np.isfinite(found) else 1e3


def search(
    template: Template,
    limits: Limits | None = None,
    *,
    seeds: Seeds = (None, 1),
    evaluations: int = 24,
    seed: int = 1,
    start: Sequence[float] = START,
    progress: Callable[[int, int], None] | None = None,
) -> Found:
    """Search the gains of a modal law by CMA-ES.

    Args:
        template: of `make_template`.
        limits: to keep; default `Limits`.
        seeds: sets of valve gains, `valve_gains`.
        evaluations: about so many laws are tried.
        seed: of the search.
        start: values of `FREE` to start from.
        progress: called with (laws tried, laws in all).

    Raises:
        ValueError: less than one evaluation.
    """
    import cma

    if evaluations < 1:
        raise ValueError(f"evaluations: {evaluations} must be at least 1")
    kept = limits or Limits()
    low, high = np.array(list(FREE.values())).T
    rates = list(FREE).index("rate_frequency")

    def priced(point: NDArray[np.float64]) -> float:
        values = low + (high - low) * np.asarray(point)
        law = candidate(template, values.tolist())
        return cost(law, float(values[rates]), template, kept, seeds)

    options = {"bounds": [0.0, 1.0], "seed": seed, "verbose": -9, "popsize": 12}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        strategy = cma.CMAEvolutionStrategy((np.array(start) - low) / (high - low), 0.03, options)
    best, tried = (np.inf, np.array(start)), 0
    while tried < evaluations and not strategy.stop():
        points = strategy.ask()
        prices = [priced(point) for point in points]
        strategy.tell(points, prices)
        tried += len(points)
        least = int(np.argmin(prices))
        if prices[least] < best[0]:
            best = prices[least], low + (high - low) * np.asarray(points[least])
        if progress is not None:
            progress(min(tried, evaluations), evaluations)
    law = candidate(template, best[1].tolist())
    return Found(law, evaluate(law, template.cabs, seeds), best[0], tried)
