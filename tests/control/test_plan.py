"""Laws in hydraulic modes, the plan and load feedback: maps, closed forms, one law and one loop."""

import control
import numpy as np
import pytest

from cmf_mj import Hexapod, Law, SingleLegs, law_names, load_hydraulics, load_law, signals, simulate
from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.analysis.linear.loop import DCL_INPUTS, closed_loop, dcl_state_space
from cmf_mj.analysis.linear.plants import FEEDBACK
from cmf_mj.control import dcl as blocks
from cmf_mj.control.coordinates import MODES
from cmf_mj.control.dcl import DclState, make_dcl
from cmf_mj.control.engage import engaged_state
from cmf_mj.control.feedback import LegFeedback
from cmf_mj.control.inverse import load_opening
from cmf_mj.control.plan import response_polynomial
from cmf_mj.core.units import FRAME
from cmf_mj.facility.replay import replay
from cmf_mj.facility.unknowns import valve_gains, with_valve_gains
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.machine.models import CABS

STILL = LegFeedback(*(np.zeros(MODES) for _ in FEEDBACK))
INCH = 0.0254
POUND_FORCE = 0.45359237 * 9.80665
MODAL = load_law("modal_plan")

LEG_PLAN = {
    "name": "leg_plan",
    "title": "Plan for legs",
    "direct_gain": {},
    "plan": {
        "speed": 0.35,
        "drive_lag": 3.0,
        "valve_lag": 75.0,
        "leak_rate": 15.0,
        "frequency": 11.3,
        "pairs": [[8.0, 0.7], [20.0, 0.8]],
        "pole": 30.0,
        "rate": 100.0,
        "acceleration": 1e5,
        "smooth": 50.0,
        "approach": 6.0,
    },
}


def actuator_polynomial(plan, frequency):
    """D, ascending powers of s, of a leg or mode of this undamped frequency [rad/s]."""
    polynomial = np.array([0.0, 1.0])
    for corner in (plan.drive_lag, plan.valve_lag):
        polynomial = np.convolve(polynomial, [1.0, 1.0 / (2.0 * np.pi * corner)])
    return np.convolve(polynomial, [1.0, plan.leak_rate / frequency**2, 1.0 / frequency**2])


def law_of(**changes: object) -> Law:
    return Law.model_validate(LEG_PLAN | changes)


def in_modes(law: Law, cab: str) -> Law:
    """A law of legs, run in the modes of a cab."""
    table = law.model_dump(mode="json")
    modes = {cab: MODAL.modes[cab].model_dump(mode="json")}
    return Law.model_validate(table | {"coordinates": "hydraulic_modes", "modes": modes})


def histories(frames: int = 400, scale: float = 1.0) -> tuple[np.ndarray, LegFeedback]:
    rng = np.random.default_rng(4)

    def noise(size: float) -> np.ndarray:
        return scale * size * rng.uniform(-1.0, 1.0, (frames, MODES))

    return noise(0.4), LegFeedback(noise(0.4), noise(1.0), noise(10.0), noise(5e6), noise(5e6))


def outputs(law: Law, demand: np.ndarray, feedback: LegFeedback) -> tuple[np.ndarray, DclState]:
    dcl = make_dcl(law, MODES)
    state = DclState.zeros(MODES)
    found = np.empty(demand.shape)
    for k, wanted in enumerate(demand):
        now = LegFeedback(*(np.ascontiguousarray(channel[k]) for channel in feedback))
        blocks.step(dcl, state, wanted, now)
        found[k] = dcl.workspace.output
        limited = np.clip(wanted, -0.9525, 0.9525)
        np.testing.assert_array_equal(dcl.workspace.limited_demand, limited)
    return found, state


@pytest.mark.parametrize("name", ["velocity", "acceleration", "model_reference_adaptive"])
def test_modes_that_are_the_legs_give_the_same_bits(name: str) -> None:
    law = load_law(name)
    assert law.coordinates == "legs"
    demand, feedback = histories()
    plain, _ = outputs(law, demand, feedback)
    mapped, _ = outputs(in_modes(law, "single_legs"), demand, feedback)
    np.testing.assert_array_equal(mapped, plain)


