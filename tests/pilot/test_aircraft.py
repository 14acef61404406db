"""The 737 of JSBSim obeys mechanics at the pilot's eye; its flights ship and read back."""

from pathlib import Path

import jsbsim
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cmf_mj.core.units import DEGREE, FOOT, KNOT, STANDARD_GRAVITY
from cmf_mj.pilot.airframe import RATE, AircraftState, Airframe, Controls, without_network
from cmf_mj.pilot.flight import Flight, Origin, load_flight
from cmf_mj.pilot.motion import PilotMotion, at_lever_arm, gravity_in_body
from cmf_mj.pilot.scripts import SCRIPTS, ScriptedFlight

RADIUS = 6.37e6


@pytest.fixture(scope="module")
def flown() -> dict[str, list[AircraftState]]:
    """Every script with JSBSim, once."""
    return {name: list(ScriptedFlight(name).states()) for name in SCRIPTS}


def column(states: list[AircraftState], name: str) -> NDArray[np.float64]:
    return np.array([getattr(state, name) for state in states])


def test_jsbsims_own_pilot_acceleration_is_ours_one_step_later() -> None:
    """Forces, rates and lever arm of two programs, in turbulence; the rate that JSBSim takes for
    the centripetal part is already that of the later step, which is the remaining difference."""
    airframe = Airframe(seed=4)
    throttle = airframe.in_air(Controls(gear=0.0), height=450.0, airspeed=250.0 * KNOT, path=0.0)
    airframe.turbulence(40.0 * KNOT, "milspec")
    controls = Controls(throttle=throttle, gear=0.0, aileron=0.1, elevator=-0.05)
    airframe.step(controls)
    largest = 0.0
    for _ in range(3 * RATE):
        before = airframe.state()
        airframe.step(controls)
        now = airframe.state()
        blended = before.centre_force + at_lever_arm(
            now.inertial_rate, before.angular_acceleration, now.lever
        )
        theirs = [FOOT * airframe[f"accelerations/a-pilot-{axis}-ft_sec2"] for axis in "xyz"]
        np.testing.assert_allclose(theirs, blended, rtol=0, atol=1e-9)
        largest = max(largest, float(np.abs(blended - before.specific_force).max()))
    assert 0.0 < largest < 5e-3


def test_the_felt_force_is_the_centres_moved_by_the_lever_arm(
    flown: dict[str, list[AircraftState]],
) -> None:
    states = flown["doublets"]
    moved = PilotMotion.from_centre_of_gravity(
        column(states, "time"),
        specific_force=column(states, "centre_force"),
        angular_rate=column(states, "inertial_rate"),
        angular_acceleration=column(states, "angular_acceleration"),
        attitude=column(states, "attitude"),
        lever_arm=states[0].lever,
    )
    felt = column(states, "specific_force")
    assert np.abs(felt - column(states, "centre_force")).max() > 0.5
    # The centre of gravity wanders by a centimetre with the fuel.
    np.testing.assert_allclose(moved.specific_force, felt, rtol=0, atol=5e-4)


def test_at_rest_only_gravity_is_felt(flown: dict[str, list[AircraftState]]) -> None:
    """Langley's normal gravity with the Earth's turning in it, 9.7989 m/s^2 (Somigliana)."""
    for state in flown["take_off"][: 80 * 2]:
        assert np.linalg.norm(state.specific_force) == pytest.approx(9.7989, abs=3e-3)
        up = -gravity_in_body(state.attitude) / STANDARD_GRAVITY
        np.testing.assert_allclose(state.specific_force / 9.7989, up, atol=3e-4)
        assert np.abs(state.angular_rate).max() < 1e-6


def test_in_steady_flight_the_force_is_gravity_turned_by_the_attitude(
    flown: dict[str, list[AircraftState]],
) -> None:
    """Before the doublets: no acceleration but that of following the round and turning Earth."""
    for state in flown["doublets"][:200]:
        roll, pitch, _ = state.attitude
        down = np.array(
            [-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)]
        )
        inertial = state.specific_force + 9.79 * down
        assert np.abs(inertial).max() < 0.03


