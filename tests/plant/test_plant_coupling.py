"""The closed loop: hydraulics and mechanics meet to second order, every run repeats bit for bit."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from cmf_mj import Record, SingleLegs, signals, simulate
from cmf_mj.electronics.sensors import true_acceleration, true_velocity
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.plant import Plant

FRAME = 1.0 / 2048.0
PLANTS: dict[str, Callable[..., Plant]] = {"hexapod": Hexapod, "single_legs": SingleLegs}
CASES = [("hexapod", "heave"), ("hexapod", "surge"), ("single_legs", "heave")]


@cache
def stepped(plant: str, dof: str, cuts: int) -> Record:
    """The report's 1 in step, each control frame in `cuts` mechanical steps."""
    command = signals.step(dof, -0.0254, at=0.1, duration=2.1)
    return simulate(PLANTS[plant](timestep=FRAME / cuts), "position_error_rate", command)


def difference(plant: str, dof: str, cuts: int, finer: int) -> float:
    """Largest difference of any leg's position at any frame [m]."""
    rough, fine = stepped(plant, dof, cuts), stepped(plant, dof, finer)
    np.testing.assert_array_equal(rough.time, fine.time)
    return float(np.abs(rough["leg_position"] - fine["leg_position"]).max())


@pytest.mark.parametrize(("plant", "dof"), CASES)
def test_one_step_a_frame_is_converged(plant: str, dof: str) -> None:
    """1/2048 s against 1/16384 s: 5 um, a fifth of a thousandth of the step of 25.4 mm."""
    moved = np.ptp(stepped(plant, dof, 8)["leg_position"], axis=0).max()
    assert moved > 0.01
    assert difference(plant, dof, 1, 8) < 5e-6


@pytest.mark.parametrize(("plant", "dof"), CASES)
def test_coupling_is_second_order(plant: str, dof: str) -> None:
    """Richardson: |x1 - x2| / |x2 - x4| tends to 2^order as the step is halved twice."""
    for cuts in (1, 2):
        coarse = difference(plant, dof, cuts, 2 * cuts)
        fine = difference(plant, dof, 2 * cuts, 4 * cuts)
        assert np.log2(coarse / fine) >= 1.8


@pytest.mark.parametrize("dof", ["heave", "surge"])
@pytest.mark.parametrize("cuts", [1, 2, 4, 8])
def test_gimbals_stay_closed(dof: str, cuts: int) -> None:
    """Less than 10 um between the halves of any gimbal at any mechanical step of the run."""
    error = stepped("hexapod", dof, cuts)["gimbal_error"]
    assert 0.0 < error.max() < 10e-6


def test_momentum_of_a_leg_is_the_impulse_of_its_force() -> None:
    """m d2x/dt2 = F - W with the recorded force and positions: MuJoCo's step is a leapfrog, whose
    second difference is the force at the middle sample. 1e-6 N of 3.2e4 N: round-off, 3266 kg
    times 1e-17 m (last digit of the extension) over (1/2048 s)^2 is 1.4e-7 N."""
    record = simulate(
        SingleLegs(), "velocity", signals.step("heave", -0.0254, at=0.1, duration=0.6)
    )
    mass = 7200 * 0.45359237
    x = record["leg_position"]
    acceleration = (x[2:] - 2 * x[1:-1] + x[:-2]) / FRAME**2
    residual = mass * (acceleration + 9.80665) - record["leg_force"][1:-1]
    assert np.abs(mass * acceleration).max() > 1e3
    assert np.abs(residual).max() < 1e-6


def test_sensors_are_exact_on_a_parabola() -> None:
    """l = 0.1 + 0.3 t - 0.7 t^2: velocity at t[k] and acceleration, from the mean velocities of the
    two steps before; second order means no error on a parabola. 1e-9: round-off of differences."""
    step, time = FRAME, 0.25

    def length(t: float) -> float:
        return 0.1 + 0.3 * t - 0.7 * t**2

    mean = (length(time) - length(time - step)) / step
    mean_before = (length(time - step) - length(time - 2 * step)) / step
    assert true_velocity(mean, mean_before) == pytest.approx(0.3 - 1.4 * time, abs=1e-9)
    assert true_acceleration(mean, mean_before, step) == pytest.approx(-1.4, abs=1e-8)


