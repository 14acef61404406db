"""Gain search: the fastest law that keeps the limits in all degrees of freedom and cabs at once.

Searched is what a `Form` leaves free (`cmf_mj.studies.tuning.forms`). Minimised by CMA-ES
(N. Hansen, package `cma`), over all cabs, degrees of freedom and sets of valve gains,

    -min(-90 deg bandwidth, f_rate) - mean / 10
        + excess of peak, overshoot and tail over `Requirements`,

the mean that of the bandwidths: what does not bear on the lowest is as fast as the limits allow
too. Each excess is in units of its weight, f_rate the frequency to which a plan's reference can
follow the chirp. So that the loop has margins, peak and tail are limited too with all valves faster
by `FASTER`.

Dry friction counts in bandwidth, peak and overshoot as stated. It damps less the faster the legs
slide, and a law must not need it: tail, margins and damping ratio are those without friction.
"""

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tomlkit
from numpy.typing import NDArray

from cmf_mj.control.law import Law
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.files import write_text
from cmf_mj.studies.engine import libraries
from cmf_mj.studies.tuning.evaluation import Performance, evaluate, least_damping
from cmf_mj.studies.tuning.forms import FORMS, Form, Template, candidate_law

FASTER = 1.5  #: Factor on all valve gains at which the loop must still be well damped.
MEAN_WEIGHT = 0.1  #: Weight of the mean bandwidth next to the lowest.
Seeds = Sequence[int | None]  #: Sets of valve gains, `valve_gains`.


class Requirements(NamedTuple):
    """What a law has to keep."""

    peak_db: float = 2.0
    overshoot: float = 0.18  #: Of steps in one degree of freedom.
    together: float = 0.5  #: Of the step in all of them at once.
    tail: float = 0.05  #: Largest distance from the demand 0.63 s after a step.
    margin_db: float = 6.0  #: Peak with all valves faster by `FASTER`.
    damping: float = 0.02  #: Least damping ratio of any pole.


_WEIGHTS = Requirements(
    peak_db=0.3, overshoot=0.03, together=0.06, tail=0.05, margin_db=1.0, damping=0.01
)
_EXCESS_TEXTS = {
    "peak_db": "peak by {:.2f} dB",
    "overshoot": "overshoot by {:.1%}",
    "together": "overshoot of all axes at once by {:.1%}",
    "tail": "what is left after a step by {:.1%}",
    "margin_db": "peak with faster valves by {:.2f} dB",
    "damping": "damping ratio by {:.3f}",
}


class SearchResult(NamedTuple):
    """The best law of a search."""

    law: Law
    performance: Performance
    excess: Requirements  #: By how much it is beyond each limit, 0 where it keeps it.
    cost: float
    evaluations: int

    @property
    def verdict(self) -> str:
        """Which limits are not kept, and by how much."""
        excess = self.excess._asdict()
        texts = _EXCESS_TEXTS.items()
        broken = [text.format(excess[name]) for name, text in texts if not excess[name] <= 0]
        if broken:
            return f"limits not kept: {', '.join(broken).replace('%', ' %')}"
        names = (text.partition(" by ")[0] for text in _EXCESS_TEXTS.values())
        return f"all limits kept: {', '.join(names)}"


def judge(
    law: Law, template: Template, limits: Requirements, seeds: Seeds
) -> tuple[Performance, Requirements]:
    """What a law does with friction as stated, and by how much it is beyond each limit."""
    performance = evaluate(law, template.cabs, seeds)
    frictionless = performance
    if template.frictionless is not template.cabs:
        frictionless = evaluate(law, template.frictionless, seeds)
    faster = evaluate(law, template.frictionless, (None,), scale=FASTER)
    in_one_dof, in_all = np.split(performance.overshoot, [-1], axis=-1)  # as `STEPPED_DOFS`
    worst = Requirements(
        peak_db=performance.peak_db.max(),
        overshoot=in_one_dof.max(),
        together=in_all.max(),
        tail=np.max([each.tail.max() for each in (performance, frictionless, faster)]),
        margin_db=faster.peak_db.max(),
        damping=least_damping(law, template.frictionless),
    )
    excess = Requirements(*np.subtract(worst, limits).tolist())
    excess = excess._replace(damping=limits.damping - worst.damping)  # which is a least one
    return performance, Requirements(*np.maximum(0.0, excess).tolist())


def cost(
    form: Form, values: Sequence[float], template: Template, limits: Requirements, seeds: Seeds
) -> float:
    """The cost that a search minimises, of a law with these values."""
    with libraries().limit(limits=1):  # the same bits on any number of cores, and faster
        performance, excess = judge(candidate_law(form, template, values), template, limits, seeds)
    penalty = sum(over / weight for over, weight in zip(excess, _WEIGHTS, strict=True))
    slowest = min(float(performance.phase_hz.min()), form.reach(form.named(values)))
    total = -slowest - MEAN_WEIGHT * float(performance.phase_hz.mean()) + penalty
    return float(total) if np.isfinite(total) else 1e3


def search(
    template: Template,
    limits: Requirements | None = None,
    *,
    form: str = "modal_plan",
    seeds: Seeds = (None, 1),
    evaluations: int = 24,
    seed: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> SearchResult:
    """Search the gains of a law by CMA-ES.

    `seeds` are sets of valve gains (`valve_gains`); about `evaluations` laws are tried. `progress`
    is called with (laws tried, laws in all).
    """
    if evaluations < 1:
        raise InputError(f"evaluations: {evaluations} must be at least 1")
    limits, law_form = limits or Requirements(), FORMS[check_name("form", form, FORMS)]
    start = np.array(law_form.start)
    low = np.array([number.low for number in law_form.free.values()])
    high = np.array([number.high for number in law_form.free.values()])

    def values_of(point: NDArray[np.float64]) -> list[float]:
        return list(low + (high - low) * np.asarray(point))

    options = {"bounds": [0.0, 1.0], "seed": seed, "verbose": -9, "popsize": 12}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import cma

        start_point = (start - low) / (high - low)
        strategy = cma.CMAEvolutionStrategy(start_point, law_form.spread, options)
    least_cost, best_values, count = np.inf, start.tolist(), 0
    while count < evaluations and not strategy.stop():
        points = strategy.ask()
        costs = [cost(law_form, values_of(point), template, limits, seeds) for point in points]
        strategy.tell(points, costs)
        count += len(points)
        best = int(np.argmin(costs))
        if costs[best] < least_cost:
            least_cost, best_values = costs[best], values_of(points[best])
        if progress is not None:
            progress(min(count, evaluations), evaluations)
    law = candidate_law(law_form, template, best_values)
    performance, excess = judge(law, template, limits, seeds)
    return SearchResult(law, performance, excess, least_cost, count)


def save_law(law: Law, path: str | Path, heading: str = "") -> Path:
    """Write a law file whole or not at all, below some comment lines; `load_law` reads it back.

    Frequencies and masses of modes have six digits, shapes twelve: they have to be orthonormal.
    """
    table = law.model_dump(mode="json", exclude_defaults=True, exclude={"name"})
    for modes in table.get("modes", {}).values():
        for name in ("frequency", "mass"):
            modes[name] = [float(f"{value:.6g}") for value in modes[name]]
        modes["shape"] = [[round(value, 12) + 0.0 for value in row] for row in modes["shape"]]
    comment = "".join(f"# {line}".rstrip() + "\n" for line in heading.splitlines())
    return write_text(Path(path), comment + tomlkit.dumps({law.name: table}))
