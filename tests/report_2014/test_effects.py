"""Effects of a linear plant against closed forms, and readings against those of the linear room."""

import numpy as np
import pytest

from cmf_mj import Hexapod, Linear, load_hydraulics, load_law
from cmf_mj.machine.geometry import DOFS
from cmf_mj.plant.cylinder import friction_slope, stiffness
from cmf_mj.report_2014.posterior import effects, evidence
from cmf_mj.report_2014.posterior.effects import (
    EFFECTS,
    SPEEDS,
    LinearPlant,
    lap_gain,
    with_effects,
)


@pytest.fixture(scope="module")
def linear() -> Linear:
    return Linear(Hexapod("gfd"))


def response(part: LinearPlant, hertz: float, kind: int = 1) -> np.ndarray:
    """From commands to one kind of feedback, (6, 6)."""
    s = 2j * np.pi * hertz
    inside = s * np.eye(part.a.shape[0]) - part.a
    return part.c[6 * kind : 6 * kind + 6] @ np.linalg.solve(inside, part.b.astype(complex))


@pytest.mark.parametrize("law", ["velocity", "acceleration", "velocity_integral"])
def test_a_loop_without_effects_is_that_of_the_linear_room(linear: Linear, law: str) -> None:
    assert effects.damping(linear, {}, load_law(law)) == pytest.approx(
        linear.damping(law), rel=1e-6, abs=1e-9
    )


def test_a_machine_without_effects_shows_what_evidence_predicts(linear: Linear) -> None:
    expected = evidence.fit_features(linear.model("heave")["heave_rate", :])
    for law in (*evidence.ROW_TABLES, evidence.HELD_OUT_LAW):
        heave = linear.measures(law)[DOFS.index("heave")]
        for name in evidence.ROW_FIELDS:
            expected[f"{law}_{name}"] = getattr(heave, name)
    shown = effects.predictions({"gfd": linear}, {})
    assert {name: shown[name] for name in expected} == pytest.approx(expected, rel=2e-3)
    assert shown["flown"] is True


def test_every_effect_of_no_size_changes_nothing(linear: Linear) -> None:
    plain = effects.predictions({"gfd": linear}, {})
    for name in EFFECTS:
        none = 1.0 if name == "measured_mass" else 0.0
        assert effects.predictions({"gfd": linear}, {name: none}) == pytest.approx(
            plain, rel=5e-3
        ), name


def test_lap_halves_doubles_and_shuts_a_valve() -> None:
    """From the fundamental of a sine through the lap, by quadrature."""
    angle = np.linspace(0.0, 2.0 * np.pi, 20001)
    for ratio in (0.3, 0.8, -0.3, -0.8):
        sine, lap = np.sin(angle), abs(ratio)
        over = np.sign(sine) * np.maximum(np.abs(sine) - lap, 0.0)
        under = sine + np.clip(sine, -lap, lap)
        shape = over if ratio > 0.0 else under
        fundamental = np.trapezoid(shape * sine, angle) / np.pi
        assert lap_gain(ratio) == pytest.approx(fundamental, abs=1e-6)
    assert (lap_gain(0.0), lap_gain(2.0), lap_gain(-2.0)) == (1.0, 0.0, 2.0)


def test_dead_time_and_lags_turn_the_phase(linear: Linear) -> None:
    part, hertz, time = LinearPlant.of(linear), 3.0, 0.004
    s = 2j * np.pi * hertz
    for name, ratio in (
        ("dead_time", (1.0 - 0.5 * s * time) / (1.0 + 0.5 * s * time)),
        ("second_lag", 1.0 / (1.0 + s * time)),
        ("velocity_filter", 1.0 / (1.0 + s * time)),
    ):
        later = response(with_effects(part, {name: time}, 0.1), hertz)
        np.testing.assert_allclose(later, ratio * response(part, hertz), rtol=1e-6)
    assert np.angle((1.0 - 0.5 * s * time) / (1.0 + 0.5 * s * time)) == pytest.approx(
        -abs(s) * time, rel=1e-3
    )