@pytest.mark.parametrize("name", ["velocity_integral", "force", "model_following"])
def test_the_same_gain_in_every_mode_is_the_law_of_legs(name: str) -> None:
    """V k 1 V^T = k 1; round-off apart."""
    demand, feedback = histories(scale=0.1)
    law = load_law(name)
    plain, _ = outputs(law, demand, feedback)
    mapped, _ = outputs(in_modes(law, "gfd"), demand, feedback)
    np.testing.assert_allclose(mapped, plain, rtol=0, atol=1e-11 * np.abs(plain).max())


def nominal_leg(law: Law, hertz: float) -> control.StateSpace:
    """k / D of one leg, with position and velocity."""
    assert law.plan is not None
    own = actuator_polynomial(law.plan, 2.0 * np.pi * hertz)
    speed = law.plan.speed * INCH * 100.0
    leg = control.ss(control.tf([speed], own[::-1]))
    c = np.vstack([leg.C, leg.C @ leg.A])
    names = ["leg_position", "leg_velocity"]
    return control.ss(leg.A, leg.B, c, np.zeros((2, 1)), inputs=["command"], outputs=names)


RATES = [256, 1024, 2048]


@pytest.mark.parametrize("rate", RATES)
def test_the_plan_has_the_response_of_its_poles_at_every_rate(rate: int) -> None:
    """1/E of a reference held over a frame, sin(w T/2) / (w T/2) e^(-j w T/2), and its images."""
    law = law_of().at_rate(rate)
    dcl, state = make_dcl(law, MODES), DclState.zeros(MODES)
    omega = 2.0 * np.pi * 2.0
    found = np.empty(4 * rate)
    for k in range(found.size):
        blocks.step(dcl, state, np.full(MODES, 0.01 * np.sin(omega * k / rate)), STILL)
        found[k] = state.plan.position[0] / 0.01
    time = np.arange(3 * rate, 4 * rate) / rate
    held = -np.expm1(-1j * omega / rate) * rate / (1j * omega)
    response = held / np.polyval(response_polynomial(law.plan)[::-1], 1j * omega)
    expected = np.imag(response * np.exp(1j * omega * time))
    np.testing.assert_allclose(found[3 * rate :], expected, rtol=0, atol=1e-5)


def test_a_planned_leg_has_the_response_of_its_poles() -> None:
    """1/E behind a frame of delay and a reference held over one. A command that is held over a
    frame moves the leg otherwise than one that changes in it by the square of the frame; and so
    gains on errors from the plan find as little to do."""
    off, acted = {}, {}
    for rate in RATES[1:]:
        free = law_of().at_rate(rate)
        held = law_of(plan=LEG_PLAN["plan"] | {"position": 20.0, "velocity": 0.3}).at_rate(rate)  # type: ignore[operator]
        s = 2j * np.pi * np.linspace(0.2, 20.0, 60)
        one, other = (
            control.frequency_response(closed_loop(law, nominal_leg(law, 11.3)), s.imag).frdata[
                0, 0
            ]
            for law in (free, held)
        )
        delay = -np.expm1(-s / rate) * rate / s * np.exp(-s / rate)
        expected = delay / np.polyval(response_polynomial(free.plan)[::-1], s)
        off[rate], acted[rate] = np.abs(one - expected).max(), np.abs(one - other).max()
    assert off[2048] < 5e-4
    assert acted[2048] < 1e-4
    assert off[1024] / off[2048] == pytest.approx(4.0, rel=0.05)
    assert acted[1024] / acted[2048] == pytest.approx(4.0, rel=0.05)


def test_a_plan_that_does_not_overshoot_keeps_the_acceleration_of_its_reference() -> None:
    """p'' is r'' behind 1/E, whose impulse response is positive where its step does not overshoot:
    no more than the integral of that, 1, times the bound."""
    plan = LEG_PLAN["plan"] | {"pairs": [[8.0, 1.0], [20.0, 1.0]], "acceleration": 400.0}  # type: ignore[operator]
    law = law_of(plan=plan)
    dcl, state = make_dcl(law, MODES), DclState.zeros(MODES)
    found = np.empty(6144)
    for k in range(found.size):
        blocks.step(dcl, state, np.full(MODES, 20.0 * INCH * (k < 3072)), STILL)
        found[k] = state.plan.acceleration[0] / INCH
    assert 399.0 < np.abs(found).max() <= 400.0 * (1.0 + 1e-9)
    np.testing.assert_allclose(state.plan.position, 0.0, atol=1e-6)