def test_a_coordinated_turn_has_no_side_force(flown: dict[str, list[AircraftState]]) -> None:
    """f_y = 0, turn rate g tan(bank) / V and load 1 / cos(bank) once the bank is steady."""
    states = [state for state in flown["turn"] if 22.0 < state.time < 31.0]
    bank = column(states, "attitude")[:, 0]
    assert np.abs(bank - 30.0 * DEGREE).max() < 1.5 * DEGREE
    assert np.abs(column(states, "centre_force")[:, 1]).max() < 0.03
    speed = column(states, "true_airspeed")
    turning = np.gradient(column(states, "attitude")[:, 2], 1.0 / 80.0)
    np.testing.assert_allclose(turning, 9.79 * np.tan(bank) / speed, rtol=0.04)
    lift = np.linalg.norm(column(states, "centre_force")[:, 1:], axis=1)
    np.testing.assert_allclose(lift, 9.79 / np.cos(bank), rtol=0.04)


@pytest.mark.parametrize("name", ["engine_failure", "doublets", "turbulence", "approach"])
def test_rates_integrate_to_the_attitude(name: str, flown: dict[str, list[AircraftState]]) -> None:
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
    travel = column(states, "true_airspeed").sum() / 80.0
    assert (turn.inv() * end).magnitude() < travel / RADIUS + 3e-4


def test_the_same_seed_gives_the_same_bits_and_another_does_not() -> None:
    def few(seed: int) -> bytes:
        states = ScriptedFlight("turbulence", seed=seed).states()
        return b"".join(next(states).specific_force.tobytes() for _ in range(160))

    assert few(7) == few(7)
    assert few(7) != few(8)


def test_a_gust_has_its_size_and_shape() -> None:
    airframe = Airframe()
    throttle = airframe.in_air(Controls(gear=0.0), height=500.0, airspeed=120.0, path=0.0)
    airframe.gust((0.0, 0.0, -8.0), 2.0)
    felt = []
    for _ in range(2 * RATE + 10):
        airframe.step(Controls(throttle=throttle, gear=0.0))
        felt.append(airframe["atmosphere/total-wind-down-fps"] * 0.3048)
    time = (np.arange(len(felt)) + 1) / RATE
    expected = np.where(time < 2.0, -4.0 * (1.0 - np.cos(np.pi * time)), 0.0)
    np.testing.assert_allclose(felt, expected, atol=0.06)


def test_a_failed_engine_spools_down_and_the_other_does_not() -> None:
    airframe = Airframe()
    controls = Controls(throttle=1.0, brakes=1.0, flaps=0.25)
    airframe.on_ground(controls)
    airframe.fail_engine(0)
    for _ in range(4 * RATE):
        airframe.step(controls)
    left, right = (airframe[f"propulsion/engine[{i}]/thrust-lbs"] for i in range(2))
    assert right > 18000.0 and left < 0.06 * right


def test_the_engine_failure_pulls_to_the_left_and_the_pilot_holds_the_runway(
    flown: dict[str, list[AircraftState]],
) -> None:
    states = flown["engine_failure"]
    speed, heading = column(states, "airspeed"), column(states, "attitude")[:, 2]
    failed = int(np.argmax(speed > 130.0 * KNOT))
    assert np.abs(column(states, "specific_force")[:failed, 1]).max() < 0.02
    assert column(states, "specific_force")[failed : failed + 160, 1].min() < -0.5
    assert np.abs(heading - heading[0]).max() < 8.0 * DEGREE
    assert states[-1].height > 30.0 and states[-1].climb > 2.0


@pytest.mark.parametrize("name", sorted(SCRIPTS))
def test_shipped_flights_are_what_the_scripts_fly(
    name: str, flown: dict[str, list[AircraftState]]
) -> None:
    """A recording, rounded to single precision, and a flight flown now on the same JSBSim."""
    flight = load_flight(name)
    assert flight.origin.source.endswith(f"script {name}")
    np.testing.assert_allclose(
        flight.motion.specific_force, column(flown[name], "specific_force"), rtol=0, atol=2e-6
    )
    np.testing.assert_allclose(flight.others["height"], column(flown[name], "height"), rtol=1e-6)
    assert flight.motion.rate == pytest.approx(80.0)
    assert 30.0 < flight.motion.time[-1] <= 60.0


def example() -> Flight:
    time = np.arange(40) / 80.0
    wave = np.column_stack([np.sin(time), np.cos(time), 0.1 * time])
    motion = PilotMotion(time, wave - [0.0, 0.0, 9.8], 0.1 * wave, 0.01 * wave)
    origin = Origin(title="made up", aircraft="none", lever_arm=(13.5, -0.8, -2.7), source="a test")
    return Flight(motion, origin, {"airspeed": 100.0 + time})


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_flights_read_back_bit_for_bit(suffix: str, tmp_path: Path) -> None:
    flight = example()
    again = load_flight(flight.save(tmp_path / f"flight.{suffix}"))
    assert again.origin == flight.origin
    for name in ("time", "specific_force", "angular_rate", "attitude"):
        assert getattr(again.motion, name).tobytes() == getattr(flight.motion, name).tobytes()
    assert again.others["airspeed"].tobytes() == flight.others["airspeed"].tobytes()