def test_coulomb_damps_as_the_describing_function_of_sliding() -> None:
    """The same as the linear room has of a set with friction that slides at this speed."""
    force, speed = 600.0, 0.1
    base = load_hydraulics("hardware")
    numbers = {"coulomb_friction": force, "breakaway_friction": force}
    oil = base.model_copy(
        update={
            name: getattr(base, name).model_copy(update={"value": value, "unit": "N"})
            for name, value in numbers.items()
        }
    )
    rubbed = Linear(Hexapod("gfd", oil), friction=speed)
    slope = friction_slope(rubbed.plant.hydraulics.friction, speed).damping
    np.testing.assert_allclose(slope, 4.0 * force / (np.pi * speed))
    mine = with_effects(LinearPlant.of(Linear(Hexapod("gfd"))), {"coulomb": force}, speed)
    np.testing.assert_allclose(mine.a, LinearPlant.of(rubbed).a, rtol=1e-6, atol=1e-3)


def test_give_in_series_softens_the_oil(linear: Linear) -> None:
    """Springs in series: 1 / K' = (1 + x) / K, read off what a piston that moves presses."""
    part, share = LinearPlant.of(linear), 0.5
    areas = part.areas
    rows = [part.states("cap_pressure")[0], part.states("rod_pressure")[0]]
    speed = part.states("leg_velocity")[0]
    oil = stiffness(linear.plant.hydraulics.cylinder[0], 100000.0 * 6894.757, 0.0)
    assert -areas @ part.a[rows, speed] == pytest.approx(float(oil), rel=1e-2)
    soft = with_effects(part, {"compliance": share}, 0.1)
    ratio = (areas @ soft.a[rows, speed]) / (areas @ part.a[rows, speed])
    assert ratio == pytest.approx(1.0 / (1.0 + share))
    still = response(soft, 0.05, 0) / response(part, 0.05, 0)
    np.testing.assert_allclose(np.abs(np.diag(still)), 1.0, rtol=0.02)


def test_mass_and_air_move_the_pair_in_heave(linear: Linear) -> None:
    """As the root of stiffness over mass; air in one of two chambers softens half of the oil."""
    plain = effects.predictions({"gfd": linear}, {})["pair_hz"]
    heavy = effects.predictions({"gfd": linear}, {"measured_mass": 1.2})["pair_hz"]
    assert heavy == pytest.approx(plain / np.sqrt(1.2), rel=0.02)
    airy = effects.predictions({"gfd": linear}, {"soft_cap": 0.5})["pair_hz"]
    assert np.sqrt(1.0 / 1.5) * plain < airy < plain


def test_the_pair_is_that_of_heave_not_the_least_damped_of_all(linear: Linear) -> None:
    """Modes of roll and pitch lie near, with less damping and hardly felt."""
    modes = {m.frequency / (2 * np.pi): m for m in linear.modes() if 4 < m.frequency / 6.2832 < 25}
    heave = max(modes.values(), key=lambda m: m.dof_shares[DOFS.index("heave")])
    assert min(m.damping_ratio for m in modes.values()) < heave.damping_ratio
    found = evidence.fit_features(linear.model("heave")["heave_rate", :])
    assert found["pair_hz"] == pytest.approx(heave.frequency / (2 * np.pi), rel=1e-3)
    assert found["pair_damping"] == pytest.approx(heave.damping_ratio, rel=1e-3)


def test_speeds_are_those_of_the_tests() -> None:
    """0.33 in in heave: 0.832 of it at a leg, at the printed -90 deg, gain of 0.8."""
    for law, hertz in (("original", 1.8), ("velocity", 2.94)):
        assert SPEEDS[law] == pytest.approx(
            2.0 * np.pi * hertz * 0.832 * 0.33 * 0.0254 * 0.8, rel=0.01
        )
    assert SPEEDS["fits"] == pytest.approx(2.0 * np.pi * 0.832 * 0.0254, rel=0.01)


def test_what_was_measured_otherwise_flies_as_before(linear: Linear) -> None:
    law = load_law("velocity")
    plain = effects.damping(linear, {}, law)
    assert effects.damping(linear, {"measured_mass": 1.3}, law) == plain
    assert effects.damping(linear, {"viscous": 2e4}, law)["pair"] > plain["pair"]