@pytest.mark.parametrize("cab", CABS)
def test_planned_forces_are_those_of_the_machine_at_its_pose(cab: str) -> None:
    """M_leg l'' of the plant, within the half per cent that the legs' own inertia turns by."""
    law, plant = MODAL.bound_to(cab), Hexapod(cab)
    dcl, state = make_dcl(law, MODES), DclState.zeros(MODES)
    pose = np.array([-0.4, 0.3, -0.25, 0.12, -0.1, 0.15])
    legs = pose_to_legs(pose)
    state.plan.position[:] = state.plan.reference[:] = state.plan.demand[:] = dcl.shape @ legs
    for _ in range(50):
        blocks.step(dcl, state, legs, STILL)
    np.testing.assert_allclose(state.plan.pose, pose, atol=1e-9)
    state.plan.acceleration[:] = np.arange(1.0, 7.0)
    blocks.step(dcl, state, legs, STILL)
    work = dcl.plan.inverse
    expected = plant.reflected_mass(pose) @ work.leg_motion[2]
    np.testing.assert_allclose(work.leg_force[0], expected, atol=5e-3 * np.abs(expected).max())
    neutral = plant.reflected_mass(np.zeros(6)) @ work.leg_motion[2]
    assert np.abs(neutral - expected).max() > 0.1 * np.abs(expected).max()


@pytest.mark.parametrize("share", [0.05, 0.2])
def test_a_valve_against_its_load_opens_later(share: float) -> None:
    """z = Z cos, F = X F_s sin: the fundamental of z / g has Z 2 X / (3 pi) of the sine. Z is far
    above the rounding; the bend of loads takes X^2 / 2 of 0.8 squared."""
    plan = make_dcl(MODAL.bound_to("ifd"), MODES).plan.inverse
    angle = np.linspace(0.0, 2.0 * np.pi, 20000, endpoint=False)
    flow, load = 10.0 * np.cos(angle), share * plan.stall * np.sin(angle)
    pairs = [
        load_opening(plan, z, -10.0 * np.sin(a), f, share * plan.stall * np.cos(a))
        for z, a, f in zip(flow, angle, load, strict=True)
    ]
    more, rate = np.array(pairs).T
    lagging = 2.0 * np.mean(more * np.sin(angle)) / 10.0
    assert lagging == pytest.approx(2.0 * share / (3.0 * np.pi), rel=0.05)
    np.testing.assert_allclose(np.gradient(more, angle)[1:-1], rate[1:-1], atol=2e-3 * 10.0)


def reference_of(law: Law, demand: np.ndarray) -> np.ndarray:
    """Reference of the plan for leg demands (N, n), (N, n)."""
    dcl, found = make_dcl(law, MODES), np.empty(demand.shape)
    state = DclState.zeros(MODES)
    for k, wanted in enumerate(demand):
        blocks.step(dcl, state, wanted, STILL)
        found[k] = state.plan.reference
    return found


BOUNDED = law_of(plan=LEG_PLAN["plan"] | {"rate": 10.0, "acceleration": 400.0})  # type: ignore[operator]


def test_the_reference_is_the_demand_within_its_bounds() -> None:
    """0.3 in at 4 Hz: 7.5 in/s and 189 in/s^2, from rest."""
    time = FRAME * np.arange(1, 4097)[:, None]
    demand = 0.3 * INCH * np.sin(2.0 * np.pi * 4.0 * time) * np.minimum(time, 1.0)
    demand = np.broadcast_to(demand, (4096, MODES)).copy()
    np.testing.assert_allclose(reference_of(BOUNDED, demand), demand, rtol=0, atol=1e-15)


