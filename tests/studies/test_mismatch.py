"""Mismatch and its measures: distributions, sensor gains, the linear method, intervals."""

import control
import numpy as np
import pyarrow as pa
import pytest
from scipy import stats

from cmf_mj import Hexapod, load_hydraulics
from cmf_mj.analysis.linear import linear
from cmf_mj.control.feedback import LegFeedback
from cmf_mj.core.units import FRAME
from cmf_mj.electronics.sensors.channel import load_sensors
from cmf_mj.electronics.sensors.suite import make_sensors, sense_history
from cmf_mj.machine.geometry import DOFS
from cmf_mj.plant.parameters.hydraulics import HydraulicParameters
from cmf_mj.studies import effects
from cmf_mj.studies.evaluation import StudyRow, evaluate
from cmf_mj.studies.mismatch import LIMIT, Mismatch, Spread, with_gain_errors
from cmf_mj.studies.settings import NOMINAL, load_study

HARDWARE = load_hydraulics("hardware")
NAMES = tuple(f"leg_{i}" for i in range(1, 7))
KNOWN = {"status": "assumed", "source": "test"}


def spread(**changes: object) -> Spread:
    return Spread.model_validate({"distribution": "normal", "deviation": 5.0, **KNOWN} | changes)


def values(drawn: HydraulicParameters, field: str, valve: int | None = None) -> np.ndarray:
    return np.array([drawn.actuator(name, valve)[field].si for name in NAMES])


@pytest.mark.parametrize(
    ("distribution", "sd"),
    [
        ("normal", 0.05 * np.sqrt(stats.truncnorm.var(-LIMIT, LIMIT))),
        ("uniform", 0.05 / np.sqrt(3.0)),
    ],
)
def test_samples_have_the_deviation_and_the_bounds_they_say(distribution: str, sd: float) -> None:
    """Standard deviations in closed form, within four of the standard errors."""
    sample = spread(distribution=distribution).sample(np.random.default_rng(1), (20000,))
    assert np.std(sample) == pytest.approx(sd, rel=4.0 / np.sqrt(2.0 * 20000))
    assert abs(sample.mean()) < 4.0 * sd / np.sqrt(20000)
    assert np.abs(sample).max() <= (0.05 if distribution == "uniform" else LIMIT * 0.05)


def test_a_lognormal_factor_is_as_often_doubled_as_halved() -> None:
    sample = 1.0 + spread(distribution="lognormal", deviation=30.0).sample(
        np.random.default_rng(1), (20001,)
    )
    assert np.median(sample) == pytest.approx(1.0, abs=0.02)
    assert np.log(sample).max() <= LIMIT * 0.3
    assert np.log(sample).min() >= -LIMIT * 0.3


def test_a_machine_drawn_is_the_same_for_all_laws_and_with_more_spreads() -> None:
    few = Mismatch(hydraulics={"leak_rate": spread()})
    more = Mismatch(hydraulics={"valve_flow": spread(per="valve"), "leak_rate": spread()})
    one, again, other = (few.draw_hydraulics(HARDWARE, NAMES, 7, draw) for draw in (3, 3, 4))
    assert one == again
    assert not np.allclose(values(one, "leak_rate"), values(other, "leak_rate"))
    both = more.draw_hydraulics(HARDWARE, NAMES, 7, 3)
    assert values(both, "leak_rate").tobytes() == values(one, "leak_rate").tobytes()
    assert len(set(values(both, "valve_flow", 0)) | set(values(both, "valve_flow", 1))) == 12
    assert len(set(values(one, "valve_flow", 0))) == 1


def test_an_offset_is_added_to_a_bias_of_nothing() -> None:
    mismatch = Mismatch(hydraulics={"null_bias": spread(effect="offset", deviation=1.0)})
    bias = values(mismatch.draw_hydraulics(HARDWARE, NAMES, 0, 0), "null_bias")
    assert 0.0 < np.abs(bias).max() <= 0.02
    assert (bias < 0.0).any()


