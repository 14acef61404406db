"""Linear loops against the report's own arithmetic, block algebra and the compiled DCL."""

import control
import numpy as np
import pytest
from numpy.typing import NDArray

from cmf_mj.analysis.linear.loop import (
    DCL_INPUTS,
    closed_loop,
    closed_loop_response,
    dcl_state_space,
    loop_response,
)
from cmf_mj.analysis.linear.plants import FEEDBACK, UnitTransferFunction, leg_plant
from cmf_mj.control.dcl import DclState, make_dcl, step
from cmf_mj.control.feedback import LegFeedback
from cmf_mj.control.law import SIGNALS, Gains, Law, ReferenceModel, law_names, load_law
from cmf_mj.core.units import FRAME
from cmf_mj.report_2014.models import hardware_velocity, report_model

OMEGA = 2.0 * np.pi * np.linspace(0.05, 8.0, 4000)

EVERY_SIGNAL = Law(
    name="every_signal",
    title="All ten signals, through B and through D",
    state_gain=0.9,
    output_gain=-3.0,
    input_gain=Gains(**{name: 1e-8 if "pressure" in name else 1e-3 for name in SIGNALS}),
    direct_gain=Gains(
        reference=20.0,
        cap_pressure=-2e-7,
        rod_pressure=1e-7,
        position=-20.0,
        velocity=-0.4,
        position_error_rate=0.3,
        velocity_error=0.2,
        error_integral=5.0,
        acceleration=-0.01,
        force=-0.002,
    ),
)

EVERY_SIGNAL_FOLLOWING = EVERY_SIGNAL.model_copy(
    update={
        "name": "every_signal_following",
        "reference_model": ReferenceModel(
            natural_frequency=6.0,
            damping_ratio=0.5,
            position=15.0,
            rate=0.4,
            velocity=2.0,
            acceleration=0.1,
        ),
    }
)

LAWS = [*law_names(), EVERY_SIGNAL, EVERY_SIGNAL_FOLLOWING]


def law_id(law: str | Law) -> str:
    return law if isinstance(law, str) else law.name


def coupled_plant() -> control.StateSpace:
    """Two legs that push each other, every output with dynamics of its own, SI."""
    random = np.random.default_rng(3)
    order, legs = 6, 2
    a = random.normal(size=(order, order))
    a -= (np.linalg.eigvals(a).real.max() + 5.0) * np.eye(order)
    size = np.tile([1e-3, 1e-2, 0.1, 1e5, 1e5], legs)[:, None]
    inputs = ["command_2", "command_1"]  # in any order
    outputs = [f"{name}_{leg}" for leg in (2, 1) for name in FEEDBACK]
    c = random.normal(size=(len(outputs), order)) * size
    d = random.normal(size=(len(outputs), legs)) * 0.1 * size
    plant = control.ss(a, random.normal(size=(order, legs)), c, d, inputs=inputs, outputs=outputs)
    return control.sample_system(plant, FRAME, "zoh", copy_names=True)