@pytest.mark.parametrize("inches", [0.05, 0.2, 1.0, 20.0])
def test_a_jump_is_followed_within_the_bounds_and_not_passed(inches: float) -> None:
    """A small one critically damped, d (1 - (1 + p t) exp(-p t)); a large one at the rate, its end
    with no more than the acceleration."""
    found = reference_of(BOUNDED, np.full((8192, MODES), inches * INCH))[:, 0] / INCH
    rate = np.diff(np.concatenate([[0.0, 0.0], found])) / FRAME
    assert found.max() <= inches * (1.0 + 1e-9)
    assert found[-1] == pytest.approx(inches, rel=1e-9)
    assert rate.max() <= 10.0 + 1e-9
    assert np.abs(np.diff(rate)).max() <= 400.0 * FRAME * (1.0 + 1e-9)
    time, pull = FRAME * np.arange(found.size), 2.0 * np.pi * 6.0
    if inches < 0.1:
        damped = inches * (1.0 - (1.0 + pull * time) * np.exp(-pull * time))
        np.testing.assert_allclose(found, damped, rtol=0, atol=0.01 * inches)
    if inches > 10.0:
        assert time[np.argmax(found > 0.95 * inches)] < 0.95 * inches / 10.0 + 10.0 / 400.0 + 0.01


def test_the_reference_keeps_its_bounds_whatever_is_asked() -> None:
    rng = np.random.default_rng(2)
    demand = np.repeat(rng.uniform(-1.0, 1.0, (80, MODES)), 50, axis=0) * INCH
    demand += rng.uniform(-0.1, 0.1, demand.shape) * INCH
    rate = np.diff(reference_of(BOUNDED, demand), axis=0) / FRAME / INCH
    assert np.abs(rate).max() <= 10.0 + 1e-9
    assert np.abs(np.diff(rate, axis=0)).max() <= 400.0 * FRAME * (1.0 + 1e-9)


def test_load_feedback_passes_what_swings() -> None:
    """A constant load gives nothing; a jump of 1000 lbf the gain, which fades with the corner."""
    law = law_of(plan=None, load_feedback={"gain": 2.0, "corner": 0.5})
    area = 0.25 * np.pi * (5.5 * INCH) ** 2
    dcl = make_dcl(law, MODES)
    rest = STILL._replace(cap_pressure=np.full(6, 4e6))
    state = engaged_state(dcl, np.zeros(MODES), rest)
    blocks.step(dcl, state, np.zeros(MODES), rest)
    np.testing.assert_array_equal(dcl.workspace.output, 0.0)
    pushed = rest._replace(cap_pressure=np.full(6, 4e6 + 1000.0 * POUND_FORCE / area))
    for k in range(300):
        blocks.step(dcl, state, np.zeros(MODES), pushed)
        expected = -0.02 * np.exp(-2.0 * np.pi * 0.5 * FRAME * k)
        np.testing.assert_allclose(dcl.workspace.output, expected, rtol=1e-9)


def test_planned_inertia_is_not_damped() -> None:
    """With F = m a of the plan, the block is silent: the output is that without it."""
    law = MODAL.bound_to("gfd")
    assert law.plan is not None
    open_plan = law.plan.model_copy(update={"position": 0.0, "velocity": 0.0})
    bare = law.model_copy(update={"plan": open_plan, "direct_gain": type(law.direct_gain)()})
    without = bare.model_copy(update={"load_feedback": None})
    dcl, state = make_dcl(bare, MODES), DclState.zeros(MODES)
    other, twin = make_dcl(without, MODES), DclState.zeros(MODES)
    shape, mass = np.array(law.modes["gfd"].shape), np.array(law.modes["gfd"].mass) * 0.45359237
    demand = 0.002 * np.arange(1.0, 7.0)
    area = 0.25 * np.pi * (5.5 * INCH) ** 2
    largest = 0.0
    for _ in range(300):
        push = shape.T @ (mass * state.plan.acceleration) / area
        now = STILL._replace(cap_pressure=push)
        blocks.step(dcl, state, demand, now)
        blocks.step(other, twin, demand, now)
        np.testing.assert_allclose(dcl.workspace.output, other.workspace.output, atol=1e-9)
        largest = max(largest, float(np.abs(push).max()))
    assert largest > 1e5


