"""What a finished study says: shares and effects.

Each function takes the table of results. A share of machines has Wilson's score interval.
"""

from collections.abc import Callable
from itertools import pairwise, product
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from cmf_mj.core.result import Field, Result, column, groups, where
from cmf_mj.machine.geometry import DOFS
from cmf_mj.studies.settings import NOMINAL

ENOUGH_DAMPING = 0.3  #: Damping ratio that counts as damped: an overshoot of 37 %.

LEVEL = 0.95  #: Confidence of all intervals.

_MOST_OVERSHOOT = float(np.exp(-np.pi * ENOUGH_DAMPING / np.sqrt(1.0 - ENOUGH_DAMPING**2)))


class Interval(NamedTuple):
    """A value with its confidence interval; NaN where there is nothing to estimate from."""

    value: float
    low: float
    high: float
    machines: int  #: How many it rests on.


def share(outcomes: ArrayLike) -> Interval:
    """Share of true outcomes, (n,), with its interval."""
    flags = np.asarray(outcomes, dtype=bool)
    if flags.size == 0:
        return Interval(float("nan"), 0.0, 1.0, 0)
    bounds = stats.binomtest(int(flags.sum()), flags.size).proportion_ci(LEVEL, method="wilson")
    return Interval(float(flags.mean()), float(bounds.low), float(bounds.high), flags.size)


def finished(table: pa.Table) -> pa.Table:
    """Rows that did not fail."""
    return where(table, error_type="")


def damped(table: pa.Table) -> NDArray[np.bool_]:
    """Which rows are stable and damped enough."""
    return np.array(table["stable"]) & (column(table, "overshoot") <= _MOST_OVERSHOOT)


class Rate(NamedTuple):
    """How often a law stays stable and damped over the machines drawn with a cab."""

    cab: str
    law: str
    shares: dict[str, Interval]
    """Of machines that are `stable`, and of those `damped` in each degree of freedom."""
    mode_damping_ratio: float  #: Mean of the least damping ratio of all modes.


def _percent(share: Interval) -> str:
    if share.machines == 0:
        return "-"
    return f"{100.0 * share.value:.0f} ({100.0 * share.low:.0f}-{100.0 * share.high:.0f})"


def _shares(name: str, title: str) -> list[Field]:
    """A share with its interval: three columns of the frame, one that is printed."""
    ends = {"": "value", "_low": "low", "_high": "high"}
    return [
        *(Field(name + e, of=f"shares.{name}.{p}", printed=False) for e, p in ends.items()),
        Field("", title, _percent, of=f"shares.{name}"),
    ]


RATES = (
    *map(Field, ("cab", "law")),
    *_shares("stable", "stable %"),
    *(field for dof in DOFS for field in _shares(dof, f"{dof} damped %")),
    Field("mode_damping_ratio", "least mode damping", ".3f"),
)


def rates(table: pa.Table) -> Result[Rate]:
    """How often each law stays stable and damped over the machines drawn, a row a cab and law."""
    linear = where(finished(table), method="linear")
    rows = []
    for (cab, law), drawn in groups(linear.filter(pc.field("draw") != NOMINAL), "cab", "law"):
        axes = {dof: where(drawn, dof=dof) for dof in DOFS}
        machines = axes[DOFS[0]]
        shares = {"stable": share(machines["stable"])}
        shares |= {dof: share(damped(one)) for dof, one in axes.items()}
        rows.append(Rate(cab, law, shares, _known(np.mean, column(machines, "mode_damping_ratio"))))
    return Result(rows, RATES)


def _known(statistic: Callable[..., Any], values: NDArray[np.float64]) -> float:
    """A statistic of the values that are not NaN."""
    known = values[~np.isnan(values)]
    return float(statistic(known)) if known.size else float("nan")


_BOTH = pc.field("stable") & pc.field("stable_other")
_ALIKE = ["cab", *(f"pose_{dof}" for dof in DOFS), "draw", "law", "dof", "method"]


def _difference(pairs: pa.Table, name: str) -> NDArray[np.float64]:
    return column(pairs, name) - column(pairs, f"{name}_other")


CLIMB = (
    *map(Field, ("rung", "dof")),
    Field("phase_bandwidth_hz", "-90 deg [Hz]", "+.2f"),
    Field("peak_gain_db", "peak [dB]", "+.1f"),
    Field("damping_ratio", form="+.2f"),
    Field("crosstalk", "largest crosstalk", "+.2f"),
)


def climb(table: pa.Table) -> Result[dict[str, Any]]:
    """What each rung changes against the one before, by rung and degree of freedom.

    Medians over the laws of -90 deg [Hz], peak [dB], damping ratio, and of the largest crosstalk
    out of the degree of freedom.
    """
    done, rows = finished(table), []
    rungs, dofs = (done[name].unique().to_pylist() for name in ("rung", "dof"))
    for (before, rung), dof in product(pairwise(rungs), dofs):
        here, other = where(done, rung=rung, dof=dof), where(done, rung=before)
        how: dict[str, Any] = {"join_type": "inner", "right_suffix": "_other"}
        stable = here.join(other, _ALIKE, use_threads=False, **how).filter(_BOTH)
        names = ("phase_bandwidth_hz", "peak_gain_db", "damping_ratio")
        changes = {name: _difference(stable, name) for name in names}
        mixed, before_mixed = (largest_crosstalk(stable, dof, end) for end in ("", "_other"))
        changes["crosstalk"] = mixed - before_mixed
        medians = {name: _known(np.median, change) for name, change in changes.items()}
        rows.append({"rung": rung, "dof": dof} | medians)
    return Result(rows, CLIMB)


def largest_crosstalk(table: pa.Table, dof: str, end: str = "") -> NDArray[np.float64]:
    """Largest crosstalk out of a degree of freedom, row by row."""
    others = [column(table, f"crosstalk_{other}{end}") for other in DOFS if other != dof]
    return np.asarray(np.max(others, axis=0))