def test_recorded_sensors_follow_the_recorded_positions() -> None:
    """v[k] = (3 x[k] - 4 x[k-1] + x[k-2]) / (2 T) and a[k] the second difference about t[k-1]:
    one step old. Round-off: 1e-12 m/s, 1e-9 m/s^2."""
    record = simulate(
        SingleLegs(), "velocity", signals.step("heave", -0.0254, at=0.1, duration=0.6)
    )
    x = record["leg_position"]
    velocity = (3 * x[2:] - 4 * x[1:-1] + x[:-2]) / (2 * FRAME)
    acceleration = (x[2:] - 2 * x[1:-1] + x[:-2]) / FRAME**2
    np.testing.assert_allclose(record["leg_velocity"][2:], velocity, rtol=0, atol=1e-12)
    np.testing.assert_allclose(record["leg_acceleration"][2:], acceleration, rtol=0, atol=1e-9)
    assert np.abs(acceleration).max() > 1.0


def test_recorded_force_is_that_of_the_recorded_pressures() -> None:
    """F = A_cap p_cap - A_rod p_rod at the same instant; 1e-12: round-off."""
    plant = SingleLegs()
    record = simulate(plant, "velocity", signals.step("heave", -0.0254, at=0.1, duration=0.3))
    p = plant.parameters
    expected = p.cap_area * record["cap_pressure"] - p.rod_area * record["rod_pressure"]
    np.testing.assert_allclose(record["leg_force"], expected, rtol=1e-12)


@pytest.mark.parametrize(("plant", "dof"), CASES)
def test_nothing_moves_before_the_step(plant: str, dof: str) -> None:
    """The run starts in static equilibrium with the law engaged and its integral charged: up to
    the step the legs stay. 1e-7 m: the soft closing of the gimbals takes up the load."""
    record = stepped(plant, dof, 1)
    before = record["leg_position"][record.time < 0.1]
    assert np.abs(before - before[0]).max() < 1e-7


@pytest.mark.parametrize("delay", [0, 1, 5])
def test_a_command_reaches_the_valve_after_the_delay(delay: int) -> None:
    """Before the step the opening is that of a run without one; it first differs `delay` + 1
    frames after the frame whose DCL saw the step: the valve then has moved for one frame."""
    at = 0.05
    command = signals.step("heave", -0.0254, at=at, duration=0.1)
    still = signals.Command.from_pose(np.zeros_like(command.pose))
    stepped_run = simulate(SingleLegs(), "velocity", command, command_delay=delay)
    still_run = simulate(SingleLegs(), "velocity", still, command_delay=delay)

    def first(channel: str) -> int:
        return int(np.argmax((stepped_run[channel] != still_run[channel]).any(axis=1)))

    seen = round(np.ceil(at / FRAME))
    assert first("leg_reference") == seen
    assert first("valve_command") == seen
    assert first("valve_opening") == seen + 1 + delay


@pytest.mark.parametrize("timestep", [1 / 3000, 1 / 1024, 1 / 2048 * (1 + 1e-6)])
@pytest.mark.parametrize("plant", sorted(PLANTS))
def test_a_step_that_does_not_divide_the_frame_is_refused(plant: str, timestep: float) -> None:
    with pytest.raises(ValueError, match=r"timestep: .* must divide the control frame of 0\.00048"):
        simulate(PLANTS[plant](timestep=timestep), "velocity", np.zeros((4, 6)))


@pytest.mark.parametrize(("field", "value"), [("record_every", 0), ("command_delay", -1)])
def test_frame_counts_out_of_range_are_refused(field: str, value: int) -> None:
    with pytest.raises(ValueError, match=f"{field}: {value} is refused: .* to {value + 1}"):
        simulate(SingleLegs(), "velocity", np.zeros((4, 6)), **{field: value})
