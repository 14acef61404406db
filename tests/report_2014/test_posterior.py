"""The unknown: sampling against closed forms, evidence by hand, statements from raw samples."""

import re
from pathlib import Path
from typing import Any

import control
import numpy as np
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from cmf_mj import Hexapod, load_law
from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.analysis.linear.poles import loop_damping
from cmf_mj.cli.common import app
from cmf_mj.core.units import FRAME
from cmf_mj.machine.geometry import DOFS
from cmf_mj.report_2014.posterior import answers, evidence
from cmf_mj.report_2014.posterior.run import GROUPS, TABLES, Results, run_posterior
from cmf_mj.report_2014.posterior.study import PosteriorStudy, load_posterior
from cmf_mj.studies.case import swing_after_step
from cmf_mj.studies.engine import JOURNAL, row_table
from cmf_mj.studies.fit import sampling

LEAKS = "hydraulics.actuators.*.leak_rate"
ROOT = Path(__file__).resolve().parents[2]

SMALL = {
    "laws": ["velocity", "position_error_rate", "acceleration_eq_3_6", "acceleration_d2"],
    "cabs": ["gfd", "ifd"],
    "rounds": 3,
    "draws": 8,
    "kept": 6,
    "simulated": 1,
    "gains": [0.0, -0.08],
    "corners": [2.485],
}


@pytest.fixture(scope="module")
def study() -> PosteriorStudy:
    return load_posterior("rotation", changes=SMALL)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("posterior")


@pytest.fixture(scope="module")
def results(study: PosteriorStudy, folder: Path) -> Results:
    return run_posterior(study, folder, jobs=1, backend="threading")


def sampled(
    size: int, count: int, matrix: np.ndarray, told: np.ndarray, error: float
) -> tuple[np.ndarray, np.ndarray]:
    """Points of four rounds under a linear model with Gaussian errors, and their weights."""

    def likelihood(_: int, points: np.ndarray) -> np.ndarray:
        return np.asarray(-0.5 * (((points @ matrix.T - told) / error) ** 2).sum(axis=1))

    drawn = sampling.importance(likelihood, size, count, 4, 1)
    return drawn.points, drawn.weights


def test_sampling_gives_the_posterior_of_a_linear_model() -> None:
    """Prior N(0, 1), y = A z + e: covariance (1 + A'A / s^2)^-1, mean of it times A'y / s^2."""
    generator = np.random.default_rng(5)
    matrix, told = generator.normal(size=(6, 8)) / np.sqrt(8.0), generator.normal(size=6)
    points, weights = sampled(8, 512, matrix, told, 0.4)
    covariance = np.linalg.inv(np.eye(8) + matrix.T @ matrix / 0.16)
    mean = covariance @ matrix.T @ told / 0.16
    size = sampling.effective_size(weights)
    assert size > 300.0
    error = np.sqrt(np.diag(covariance) / size)
    assert np.abs((weights @ points - mean) / error).max() < 4.0
    spread = (points - mean).T @ ((points - mean) * weights[:, None])
    np.testing.assert_allclose(spread, covariance, atol=5.0 / np.sqrt(size))


def test_without_evidence_the_prior_comes_back() -> None:
    points, weights = sampled(3, 1024, np.zeros((1, 3)), np.zeros(1), 1.0)
    assert sampling.effective_size(weights) > 3000.0
    np.testing.assert_allclose(weights @ points, 0.0, atol=0.06)
    np.testing.assert_allclose(weights @ points**2, 1.0, atol=0.1)


def test_weights_quantiles_and_resampling() -> None:
    weights = np.array([0.1, 0.2, 0.3, 0.4])
    assert sampling.effective_size(weights) == pytest.approx(1.0 / 0.3)
    assert sampling.effective_size(np.ones(7)) == pytest.approx(7.0)
    indices = sampling.resampled(weights, 1000, 3)
    np.testing.assert_allclose(np.bincount(indices) / 1000.0, weights, atol=1e-3)
    values = np.random.default_rng(1).normal(size=20_000)
    # Weights e^x move a normal distribution by 1.
    moved = sampling.weighted_quantiles(values, np.exp(values), np.array([0.05, 0.5, 0.95]))
    np.testing.assert_allclose(moved, [1.0 - 1.645, 1.0, 1.0 + 1.645], atol=0.08)
    assert np.isnan(sampling.weighted_quantiles(np.full(3, np.nan), np.ones(3), moved)).all()


