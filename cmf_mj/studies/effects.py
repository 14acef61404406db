"""Shares of machines that a law leaves stable and damped, and effects of a ladder's rungs.

Functions take the table of results of a study. A share of machines has Wilson's score interval.
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
CONFIDENCE = 0.95  #: Of all intervals.
_LARGEST_OVERSHOOT = float(np.exp(-np.pi * ENOUGH_DAMPING / np.sqrt(1.0 - ENOUGH_DAMPING**2)))


class Interval(NamedTuple):
    """A value with its confidence interval; NaN where there is nothing to estimate from."""

    value: float
    low: float
    high: float
    machines: int  #: Machines that it is estimated from.


def estimate_share(outcomes: ArrayLike) -> Interval:
    """Share of true outcomes, (n,), with its interval."""
    flags = np.asarray(outcomes, dtype=bool)
    if flags.size == 0:
        return Interval(float("nan"), 0.0, 1.0, 0)
    test = stats.binomtest(int(flags.sum()), flags.size)
    bounds = test.proportion_ci(CONFIDENCE, method="wilson")
    return Interval(float(flags.mean()), float(bounds.low), float(bounds.high), flags.size)


def finished(table: pa.Table) -> pa.Table:
    """Rows that did not fail."""
    return where(table, error_type="")


def are_damped(table: pa.Table) -> NDArray[np.bool_]:
    """Which rows are stable and damped enough."""
    return np.array(table["stable"]) & (column(table, "overshoot") <= _LARGEST_OVERSHOOT)


class Rate(NamedTuple):
    """How often a law stays stable and damped over the machines drawn, with one cab."""

    cab: str
    law: str
    shares: dict[str, Interval]
    """Of machines that are `stable`, and of those `damped` in each degree of freedom."""
    mode_damping_ratio: float  #: Mean of the least damping ratio of all modes.


def _percent_text(share: Interval) -> str:
    if share.machines == 0:
        return "-"
    return f"{100.0 * share.value:.0f} ({100.0 * share.low:.0f}-{100.0 * share.high:.0f})"


def _share_fields(name: str, title: str) -> list[Field]:
    """A share with its interval: three columns of the frame, one that is printed."""
    return [
        Field(name, of=f"shares.{name}.value", printed=False),
        Field(f"{name}_low", of=f"shares.{name}.low", printed=False),
        Field(f"{name}_high", of=f"shares.{name}.high", printed=False),
        Field("", title, _percent_text, of=f"shares.{name}"),
    ]


RATE_FIELDS = (
    *map(Field, ("cab", "law")),
    *_share_fields("stable", "stable %"),
    *(field for dof in DOFS for field in _share_fields(dof, f"{dof} damped %")),
    Field("mode_damping_ratio", "least mode damping", ".3f"),
)


def rates(table: pa.Table) -> Result[Rate]:
    """How often each law stays stable and damped over the machines drawn, a row a cab and law."""
    linear = where(finished(table), method="linear")
    rows = []
    draws = linear.filter(pc.field("draw") != NOMINAL)
    for (cab, law), cases in groups(draws, "cab", "law"):
        by_dof = {dof: where(cases, dof=dof) for dof in DOFS}
        machines = by_dof["surge"]  # of a machine all degrees of freedom have the same modes
        shares = {"stable": estimate_share(machines["stable"])}
        shares |= {dof: estimate_share(are_damped(of_dof)) for dof, of_dof in by_dof.items()}
        damping = _statistic_of_known(np.mean, column(machines, "mode_damping_ratio"))
        rows.append(Rate(cab, law, shares, damping))
    return Result(rows, RATE_FIELDS)


def _statistic_of_known(statistic: Callable[..., Any], values: NDArray[np.float64]) -> float:
    """A statistic of the values that are not NaN."""
    known = values[~np.isnan(values)]
    return float(statistic(known)) if known.size else float("nan")


_BOTH_STABLE = pc.field("stable") & pc.field("stable_before")
_CASE = ["cab", *(f"pose_{dof}" for dof in DOFS), "draw", "law", "dof", "method"]
"""Columns in which the rows of two rungs agree whose difference is the effect."""

RUNG_EFFECT_FIELDS = (
    *map(Field, ("rung", "dof")),
    Field("phase_bandwidth_hz", "-90 deg [Hz]", "+.2f"),
    Field("peak_gain_db", "peak [dB]", "+.1f"),
    Field("damping_ratio", form="+.2f"),
    Field("crosstalk", "largest crosstalk", "+.2f"),
)


def rung_effects(table: pa.Table) -> Result[dict[str, Any]]:
    """What each rung changes against the one before, by rung and degree of freedom.

    Medians over the laws of -90 deg [Hz], peak [dB], damping ratio, and of the largest crosstalk
    out of the degree of freedom.
    """
    results, rows = finished(table), []
    rungs, dofs = (results[name].unique().to_pylist() for name in ("rung", "dof"))
    join: dict[str, Any] = {"join_type": "inner", "right_suffix": "_before", "use_threads": False}
    for (rung_before, rung), dof in product(pairwise(rungs), dofs):
        with_effect, without = where(results, rung=rung, dof=dof), where(results, rung=rung_before)
        pairs = with_effect.join(without, _CASE, **join).filter(_BOTH_STABLE)
        names = ("phase_bandwidth_hz", "peak_gain_db", "damping_ratio")
        changes = {name: column(pairs, name) - column(pairs, f"{name}_before") for name in names}
        crosstalk_before = largest_crosstalk(pairs, dof, "_before")
        changes["crosstalk"] = largest_crosstalk(pairs, dof) - crosstalk_before
        medians = {key: _statistic_of_known(np.median, change) for key, change in changes.items()}
        rows.append({"rung": rung, "dof": dof} | medians)
    return Result(rows, RUNG_EFFECT_FIELDS)


def largest_crosstalk(table: pa.Table, dof: str, suffix: str = "") -> NDArray[np.float64]:
    """Largest crosstalk out of a degree of freedom, row by row; columns end in `suffix`."""
    others = [column(table, f"crosstalk_{other}{suffix}") for other in DOFS if other != dof]
    return np.asarray(np.max(others, axis=0))
