"""What a finished study says: shares, effects and agreement, as plain rows.

Each function takes the table of results. A share of machines has Wilson's score interval.
"""

from collections.abc import Iterable
from itertools import pairwise, product
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from cmf_mj.machine.geometry import DOFS
from cmf_mj.studies.settings import NOMINAL

ENOUGH_DAMPING = 0.3
"""Damping ratio that counts as damped: an overshoot of 37 %."""

LEVEL = 0.95
"""Confidence of all intervals."""

_MOST_OVERSHOOT = float(np.exp(-np.pi * ENOUGH_DAMPING / np.sqrt(1.0 - ENOUGH_DAMPING**2)))

Row = dict[str, Any]
Pair = tuple[Row, Row]


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


def rows_of(table: pa.Table, **equal: object) -> list[Row]:
    """Rows that did not fail and have these values."""
    return [
        row
        for row in table.to_pylist()
        if not row["error_type"] and all(row[name] == value for name, value in equal.items())
    ]


def in_order(rows: Iterable[Row], name: str) -> list[Any]:
    """Different values of a column, in the order of their first appearance."""
    return list(dict.fromkeys(row[name] for row in rows))


def damped(row: Row) -> bool:
    """Whether a row is stable and damped enough."""
    return bool(row["stable"] and row["overshoot"] <= _MOST_OVERSHOOT)


def rates(table: pa.Table) -> list[tuple[str, str, list[Interval], float]]:
    """How often each law stays stable and damped over the machines drawn, a line a cab and law.

    The shares are of machines that are stable, and of those that are `damped` in each degree of
    freedom; the number is the mean of the least damping ratio of all modes.
    """
    rows = [row for row in rows_of(table, method="linear") if row["draw"] != NOMINAL]
    every = []
    for cab, law in product(in_order(rows, "cab"), in_order(rows, "law")):
        chosen = [row for row in rows if (row["cab"], row["law"]) == (cab, law)]
        machines = [row for row in chosen if row["dof"] == DOFS[0]]
        shares = [share([row["stable"] for row in machines])]
        shares += [share([damped(r) for r in chosen if r["dof"] == dof]) for dof in DOFS]
        modes = np.array([row["mode_damping_ratio"] for row in machines], dtype=float)
        known = modes[~np.isnan(modes)]
        every.append((cab, law, shares, float(known.mean()) if known.size else float("nan")))
    return every


def _stable(pairs: Iterable[Pair]) -> list[Pair]:
    """Pairs of which both are stable."""
    return [pair for pair in pairs if pair[0]["stable"] and pair[1]["stable"]]


def _differences(pairs: Iterable[Pair], name: str) -> NDArray[np.float64]:
    return np.array([one[name] - other[name] for one, other in pairs], dtype=float)


def agreement(table: pa.Table) -> list[tuple[str, int, int, float, float]]:
    """Linear cases against the same ones simulated, law by law.

    Machines compared, and those with the same verdict: simulated, one is unstable where any step
    rings on. Medians of |simulated - linear| over all degrees of freedom of the -90 deg bandwidth
    [Hz] and of the damping ratio from the overshoot.
    """
    linear = {_where(row): row for row in rows_of(table, method="linear")}
    simulated = {_where(row): row for row in rows_of(table, method="matrix")}
    keys = [key for key in simulated if key in linear]
    rows = []
    for law in dict.fromkeys(key[0] for key in keys):
        pairs = {key: (simulated[key], linear[key]) for key in keys if key[0] == law}
        machines: dict[tuple[Any, ...], list[Pair]] = {}
        for key, pair in pairs.items():
            machines.setdefault(key[:-1], []).append(pair)
        same = [all(one["stable"] for one, _ in p) == p[0][1]["stable"] for p in machines.values()]
        phase, damping = (
            _median(np.abs(_differences(_stable(pairs.values()), name)))
            for name in ("phase_bandwidth_hz", "damping_ratio")
        )
        rows.append((law, len(same), sum(same), phase, damping))
    return rows


def _where(row: Row) -> tuple[Any, ...]:
    return row["law"], row["rung"], row["cab"], row["draw"], row["dof"]


def _median(values: NDArray[np.float64]) -> float:
    known = values[~np.isnan(values)]
    return float(np.median(known)) if known.size else float("nan")


def climb(table: pa.Table) -> dict[tuple[str, str], list[float]]:
    """What each rung changes against the one before, by rung and degree of freedom.

    Medians over the laws of -90 deg [Hz], peak [dB], damping ratio, and of the largest crosstalk
    out of the degree of freedom.
    """
    rows = rows_of(table)
    by_case = {(row["rung"], row["law"], row["dof"], row["cab"]): row for row in rows}
    steps = {}
    for (before, rung), dof in product(pairwise(in_order(rows, "rung")), in_order(rows, "dof")):
        both = _stable(
            (row, by_case[before, law, dof, cab])
            for (name, law, moved, cab), row in by_case.items()
            if (name, moved) == (rung, dof) and (before, law, dof, cab) in by_case
        )
        changes = [
            _differences(both, name)
            for name in ("phase_bandwidth_hz", "peak_gain_db", "damping_ratio")
        ]
        changes.append(np.array([largest_crosstalk(a) - largest_crosstalk(b) for a, b in both]))
        steps[rung, dof] = [_median(change) for change in changes]
    return steps


def largest_crosstalk(row: Row) -> float:
    """Largest crosstalk out of the degree of freedom of a row."""
    values = np.array([row[f"crosstalk_{dof}"] for dof in DOFS if dof != row["dof"]])
    return float(values.max())