def test_the_scatter_of_table_4_1_is_as_by_hand() -> None:
    """2.75, 2.62, 2.72 and 2.94; 3.59, 3.62, 3.32 and 4.0 Hz; 0.5, 0.5, 0.7 and 0.4."""
    by_hand = [
        np.log([2.75, 2.62, 2.72, 2.94]),
        np.log([3.59, 3.62, 3.32, 4.0]),
        [0.5, 0.5, 0.7, 0.4],
    ]
    np.testing.assert_allclose(
        list(evidence.scatter().values()), [np.std(row, ddof=1) for row in by_hand]
    )
    misses = np.log(np.array([2.75, 2.62, 2.72]) / 2.94)
    assert evidence.discrepancy() == pytest.approx(np.sqrt(np.mean(misses**2)))
    assert 0.08 < evidence.discrepancy() < 0.1


def test_the_fits_have_the_gain_at_1_hz_and_the_pair_that_are_printed() -> None:
    """Their static gains are 0.300, 0.294 and 0.286 in/s per %; pairs at 12.3, 8.9 and 8.7 Hz."""
    told = {one.name: one for one in evidence.observations()[:-1]}
    si = 0.0254 * 100.0
    assert 0.27 * si < told["gain_1_hz"].value < 0.3 * si
    assert told["pair_hz"].value == pytest.approx((12.273 * 8.886 * 8.685) ** (1 / 3), rel=1e-3)
    damping = (0.16565 * 0.47217 * 0.31805) ** (1 / 3)
    assert told["pair_damping"].value == pytest.approx(damping, rel=1e-3)
    assert len(told) == 6 + 5


def test_likelihood_is_that_of_independent_gaussians() -> None:
    perfect = {one.name: one.value for one in evidence.observations()}
    names = list(perfect)
    one = evidence.observations()[names.index("velocity_phase_bandwidth_hz")]
    away = perfect | {one.name: one.value * np.exp(2.0 * one.deviation)}
    missing = perfect | {"original_damping_ratio": float("nan")}
    found = evidence.log_likelihoods(evidence.transformed_predictions([perfect, away, missing]))
    expected = np.zeros_like(found)
    expected[1, names.index(one.name)] = -2.0
    expected[2, names.index("original_damping_ratio")] = -32.0
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_force_feedback_swings_with_the_supply_pressure() -> None:
    """Amplitudes are those of the pressure, in proportion within a tenth; a page has the first."""
    low, high = evidence.oscillation_g(1500.0), evidence.oscillation_g(3000.0)
    text = (ROOT / "docs" / "explanation" / "deviations.md").read_text(encoding="utf-8")
    assert re.findall(r"(\d\.\d\d) g\b", text) == [f"{low:.2f}"]
    assert high / low == pytest.approx(2.0, rel=0.1)
    likely = evidence.oscillation_log_likelihood(
        np.array([1300.0, 2000.0, 3000.0]), np.array([1.6, 2.1, 2.7, 3.3])
    )
    assert (np.diff(likely) > 0.0).all()


def two_pairs(first: tuple[float, float], second: tuple[float, float]) -> control.StateSpace:
    """Six uncoupled axes: surge and pitch have the first pair [Hz, 1], the others the second."""
    blocks = []
    for dof in DOFS:
        hertz, ratio = first if dof in ("surge", "pitch") else second
        w = 2.0 * np.pi * hertz
        a = [[0.0, 1.0], [-(w**2), -2.0 * ratio * w]]
        blocks.append(control.ss(a, [[0.0], [w**2]], [[1.0, 0.0]], 0))
    return control.sample_system(control.append(*blocks), FRAME, method="zoh")