def test_single_precision_changes_a_force_by_less_than_a_micrometre_per_second_squared(
    tmp_path: Path,
) -> None:
    flight = example()
    again = load_flight(flight.save(tmp_path / "flight.parquet", single=True))
    assert again.motion.time.tobytes() == flight.motion.time.tobytes()
    change = np.abs(again.motion.specific_force - flight.motion.specific_force).max()
    assert 0.0 < change < 1e-6


def csv_of(tmp_path: Path, change: tuple[str, str]) -> Path:
    path = example().save(tmp_path / "flight.csv")
    path.write_text(path.read_text().replace(*change))
    return path


def test_units_of_the_header_are_converted(tmp_path: Path) -> None:
    flight = example()
    plain = load_flight(csv_of(tmp_path, ("specific_force_x [m/s^2]", "specific_force_x [g]")))
    np.testing.assert_allclose(
        plain.motion.specific_force[:, 0], 9.80665 * flight.motion.specific_force[:, 0], rtol=1e-12
    )
    turned = load_flight(csv_of(tmp_path, ("angular_rate_y [rad/s]", "angular_rate_y [deg/s]")))
    np.testing.assert_allclose(
        turned.motion.angular_rate[:, 1], DEGREE * flight.motion.angular_rate[:, 1], rtol=1e-12
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('"title": "made up", ', ""), "row 1: title: is missing"),
        (("specific_force_z [m/s^2]", "f_z [m/s^2]"), "specific_force_z: column is missing"),
        (("[m/s^2]", "[furlong]"), "specific_force_x: unit: 'furlong' is not known"),
        (("pitch [rad]", "pitch [[rad]"), r"header: 'pitch \[\[rad\]' is refused"),
        (("0.025,", "nan,"), "time: "),
    ],
)
def test_flights_that_are_refused_say_why(
    change: tuple[str, str], message: str, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        load_flight(csv_of(tmp_path, change))
    assert str(caught.value).startswith(str(tmp_path / "flight.csv"))


def test_what_cannot_be_flown_or_loaded_is_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="aircraft: 'zeppelin' is not one of 737, "):
        Airframe("zeppelin")
    with pytest.raises(ValueError, match="flight: 'loop' is not one of take_off, "):
        ScriptedFlight("loop")
    with pytest.raises(ValueError, match="is not one of approach, "):
        load_flight("loop")
    with pytest.raises(ValueError, match=r"airspeed: 20.0 m/s at 500 m .* cannot be trimmed"):
        Airframe().in_air(Controls(gear=0.0), height=500.0, airspeed=20.0, path=0.0)
    with pytest.raises(ValueError, match="model: 'wild' is not one of milspec, tustin"):
        Airframe().turbulence(10.0, "wild")
    flight = example()
    with pytest.raises(ValueError, match=r"airspeed: shape \(3,\); allowed: \(40,\)"):
        Flight(flight.motion, flight.origin, {"airspeed": np.zeros(3)})
    with pytest.raises(ValueError, match=r"must end in .csv or .parquet"):
        flight.save(tmp_path / "flight.txt")
    with pytest.raises(ValueError, match=r"must end in .csv or .parquet"):
        load_flight(tmp_path / "flight.txt")


@pytest.mark.parametrize("name", ["motion.csv", "motion.parquet"])
def test_a_file_without_units_and_origin_is_in_si(name: str, tmp_path: Path) -> None:
    motion = example().motion
    again = load_flight(motion.save(tmp_path / name))
    for part in ("time", "specific_force", "angular_rate", "attitude"):
        assert getattr(again.motion, part).tobytes() == getattr(motion, part).tobytes()
    assert again.motion.rate == pytest.approx(80.0)
    assert (again.origin.title, again.origin.source) == ("motion", name)


def test_no_network_port_is_opened(tmp_path: Path) -> None:
    """The shipped aircraft listens for telnet and data; the copy that is flown does not."""
    shipped = Path(jsbsim.get_default_root_dir()) / "aircraft" / "737"
    without_network(shipped, tmp_path / "737")
    texts = [(folder / "737.xml").read_text() for folder in (shipped, tmp_path / "737")]
    assert ["<input port" in text for text in texts] == [True, False]
    assert all("<flight_control" in text for text in texts)