def test_linear_law_is_the_compiled_one() -> None:
    demand, feedback = histories(200, 1e-9)
    law = MODAL.bound_to("rfd")
    expected, _ = outputs(law, demand, feedback)
    system = dcl_state_space(law, MODES)
    inputs = dict(zip(DCL_INPUTS, (demand, *feedback), strict=True))
    driven = np.vstack([inputs[label[:-2]][:, int(label[-1]) - 1] for label in system.input_labels])
    found = control.forced_response(system, inputs=driven).outputs.T
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_all_degrees_of_freedom_answer_alike_on_the_linear_plant() -> None:
    """Same response on the diagonal, and little beside it: gravity and the supply aside."""
    plant = Hexapod("ifd")
    loop = Linear(plant).loop(MODAL)
    assert np.abs(loop.poles()).max() < 1.0 + 1e-9
    omega = 2.0 * np.pi * np.linspace(1.0, 6.0, 11)
    found = control.frequency_response(loop, omega).frdata
    own = np.stack([found[i, i] for i in range(MODES)])
    np.testing.assert_allclose(own, np.broadcast_to(own.mean(axis=0), own.shape), atol=0.1)
    # rad per m beside m per m: compare in sizes of the report's chirp.
    size = np.array([0.33 * INCH] * 3 + [np.radians(0.2)] * 3)
    shares = np.abs(found) * (size[None, :] / size[:, None])[..., None]
    shares[np.arange(MODES), np.arange(MODES)] = 0.0
    assert shares.max() < 0.15


def test_a_run_is_replayed_and_says_what_it_was_bound_to() -> None:
    run = simulate(Hexapod("rfd"), "modal_plan", signals.step("roll", 0.01, at=0.1, duration=0.5))
    assert list(run.metadata["law_parameters"]["modes"]) == ["rfd"]
    assert replay(run, Law.model_validate(run.metadata["law_parameters"])).identical
    legs = simulate(SingleLegs(), "modal_plan", signals.step("heave", 0.01, at=0.1, duration=0.5))
    assert replay(legs, "modal_plan").identical
    still = simulate(Hexapod("ifd"), "modal_plan", np.zeros((1024, 6)))
    assert np.abs(still["leg_extension"]).max() < 1e-6


def test_valve_gains_are_random_and_repeatable() -> None:
    gains = np.array([valve_gains(seed) for seed in range(50)])
    assert 0.9 <= gains.min() < 0.92 and 1.08 < gains.max() <= 1.1
    np.testing.assert_array_equal(valve_gains(3), gains[3])
    usual = load_hydraulics("hardware")
    changed = with_valve_gains(usual, 3)
    assert with_valve_gains(usual, None) is usual
    for leg in range(MODES):
        own = changed.actuator(f"leg_{leg + 1}")["leg_speed"].si / usual.leg_speed.si
        assert own == pytest.approx(gains[3, leg], rel=1e-12)


def test_bad_modal_laws_are_named() -> None:
    table = MODAL.model_dump(mode="json")
    odd = {"gfd": table["modes"]["gfd"] | {"shape": np.ones((6, 6)).tolist()}}
    for law, message in (
        (table | {"coordinates": "legs"}, "coordinates: legs takes no modes"),
        (table | {"modes": {}}, "needs a table"),
        (table | {"modes": odd}, "off orthonormal by"),
        (LEG_PLAN | {"direct_gain": {"position": [1.0] * 6}}, "direct_gain.position: a list needs"),
        (LEG_PLAN | {"direct_gain": {"position": [1.0] * 5}}, "a number, or a list of 6"),
        (LEG_PLAN | {"plan": LEG_PLAN["plan"] | {"frequency": None}}, "frequency: is missing"),  # type: ignore[operator]
        (
            LEG_PLAN | {"reference_model": {"natural_frequency": 4.0, "damping_ratio": 0.7}},
            "plan: is not allowed beside",
        ),
    ):
        with pytest.raises(ValueError, match=message):
            Law.model_validate(law)
    with pytest.raises(ValueError, match="has none of 'excavator'; it has gfd, rfd, ifd"):
        MODAL.bound_to("excavator")
    with pytest.raises(ValueError, match=r"choose one with bound_to\('gfd'\)"):
        make_dcl(MODAL, MODES)
    with pytest.raises(ValueError, match="hydraulic modes of 6 legs; there are 3"):
        make_dcl(MODAL.bound_to("gfd"), 3)
    assert "modal_plan" in law_names("beyond")
    assert DOFS[0] == "surge"
