"""What the scripts fly obeys mechanics, and is what ships."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cmf_mj.core.units import DEGREE, KNOT, STANDARD_GRAVITY
from cmf_mj.pilot.airframe import AircraftState
from cmf_mj.pilot.flight import load_flight
from cmf_mj.pilot.motion import gravity_in_body
from cmf_mj.pilot.scripts import SCRIPTS, script_states

RADIUS = 6.37e6
TRUE = 1.0755
"""True airspeed over calibrated at 1500 m of the standard atmosphere, the highest that is flown."""

Flown = dict[str, list[AircraftState]]


@pytest.fixture(scope="module")
def flown() -> Flown:
    """Every script with JSBSim, once."""
    return {name: list(script_states(name)) for name in SCRIPTS}


def column(states: list[AircraftState], name: str) -> NDArray[np.float64]:
    return np.array([getattr(state, name) for state in states])


def test_at_rest_only_gravity_is_felt(flown: Flown) -> None:
    """Langley's normal gravity with the Earth's turning in it, 9.7989 m/s^2 (Somigliana)."""
    for state in flown["take_off"][: 80 * 2]:
        assert np.linalg.norm(state.specific_force) == pytest.approx(9.7989, abs=3e-3)
        up = -gravity_in_body(state.attitude) / STANDARD_GRAVITY
        np.testing.assert_allclose(state.specific_force / 9.7989, up, atol=3e-4)
        assert np.abs(state.angular_rate).max() < 1e-6


def test_in_steady_flight_the_force_is_gravity_turned_by_the_attitude(
    flown: Flown,
) -> None:
    """Before the doublets: no acceleration but that of following the round and turning Earth."""
    for state in flown["doublets"][:200]:
        roll, pitch, _ = state.attitude
        down = np.array(
            [-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)]
        )
        inertial = state.specific_force + 9.79 * down
        assert np.abs(inertial).max() < 0.03


def test_a_coordinated_turn_has_no_side_force(flown: Flown) -> None:
    """f_y = 0, turn rate g tan(bank) / V and load 1 / cos(bank) once the bank is steady."""
    states = [state for state in flown["turn"] if 22.0 < state.time < 31.0]
    bank = column(states, "attitude")[:, 0]
    assert np.abs(bank - 30.0 * DEGREE).max() < 1.5 * DEGREE
    felt = column(states, "specific_force")
    assert np.abs(felt[:, 1]).max() < 0.03
    speed = TRUE * column(states, "airspeed")
    turning = np.gradient(column(states, "attitude")[:, 2], 1.0 / 80.0)
    np.testing.assert_allclose(turning, 9.79 * np.tan(bank) / speed, rtol=0.04)
    lift = np.linalg.norm(felt[:, 1:], axis=1)
    np.testing.assert_allclose(lift, 9.79 / np.cos(bank), rtol=0.04)


@pytest.mark.parametrize("name", ["engine_failure", "doublets", "turbulence", "approach"])
def test_rates_integrate_to_the_attitude(name: str, flown: Flown) -> None:
    """Body rates against the Earth, compounded over the flight, less the turn of the local level by
    its travel around the Earth, V / R; trapezoid between 80 Hz samples."""
    states = flown[name]
    rates = column(states, "angular_rate")
    attitude = column(states, "attitude")
    mean = 0.5 * (rates[1:] + rates[:-1]) / 80.0
    turn = Rotation.from_euler("ZYX", attitude[0, ::-1])
    for step in mean:
        turn = turn * Rotation.from_rotvec(step)
    end = Rotation.from_euler("ZYX", attitude[-1, ::-1])
    travel = TRUE * column(states, "airspeed").sum() / 80.0
    assert (turn.inv() * end).magnitude() < travel / RADIUS + 3e-4


def test_the_same_seed_gives_the_same_bits_and_another_does_not() -> None:
    def few(seed: int) -> bytes:
        states = script_states("turbulence", seed=seed)
        return b"".join(next(states).specific_force.tobytes() for _ in range(160))

    assert few(7) == few(7)
    assert few(7) != few(8)


def test_the_engine_failure_pulls_to_the_left_and_the_pilot_holds_the_runway(
    flown: Flown,
) -> None:
    states = flown["engine_failure"]
    speed, heading = column(states, "airspeed"), column(states, "attitude")[:, 2]
    failed = int(np.argmax(speed > 130.0 * KNOT))
    assert np.abs(column(states, "specific_force")[:failed, 1]).max() < 0.02
    assert column(states, "specific_force")[failed : failed + 160, 1].min() < -0.5
    assert np.abs(heading - heading[0]).max() < 8.0 * DEGREE
    assert states[-1].height > 30.0 and states[-1].height - states[-81].height > 2.0


@pytest.mark.parametrize("name", sorted(SCRIPTS))
def test_shipped_flights_are_what_the_scripts_fly(name: str, flown: Flown) -> None:
    """A recording, rounded to single precision, and a flight flown now on the same JSBSim."""
    flight = load_flight(name)
    assert flight.origin.source.endswith(f"script {name}")
    np.testing.assert_allclose(
        flight.motion.specific_force, column(flown[name], "specific_force"), rtol=0, atol=2e-6
    )
    np.testing.assert_allclose(flight.others["height"], column(flown[name], "height"), rtol=1e-6)
    assert flight.motion.rate == pytest.approx(80.0)
    assert 30.0 < flight.motion.time[-1] <= 60.0


def test_no_other_script_is_flown() -> None:
    with pytest.raises(ValueError, match="flight: 'loop' is not one of take_off, "):
        next(script_states("loop"))
