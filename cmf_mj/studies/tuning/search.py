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
from cmf_mj.studies.tuning.forms import FORMS, Form, Template, candidate, named

FASTER = 1.5  #: Factor on all valve gains at which the loop must still be well damped.

MEAN = 0.1  #: Weight of the mean bandwidth next to the lowest.

Seeds = Sequence[int | None]  #: Sets of valve gains, `valve_gains`.


class Requirements(NamedTuple):
    """What a law has to keep."""

    peak_db: float = 2.0
    overshoot: float = 0.18  #: Of steps in one degree of freedom.
    together: float = 0.5  #: Of the step in all of them at once.
    tail: float = 0.05  #: Largest distance from the demand 0.63 s after a step.
    margin_db: float = 6.0  #: Peak with all valves faster by `FASTER`.
    damping: float = 0.02  #: Least damping ratio of any pole.


_WEIGHTS = Requirements(0.3, 0.03, 0.06, 0.05, 1.0, 0.01)
_EXCESS = (
    *("peak by {:.2f} dB", "overshoot by {:.1%}", "overshoot of all axes at once by {:.1%}"),
    *("what is left after a step by {:.1%}", "peak with faster valves by {:.2f} dB"),
    "damping ratio by {:.3f}",
)


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
        pairs = zip(_EXCESS, self.excess, strict=True)
        broken = ", ".join(text.format(over) for text, over in pairs if not over <= 0.0)
        if broken:
            return f"limits not kept: {broken.replace('%', ' %')}"
        return f"all limits kept: {', '.join(text.split(' by ')[0] for text in _EXCESS)}"


def judged(
    law: Law, template: Template, limits: Requirements, seeds: Seeds
) -> tuple[Performance, Requirements]:
    """What a law does with friction as stated, and by how much it is beyond each limit."""
    performance = evaluate(law, template.cabs, seeds)
    without = performance
    if template.frictionless is not template.cabs:
        without = evaluate(law, template.frictionless, seeds)
    faster = evaluate(law, template.frictionless, (None,), scale=FASTER)
    worst = Requirements(
        performance.peak_db.max(),
        performance.overshoot[..., :-1].max(),
        performance.overshoot[..., -1].max(),
        np.max([one.tail.max() for one in (performance, without, faster)]),
        faster.peak_db.max(),
        least_damping(law, template.frictionless),
    )
    over = np.subtract(worst, limits)
    over[-1] *= -1.0  # the damping ratio must be at least its limit
    return performance, Requirements(*np.maximum(0.0, over).tolist())


def cost(
    form: Form, values: Sequence[float], template: Template, limits: Requirements, seeds: Seeds
) -> float:
    """What is minimised."""
    with libraries().limit(limits=1):  # the same bits on any number of cores, and faster
        performance, beyond = judged(candidate(form, template, values), template, limits, seeds)
    excess = sum(over / weight for over, weight in zip(beyond, _WEIGHTS, strict=True))
    slowest = min(float(performance.phase_hz.min()), form.reach(named(form, values)))
    total = -slowest - MEAN * float(performance.phase_hz.mean()) + excess
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
    limits, chosen = limits or Requirements(), FORMS[check_name("form", form, FORMS)]
    first = np.array(chosen.start)
    low, high = np.array(list(chosen.free.values())).T

    def values_of(point: NDArray[np.float64]) -> list[float]:
        return list(low + (high - low) * np.asarray(point))

    options = {"bounds": [0.0, 1.0], "seed": seed, "verbose": -9, "popsize": 12}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import cma

        strategy = cma.CMAEvolutionStrategy((first - low) / (high - low), chosen.spread, options)
    best, tried = (np.inf, first.tolist()), 0
    while tried < evaluations and not strategy.stop():
        points = strategy.ask()
        costs = [cost(chosen, values_of(point), template, limits, seeds) for point in points]
        strategy.tell(points, costs)
        tried += len(points)
        least = int(np.argmin(costs))
        if costs[least] < best[0]:
            best = costs[least], values_of(points[least])
        if progress is not None:
            progress(min(tried, evaluations), evaluations)
    law = candidate(chosen, template, best[1])
    return SearchResult(law, *judged(law, template, limits, seeds), best[0], tried)


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
