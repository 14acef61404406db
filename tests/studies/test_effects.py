"""Shares of machines and what counts as damped."""

import numpy as np
import pyarrow as pa
import pytest
from scipy import stats

from cmf_mj.show.study import summary_table
from cmf_mj.studies import effects


def test_shares_have_wilsons_interval() -> None:
    """(p + z^2/2n +- z sqrt(p(1-p)/n + z^2/4n^2)) / (1 + z^2/n), 8 of 10."""
    interval = effects.estimate_share([True] * 8 + [False] * 2)
    z, n, p = stats.norm.ppf(0.975), 10, 0.8
    middle = (p + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2)) / (1 + z**2 / n)
    assert interval == pytest.approx((0.8, middle - half, middle + half, 10))
    assert effects.estimate_share([]).machines == 0


def test_damped_counts_the_overshoot_of_a_damping_ratio_of_three_tenths() -> None:
    """exp(-pi 0.3 / sqrt(1 - 0.09)) = 0.3723."""
    columns = {"stable": [True, True, False, True], "overshoot": [0.372, 0.373, 0.0, float("nan")]}
    assert effects.are_damped(pa.table(columns)).tolist() == [True, False, False, False]


def test_the_summary_of_a_study_has_its_least_bandwidth() -> None:
    """Of cases that did not fail; rows without one, or with none left, do not count."""
    names = ("case", "method", "law", "stable", "phase_bandwidth_hz", "error_type")
    cases = [("velocity", 2.7), ("velocity", 2.5), ("velocity", None), ("force", None)]
    rows = [(number, "sweep", law, True, hertz, "") for number, (law, hertz) in enumerate(cases)]
    table = pa.Table.from_pylist([dict(zip(names, row, strict=True)) for row in rows])
    assert [row[-1] for row in summary_table(table).cells] == ["2.50", "-"]