@pytest.mark.parametrize(
    ("mismatch", "message"),
    [
        ({"hydraulics": {"pump_flow": spread()}}, "'pump_flow' cannot differ from actuator"),
        (
            {"hydraulics": {"leak_rate": spread(per="valve")}},
            "'leak_rate' cannot differ from valve",
        ),
        (
            {"hydraulics": {"leak_rate": spread(effect="offset")}},
            "leak_rate: effect must be factor",
        ),
        ({"sensor_gains": {"platform_gyro": spread()}}, "'platform_gyro' is not one of leg_pos"),
        ({"sensor_gains": {"leg_position": spread(per="valve")}}, "must be a factor per actuator"),
    ],
)
def test_what_cannot_scatter_is_refused(mismatch: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Mismatch.model_validate(mismatch).check()


def test_a_sensor_with_a_gain_error_reads_in_proportion() -> None:
    errors = np.array([0.01, -0.02, 0.0, 0.03, -0.04, 0.05])
    electronics = with_gain_errors({"leg_velocity": errors})
    assert electronics is not None
    sensors = make_sensors(load_sensors(electronics.sensors), 1.0 / FRAME)
    truth = LegFeedback(*np.random.default_rng(0).normal(size=(5, 3, 6)))
    read, _ = sense_history(sensors, truth)
    assert read.velocity == pytest.approx(truth.velocity * (1.0 + errors), rel=1e-12)
    assert read.position.tobytes() == truth.position.tobytes()
    assert with_gain_errors({}) is None


def test_gains_that_are_not_one_a_leg_are_refused() -> None:
    electronics = with_gain_errors({"leg_velocity": np.zeros(5)})
    assert electronics is not None
    sensors = make_sensors(load_sensors(electronics.sensors), 1.0 / FRAME)
    with pytest.raises(ValueError, match=r"leg_velocity.gain_errors: 5 are given; allowed: 6"):
        sense_history(sensors, LegFeedback(*np.zeros((5, 3, 6))))
    with pytest.raises(ValueError, match=r"gain_errors: 1 1 must be between -1 and 1"):
        with_gain_errors({"leg_velocity": np.ones(6)})


def test_step_responses_in_blocks_are_those_of_the_library() -> None:
    generator = np.random.default_rng(3)
    matrix = generator.normal(size=(5, 5))
    matrix *= 0.98 / np.abs(np.linalg.eigvals(matrix)).max()
    system = control.ss(
        matrix,
        generator.normal(size=(5, 2)),
        generator.normal(size=(2, 5)),
        generator.normal(size=(2, 2)),
        FRAME,
    )
    steps = linear._steps(system)
    time = np.arange(200) * FRAME
    for i in range(2):
        expected = control.step_response(system, time, input=i).outputs[:, 0]
        assert steps[:200, :, i].T == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.fixture(scope="module")
def measured() -> dict[tuple[str, int], list[StudyRow]]:
    """The velocity law, nominal and drawn, linear and simulated."""
    study = load_study(
        {
            "title": "test",
            "method": "linear",
            "laws": ["velocity"],
            "draws": 1,
            "simulate_every": 1,
            "mismatch": {
                "hydraulics": {
                    "valve_flow": spread(per="valve").model_dump(),
                    "leak_rate": spread(distribution="lognormal", deviation=30.0).model_dump(),
                },
                "sensor_gains": {"leg_velocity": spread(deviation=1.0).model_dump()},
            },
        }
    )
    chosen = [c for c in study.cases if (c.method, c.draw) != ("matrix", NOMINAL)]
    return {(case.method, case.draw): evaluate(case) for case in chosen}


def test_a_symmetric_machine_keeps_its_halves_apart_and_a_drawn_one_does_not(
    measured: dict[tuple[str, int], list[StudyRow]],
) -> None:
    """Surge, heave and pitch move in the plane of symmetry; sway, roll and yaw out of it."""
    inside = {"surge", "heave", "pitch"}
    for row in measured["linear", NOMINAL]:
        for moved in set(DOFS) - {row.dof}:
            value = row.crosstalk[DOFS.index(moved)]
            if (row.dof in inside) != (moved in inside):
                assert value < 1e-6, (row.dof, moved)
    surge = measured["linear", 0][0]
    assert surge.crosstalk[1] > 0.05
    assert np.isnan(surge.crosstalk[0])


def test_the_linear_method_agrees_with_the_simulation_on_a_drawn_machine(
    measured: dict[tuple[str, int], list[StudyRow]],
) -> None:
    """-90 deg within 4 %, damping ratio within 0.04, verdicts alike: six degrees of freedom."""
    rows = zip(measured["linear", 0], measured["matrix", 0], strict=True)
    for one, other in ((a.measures, b.measures) for a, b in rows):
        assert one.stable
        assert other.stable
        assert one.phase_bandwidth_hz == pytest.approx(other.phase_bandwidth_hz, rel=0.04)
        assert one.damping_ratio == pytest.approx(other.damping_ratio, abs=0.04)
        assert one.peak_gain_db == pytest.approx(other.peak_gain_db, abs=1.5)


def test_shares_have_wilsons_interval() -> None:
    """(p + z^2/2n +- z sqrt(p(1-p)/n + z^2/4n^2)) / (1 + z^2/n), 8 of 10."""
    interval = effects.share([True] * 8 + [False] * 2)
    z, n, p = stats.norm.ppf(0.975), 10, 0.8
    middle = (p + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2)) / (1 + z**2 / n)
    assert interval == pytest.approx((0.8, middle - half, middle + half, 10))
    assert effects.share([]).machines == 0


def test_damped_counts_the_overshoot_of_a_damping_ratio_of_three_tenths() -> None:
    """exp(-pi 0.3 / sqrt(1 - 0.09)) = 0.3723."""
    columns = {"stable": [True, True, False, True], "overshoot": [0.372, 0.373, 0.0, float("nan")]}
    assert effects.damped(pa.table(columns)).tolist() == [True, False, False, False]


def test_the_plant_of_a_drawn_machine_has_the_numbers_drawn() -> None:
    mismatch = Mismatch(hydraulics={"leak_rate": spread(distribution="lognormal")})
    drawn = mismatch.draw_hydraulics(HARDWARE, NAMES, 0, 0)
    plant = Hexapod("gfd", drawn)
    assert len(set(plant.hydraulics.cylinder.leakage)) == 6
