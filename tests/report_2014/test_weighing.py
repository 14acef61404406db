"""Plants weighed by evidence: a linear machine in closed form, and reports that are made up."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from cmf_mj.core.errors import InputError
from cmf_mj.report_2014.posterior import effect_tables as tables
from cmf_mj.report_2014.posterior.effect_run import effect_points, run_effects
from cmf_mj.report_2014.posterior.evidence import observation_arrays, observations
from cmf_mj.report_2014.posterior.study import AVERAGE, NONE, load_effects
from cmf_mj.report_2014.posterior.weighing import Bank

SMALL = {"rounds": 2, "draws": 32, "kept": 4, "pairs": 2, "cabs": ["gfd", "ifd"]}
FEW = ["coulomb", "viscous", "flow_shape", "second_lag", "pressure_filter", "measured_mass"]
LEFT_OUT = ["simulated", "arx", "reading_delay", "velocity_filter", "soft_cap", *FEW]
COUNT = 4096


def linear_bank(moved: float = 1.0) -> Bank:
    """Numbers that are linear in the unknowns; the effect `lap` moves one of them by `moved`."""
    study = load_effects("effects", changes={"skipped": LEFT_OUT, "made_up": 12})
    generator, (middle, s, _) = np.random.default_rng(3), observation_arrays()
    points = generator.normal(size=(COUNT, len(study.settings.unknowns) + 3))
    slopes = generator.normal(size=(points.shape[1], s.size)) * s * 0.3
    slopes[-3:] = 0.0
    place = [one.name for one in observations()].index("velocity_phase_bandwidth_hz")
    middle = middle.copy()
    middle[place] -= 3.0 * s[place]
    plain = middle + points @ slopes
    lap = plain.copy()
    lap[:, place] += moved * 3.0 * s[place] * np.abs(points[:, -3])
    every = np.ones(COUNT, dtype=bool)
    shown = {NONE: plain, "lap": lap}
    none = np.zeros(COUNT)
    return Bank(study, points, none, none, shown, dict.fromkeys(shown, every), [])


def gaussian(bank: Bank, plant: str) -> float:
    """Ln Z of numbers with the covariance of the samples, a Gaussian density."""
    report = observation_arrays()
    printed, s = report.values[:-1], report.deviations[:-1]
    made = bank.predicted[plant][:, :-1]
    spread = np.cov(made.T) + np.diag(s**2)
    density = stats.multivariate_normal(made.mean(axis=0), spread).logpdf(printed)
    return float(density + 0.5 * np.log(2.0 * np.pi * s**2).sum())


def test_evidence_is_the_density_of_the_report_in_closed_form() -> None:
    """All Gaussian: Z is a normal density."""
    bank = linear_bank()
    expected = gaussian(bank, NONE)
    assert bank.log_evidence(NONE, kinds=()) == pytest.approx(expected, abs=0.25)
    assert bank.log_evidence(NONE) == bank.log_evidence(NONE, kinds=())


def test_the_moments_are_the_posterior_of_a_linear_machine() -> None:
    """Mean and deviations of the machines weighed, which a first round of drawing aims at."""
    bank = linear_bank()
    mean, spread = bank.moments()
    points, weights = bank.points[:, : mean.size], bank.weights(NONE)
    error = 4.0 / np.sqrt(1.0 / (weights**2).sum())
    np.testing.assert_allclose(mean, weights @ points, atol=error)
    apart = np.sqrt(weights @ (points - weights @ points) ** 2)
    np.testing.assert_allclose(np.sqrt(np.diag(spread)), apart, atol=error)


def test_the_effect_that_explains_a_number_has_the_evidence() -> None:
    """It moves a number by the three deviations that are missing."""
    bank = linear_bank()
    first, second = tables.plant_evidence(bank)
    assert (first.plant, second.plant) == ("lap", NONE)
    assert first.evidence > 1.0 > first.error
    assert first.share + second.share == pytest.approx(1.0)
    assert first.share == pytest.approx(1.0 / (1.0 + np.exp(-first.evidence)))
    idle = tables.plant_evidence(linear_bank(0.0))
    assert [one.evidence for one in idle] == [0.0, 0.0]


def test_a_number_left_out_has_the_rank_that_it_has_among_predictions() -> None:
    """With the evidence of all others, that of a number 3 deviations above lies far up."""
    rows = {(r.plant, r.number): r for r in tables.left_out(linear_bank())}
    assert rows[NONE, "velocity_phase_bandwidth_hz"].rank > 0.98
    assert 0.05 <= rows["lap", "velocity_phase_bandwidth_hz"].rank <= 0.95
    others = [r for (plant, name), r in rows.items() if plant == NONE and "phase_b" not in name]
    assert all(0.05 <= one.rank <= 0.95 for one in others)
    low, middle, high = rows[NONE, "pair_hz"].predicted
    assert low < middle < high
    assert AVERAGE in {plant for plant, _ in rows}


def test_reports_made_up_find_their_effect_as_often_as_it_shows() -> None:
    strong, weak, none = (
        {row["plant"]: row for row in tables.made_up(linear_bank(moved))}
        for moved in (3.0, 0.1, 0.0)
    )
    assert strong["lap"]["right"] >= 0.6
    assert strong["lap"]["gain"] > 0.5 > weak["lap"]["gain"] > none["lap"]["gain"] == 0.0
    assert sum(strong["lap"][f"found {plant}"] for plant in (NONE, "lap")) == 12


def test_without_evidence_the_medians_lie_in_the_middle() -> None:
    bank = linear_bank()
    idle = replace(bank, predicted={NONE: 0.0 * bank.predicted[NONE] + observation_arrays().values})
    (row,) = tables.plant_evidence(idle)
    assert 0.45 < row.edge <= 0.5
    assert row.at in bank.study.settings.unknowns


def test_effects_keep_their_values_as_machines_and_effects_are_added() -> None:
    settings = load_effects("effects").settings
    few: Any = settings.model_copy(update={"skipped": LEFT_OUT})
    assert np.array_equal(effect_points(few, 8, 4), effect_points(few, 0, 12)[8:])
    every: Any = settings
    place = list(every.used).index("lap")
    assert np.array_equal(effect_points(every, 0, 4)[:, place], effect_points(few, 0, 4)[:, 0])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"path": "effect.flap"}, "effects.lap: path: effect: 'flap' is not one of"),
        (
            {"path": "hydraulics.actuators.*.leak_rate", "unit": "1/s"},
            "effects.lap: allowed: one number",
        ),
    ],
)
def test_effects_that_are_none_are_refused(changes: dict[str, Any], message: str) -> None:
    lap = load_effects("effects").settings.model_dump(exclude_none=True)["effects"]["lap"]
    with pytest.raises(ValueError, match=message):
        load_effects("effects", changes={"effects": {"lap": lap | changes}})


def test_too_few_draws_are_refused() -> None:
    with pytest.raises(InputError, match="^draws: 16 is refused; allowed: at least 30, as numbers"):
        load_effects("effects", changes={"draws": 16})
    assert load_effects("effects", quick=True).settings.draws == 32


@pytest.mark.slow
def test_a_study_weighs_shipped_effects_and_one_of_a_path_of_its_own(tmp_path: Path) -> None:
    """Cut off and resumed it has the same bits; oil that is not displaced softens."""
    more = {"path": "hydraulics.cap_dead_volume", "low": 0.0, "high": 0.5, "unit": "gal"}
    every = load_effects("effects").settings.model_dump(exclude_none=True)["effects"]
    own = {"dead": more | {"effect": "value", "source": "test"}, "lap": every["lap"]}
    study = load_effects("effects", changes=SMALL | {"effects": own})
    bank = run_effects(study, tmp_path / "one", jobs=1, backend="threading")
    assert list(bank.predicted) == [NONE, "dead", "lap", "dead+lap"]
    assert all(made.shape == (64, 12) for made in bank.predicted.values())
    assert not np.array_equal(bank.predicted["dead"], bank.predicted[NONE], equal_nan=True)
    again = tmp_path / "again"
    again.mkdir()
    for name in ("study.json", "journal.jsonl"):
        lines = (tmp_path / "one" / name).read_bytes().splitlines(keepends=True)
        (again / name).write_bytes(b"".join(lines[: 9 if name != "study.json" else None]))
    other = run_effects(study, again, jobs=1, backend="threading")
    assert other.verdicts == bank.verdicts
    assert np.array_equal(other.predicted["lap"], bank.predicted["lap"], equal_nan=True)
    assert {row.plant for row in tables.verdicts(bank)} == {NONE, "dead", "lap", AVERAGE}
    every = tables.effect_tables(bank)
    assert all(len(table.table.cells) >= 3 for table in every.values())