def test_each_degree_of_freedom_has_the_damping_of_its_own_poles() -> None:
    found = loop_damping(two_pairs((3.0, 0.05), (11.0, 0.2)))
    expected = {dof: 0.05 if dof in ("surge", "pitch") else 0.2 for dof in DOFS}
    assert {dof: found[dof] for dof in DOFS} == pytest.approx(expected, rel=1e-6)
    assert (found["pair"], found["pair_hz"]) == pytest.approx((0.05, 3.0), rel=1e-6)
    assert found["stable"]
    growing = loop_damping(two_pairs((3.0, -0.01), (11.0, 0.2)))
    assert not growing["stable"]
    assert growing["least"] == pytest.approx(-0.01, rel=1e-6)


def test_a_machine_without_changes_is_the_shipped_one(study: PosteriorStudy) -> None:
    plain = Linear(Hexapod("ifd"))
    factors = ("cab_mass", "cab_inertia", "platform_mass", "leg_mass")
    values = dict.fromkeys(study.settings.unknowns, 0.0) | dict.fromkeys(factors, 1.0)
    shipped = study.hydraulics.quantities()
    values |= {name: shipped[name].value for name in values if name in shipped}
    values["derivative_pole"] = load_law("position_error_rate").derivative_pole
    cab = study.cabs[1]
    machine = Linear(study.plant(cab, values, study.hydraulics_of(values, None)))
    law = study.law(load_law("position_error_rate"), values)
    expected = plain.damping(load_law("position_error_rate"))
    assert machine.damping(law) == pytest.approx(expected, rel=1e-6, abs=1e-9)
    heavy = values | {"cab_height": 0.5}
    higher = Linear(study.plant(cab, heavy, study.hydraulics_of(heavy, None)))
    assert higher.damping(law)["pair"] < expected["pair"] - 0.01


@pytest.mark.parametrize(("law", "stable"), [("velocity", True), ("acceleration_d2", False)])
def test_simulated_and_linear_verdicts_are_one(law: str, stable: bool) -> None:
    plant, loaded = Hexapod("gfd"), load_law(law)
    assert Linear(plant).damping(loaded)["stable"] is stable
    assert swing_after_step(plant, loaded)["stable"] is stable


def test_rounds_and_tables(results: Results, folder: Path) -> None:
    count = 3 * 8
    assert results.machines.num_rows == count
    assert results.damping.num_rows == count * 4 * 2
    assert sum(row["count"] for row in results.gains.to_pylist()) == 6 * 2 * 2
    assert results.points.num_rows == (1 + 2 * 14) * 4
    assert answers.weights(results).sum() == pytest.approx(1.0)
    assert {path.stem for path in folder.glob("*.parquet")} == set(TABLES)
    with np.errstate(divide="ignore"):
        total = sum(answers.column(results.machines, f"log_{group}") for group in GROUPS)
    assert (answers.weights(results)[~np.isfinite(total)] == 0.0).all()


def test_a_run_that_was_cut_off_goes_on_with_the_same_bits(
    study: PosteriorStudy, results: Results, folder: Path, tmp_path: Path
) -> None:
    lines = (folder / JOURNAL).read_text().splitlines(keepends=True)
    (tmp_path / "study.json").write_bytes((folder / "study.json").read_bytes())
    (tmp_path / JOURNAL).write_text("".join(lines[:-3]))
    run_posterior(study, tmp_path, jobs=1, backend="threading")
    for name in TABLES:
        again, whole = (there / f"{name}.parquet" for there in (tmp_path, folder))
        assert again.read_bytes() == whole.read_bytes()


def test_a_column_that_the_first_row_lacks_reaches_the_file() -> None:
    rows: list[dict[str, Any]] = [{"a": 1.0}, {"a": 2.0, "b": 3.0}]
    assert row_table(rows).to_pylist() == [{"a": 1.0, "b": None}, rows[1]]