def run_frames(
    law: str | Law, plant: control.StateSpace, reference: NDArray[np.float64], legs: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The loop frame by frame with the compiled DCL, rows found by name: feedback, commands."""
    dcl = make_dcl(load_law(law), legs)
    state = DclState.zeros(legs)
    names = [""] if legs == 1 else [f"_{leg + 1}" for leg in range(legs)]
    rows = [[plant.output_labels.index(n + leg) for leg in names] for n in FEEDBACK]
    columns = [plant.input_labels.index(f"command{leg}") for leg in names]
    x = np.zeros(plant.nstates)
    kept = np.zeros(legs)
    result, commands = [], []
    for demand in reference:
        u = np.zeros(legs)
        u[columns] = kept
        y = plant.C @ x + plant.D @ u
        feedback = LegFeedback(*(y[row].copy() for row in rows))
        step(dcl, state, demand, feedback)
        x = plant.A @ x + plant.B @ u
        kept = dcl.workspace.command.copy()
        result.append(np.concatenate([*feedback]))
        commands.append(dcl.workspace.output.copy())
    return np.array(result), np.array(commands)


@pytest.mark.parametrize("law", LAWS, ids=law_id)
def test_linear_dcl_is_the_compiled_one(law: str | Law) -> None:
    random = np.random.default_rng(5)
    frames, legs = 300, 2
    size = {"reference": 1e-4, "leg_position": 1e-4, "leg_velocity": 1e-3, "leg_acceleration": 0.1}
    inputs = {name: random.normal(size=(frames, legs)) * size.get(name, 1e3) for name in DCL_INPUTS}
    dcl = make_dcl(load_law(law), legs)
    state = DclState.zeros(legs)
    expected = np.zeros((frames, legs))
    for k in range(frames):
        feedback = LegFeedback(*(inputs[name][k] for name in FEEDBACK))
        step(dcl, state, inputs["reference"][k], feedback)
        expected[k] = dcl.workspace.output
    system = dcl_state_space(law, legs)
    driven = np.vstack([inputs[label[:-2]][:, int(label[-1]) - 1] for label in system.input_labels])
    result = control.forced_response(system, inputs=driven)
    np.testing.assert_allclose(result.outputs.T, expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("law", LAWS, ids=law_id)
@pytest.mark.parametrize("number", ["4.4", "4.12", ""])
def test_closed_loop_is_the_compiled_dcl_around_the_plant(law: str | Law, number: str) -> None:
    """Every law around one leg without pressures and around two coupled legs with them."""
    plant = leg_plant(report_model(number)) if number else coupled_plant()
    legs = 1 if number else 2
    reference = np.random.default_rng(7).normal(size=(120, legs)) * 1e-5
    feedback, commands = run_frames(law, plant, reference, legs)
    loop = closed_loop(law, plant, outputs=(*FEEDBACK, "command"))
    result = np.atleast_2d(control.forced_response(loop, inputs=reference.T).outputs)
    expected = np.hstack([feedback, commands]).T
    assert np.abs(commands).max() < 1.0  # the clamps did not act
    size = np.abs(expected).max(axis=1, keepdims=True) + 1e-300
    np.testing.assert_allclose(result / size, expected / size, atol=1e-8)


def test_labels_of_loops() -> None:
    one = closed_loop("velocity", hardware_velocity(1))
    assert (one.input_labels, one.output_labels) == (["reference"], ["leg_position"])
    two = closed_loop("force", coupled_plant(), outputs=("leg_velocity", "command"))
    assert two.input_labels == ["reference_1", "reference_2"]
    assert two.output_labels == ["leg_velocity_1", "leg_velocity_2", "command_1", "command_2"]
    assert two.dt == FRAME
    assert type(two) is control.StateSpace


def test_state_space_of_the_loop_equals_its_block_algebra() -> None:
    """G = z^-1 P H_r / (1 - z^-1 P H_p - z^-1 V H_v), blocks evaluated one by one.

    A held plant is the sum of its aliases, (1 - z^-1) / T * sum G(s_k) / s_k over
    s_k = j (w + 2 pi k / T): an oracle without polynomials or state space. The velocity's direct
    term passes the hold unchanged; summed, it would read the middle of each jump.
    """
    velocity = hardware_velocity(1)
    omega = OMEGA[::40]
    loop = control.frequency_response(closed_loop("velocity", velocity), omega)
    z = np.exp(1j * omega / 2048.0)
    s = 1j * (omega[:, None] + 2.0 * np.pi * 2048.0 * np.arange(-3000, 3001))
    aliases = velocity(s.ravel()).reshape(s.shape) / s
    direct = 0.002907
    speed = direct + (1.0 - 1.0 / z) * 2048.0 * (aliases - direct / s).sum(axis=1)
    position = (1.0 - 1.0 / z) * 2048.0 * (aliases / s).sum(axis=1)
    feedback = (381.8 - 37.1759 / (z - 0.914)) * position - 2.3 * speed
    expected = (47.0 * position / z) / (1.0 - feedback / z)
    np.testing.assert_allclose(loop.frdata[0, 0], expected, rtol=1e-5)


def test_each_further_frame_of_delay_is_one_more_register() -> None:
    plant = leg_plant(hardware_velocity(2))
    register = control.ss([[0.0]], [[1.0]], [[1.0]], [[0.0]], FRAME)
    delayed = control.series(register, plant)
    delayed = control.ss(delayed, inputs=["command"], outputs=list(FEEDBACK))
    omega = OMEGA[::100]
    for law in ("acceleration", "velocity_error"):
        result = control.frequency_response(closed_loop(law, plant, command_delay=2), omega)
        expected = control.frequency_response(closed_loop(law, delayed), omega)
        np.testing.assert_allclose(result.frdata, expected.frdata, rtol=1e-8)


def test_a_continuous_plant_is_held_over_a_frame() -> None:
    """A leg's pole pair as a state space in rad/s, and its own discretisation."""
    a, b = [[0.0, 1.0], [0.0, -20.0]], [[0.0], [20.0 * 0.76]]
    names = {"inputs": ["valve"], "outputs": ["leg_position", "leg_velocity"]}
    continuous = control.ss(a, b, np.eye(2), np.zeros((2, 1)), **names)
    discrete = control.sample_system(continuous, FRAME, "zoh", copy_names=True)
    kept, sampled = (
        control.frequency_response(closed_loop("velocity", plant), OMEGA[::100]).frdata
        for plant in (continuous, discrete)
    )
    np.testing.assert_array_equal(kept, sampled)


def test_legs_apart_are_single_legs() -> None:
    """A block-diagonal plant of two models gives their two loops and no crosstalk."""
    plants = [leg_plant(hardware_velocity(number)) for number in (1, 3)]
    joined = control.append(*plants)
    joined = control.ss(
        joined,
        inputs=["command_1", "command_2"],
        outputs=[f"{name}_{leg}" for leg in (1, 2) for name in FEEDBACK],
    )
    omega = OMEGA[::100]
    both = control.frequency_response(closed_loop("position_error_rate", joined), omega).frdata
    for leg, plant in enumerate(plants):
        alone = control.frequency_response(closed_loop("position_error_rate", plant), omega)
        np.testing.assert_allclose(both[leg, leg], alone.frdata[0, 0], rtol=1e-7)
        np.testing.assert_allclose(both[leg, 1 - leg], 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("number", "powers"),
    [("4.4", (0, 1, 2)), ("4.7", (-1, 0, 1)), ("4.12", (-1, 0, None)), ("4.13", (-2, -1, 0))],
)
def test_motion_follows_from_any_of_its_models(number: str, powers: tuple[int | None, ...]) -> None:
    """Held step: s^n times the model, simulated in continuous time, at the frames."""
    model = report_model(number).to_si()
    plant = leg_plant(report_model(number))
    time = np.arange(600) * FRAME
    result = control.forced_response(plant, time, np.ones(time.size)).outputs
    s = control.tf("s")
    for row, power in enumerate(powers):
        if power is None:
            continue
        # The step of s^n G is the impulse of s^(n-1) G; powers of s cancel in the polynomials.
        numerator, denominator = (np.asarray(p[0, 0]) for p in (model.num_array, model.den_array))
        if power > 0:
            numerator = np.polymul(numerator, [1.0] + [0.0] * power)
        exact = control.tf(numerator, denominator) / s ** max(-power, 0)
        expected = control.step_response(exact, time).outputs
        np.testing.assert_allclose(
            result[row, 1:], expected[1:], atol=2e-7 * np.abs(expected).max()
        )
    np.testing.assert_array_equal(result[3:], 0.0)


@pytest.mark.parametrize(("number", "first"), [("4.11", 0), ("4.12", 1)])
def test_the_rate_of_an_output_that_jumps_is_its_difference_over_a_frame(
    number: str, first: int
) -> None:
    """Velocity and acceleration of a position with a direct term, acceleration of a velocity."""
    plant = leg_plant(report_model(number))
    command = np.random.default_rng(1).normal(size=200)
    result = control.forced_response(plant, inputs=command).outputs
    for row in range(first, 2):
        difference = np.diff(np.concatenate([[0.0], result[row]])) / FRAME
        np.testing.assert_allclose(result[row + 1], difference, atol=1e-9 * np.ptp(difference))


def test_exact_response_is_given_like_a_measured_one() -> None:
    loop = closed_loop("velocity", hardware_velocity(1))
    frequency = np.array([0.5, 1.0, 2.0])
    result = loop_response(loop, frequency)
    expected = loop(np.exp(2j * np.pi * frequency * FRAME))
    np.testing.assert_allclose(result.response, expected, rtol=1e-10)
    np.testing.assert_array_equal(result.frequency, frequency)
    np.testing.assert_array_equal(result.coherence, 1.0)
    np.testing.assert_array_equal(result.bound, 0.0)
    assert result.output_labels == ["leg_position"]


def test_the_integral_takes_the_static_error_away() -> None:
    for law in ("velocity_integral", "position_error_rate", "force"):
        loop = closed_loop(law, hardware_velocity(2))
        assert control.dcgain(loop) == pytest.approx(1.0, abs=1e-6)


def test_bad_loops_are_named() -> None:
    plant = hardware_velocity(1)
    position = {"inputs": ["command"], "outputs": ["leg_position"]}
    slow = control.ss([[1.0]], [[1.0]], [[1.0]], [[0.0]], 0.01, **position)
    blind = control.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]], **position)
    twins = control.ss(-np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2)))
    for arguments, keywords, message in (
        (("velocity", plant), {"command_delay": 0}, "command_delay: 0 frames must be at least 1"),
        (("velocity", plant), {"outputs": ("jerk",)}, "outputs: 'jerk' is not one of leg_position"),
        (("velocity", slow), {}, "plant: its sampling time 0.01 must be"),
        (("velocity", blind), {}, "plant: has no output leg_velocity"),
        (("original", twins), {}, "must be command_1 to command_2"),
        (("original", control.tf([1.0], [1.0, 1.0])), {}, "plant: TransferFunction is refused"),
        (("fast", plant), {}, "'fast'"),
    ):
        with pytest.raises(ValueError, match=message):
            closed_loop(*arguments, **keywords)  # type: ignore[arg-type]
    assert closed_loop("original", blind).ninputs == 1  # reads no velocity, so needs none
    with pytest.raises(ValueError, match="legs: 0 must be at least 1"):
        dcl_state_space("velocity", 0)
    with pytest.raises(ValueError, match="model: output: 'cap_pressure' is not one of"):
        leg_plant(report_model("4.2"))
    discrete = UnitTransferFunction(
        [1.0], [1.0, -0.5], FRAME, input_unit="%", output_unit="in", outputs="leg_position"
    )
    with pytest.raises(ValueError, match="model: leg_position is discrete"):
        leg_plant(discrete)
    length = UnitTransferFunction(
        [1.0], [1.0, 1.0], input_unit="%", output_unit="in", outputs="leg_velocity"
    )
    with pytest.raises(ValueError, match="output_unit: 'in' of leg_velocity is refused; .* m/s"):
        leg_plant(length)


def test_line_by_line_loop_is_that_of_the_state_space() -> None:
    """The report's model 1 closed both ways: held plant against its response, to 5 Hz 1e-3."""
    frequency = np.linspace(0.2, 5.0, 60)
    model = hardware_velocity(1)
    whole = loop_response(closed_loop("velocity", model), frequency).response
    velocity = loop_response(model.to_si(), frequency).response
    lines = closed_loop_response("velocity", velocity, frequency)
    np.testing.assert_allclose(lines[:, 0, 0], whole, rtol=1e-3)


def test_bad_lines_are_refused() -> None:
    with pytest.raises(ValueError, match="frequency: must be greater than 0"):
        closed_loop_response("velocity", [1.0], [0.0])
    with pytest.raises(ValueError, match=r"velocity: shape is \(2, 2, 3\)"):
        closed_loop_response("velocity", np.ones((2, 2, 3)), [1.0, 2.0])