def raw(folder: Path, name: str) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = pq.read_table(folder / f"{name}.parquet").to_pylist()
    return rows


def test_statements_follow_from_the_raw_samples(results: Results, folder: Path) -> None:
    """The probability of `acceleration_d2`, the size of +0.01 and the gains, recomputed."""
    machines, damping = raw(folder, "machines"), raw(folder, "damping")
    weight = [row["weight"] for row in machines]
    unstable = sum(
        weight[row["machine"]]
        for row in damping
        if (row["law"], row["cab"]) == ("acceleration_d2", "gfd") and not row["stable"]
    )
    at = {(row.law, row.cab): row for row in answers.stability(results)}
    said = at["acceleration_d2", "gfd"]
    assert said.posterior[1] == pytest.approx(unstable)
    pair = {(r["law"], r["machine"]): r["pair"] for r in damping if r["cab"] == "gfd"}
    moved = [
        (pair["acceleration_eq_3_6", i] - pair["position_error_rate", i], weight[i])
        for i in range(len(machines))
    ]
    changes = {(row.law, row.cab): row for row in answers.damping_changes(results)}
    change = changes["acceleration_eq_3_6", "gfd"]
    values = np.array([value for value, _ in moved])
    prior = sampling.normalised(np.array([row["log_ratio"] for row in machines]))
    for weights, said_of in ((np.array(weight), change.posterior), (prior, change.prior)):
        quantiles = sampling.weighted_quantiles(values, weights, answers.LEVELS)
        assert said_of == pytest.approx(quantiles)
    below = sum(w for value, w in moved if value < change.posterior[1])
    above = sum(w for value, w in moved if value > change.posterior[1])
    assert below <= 0.5 + 1e-9 and above <= 0.5 + max(weight)
    tried: dict[tuple[float, float], dict[int, list[dict[str, Any]]]] = {}
    for row in raw(folder, "gains"):
        machines_of = tried.setdefault((row["corner"], row["gain"]), {})
        machines_of.setdefault(row["machine"], []).append(row)
    good = {
        step: sum(all(r["stable"] for r in each) * each[0]["count"] for each in tested.values()) / 6
        for step, tested in tried.items()
    }
    steps = {(one.corner, one.gain): one.stable[1] for one in answers.gain_steps(results)}
    assert steps == pytest.approx(good)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"draws": 12}, "draws: 12 must be a power of 2"),
        ({"simulated": 7}, "simulated: 7 must be at most kept, 6"),
        ({"laws": ["fast"]}, "law: 'fast' is not one of"),
        ({"cabs": ["bus"]}, "cab: 'bus'"),
    ],
)
def test_bad_specifications_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        load_posterior("rotation", changes=SMALL | changes)


def test_bounds_that_cannot_be_are_refused() -> None:
    """Of an unknown's own form: tests/facility/test_unknowns.py."""
    one = {"unit": "1", "source": "test", "path": LEAKS, "low": 0.5, "high": 1.0}
    height = {"unit": "m", "path": "cab.centre_of_mass.z", "effect": "offset", "low": -9.0}
    for unknown, message in ((one, "one number"), (one | height, "below the floor")):
        with pytest.raises(ValueError, match=message):
            load_posterior("rotation", changes=SMALL | {"unknowns": {"one": unknown}})


@pytest.mark.slow
def test_the_command_writes_tables_and_readable_figures(
    tmp_path: Path, drawn: dict[str, set[str]]
) -> None:
    lines = (f"{name} = {value!r}\n".replace("'", '"') for name, value in SMALL.items())
    (tmp_path / "mine.toml").write_text('base = "rotation"\n' + "".join(lines))
    command = ["study", str(tmp_path / "mine.toml"), "--out", str(tmp_path / "out"), "--jobs", "2"]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    assert "24 machines drawn" in result.output
    assert set(drawn) >= {"tornado.png", "bandwidths.png", "gains.png"}
    for name in ("stability", "changes", "spans", "gains", "unknowns", "evidence"):
        assert (tmp_path / "out" / f"{name}.md").read_text()
