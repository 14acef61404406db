"""Files of flights: bits, units, origins, refusals."""

from pathlib import Path

import numpy as np
import pytest

from cmf_mj.core.units import DEGREE
from cmf_mj.pilot.flight import Flight, Origin, load_flight
from cmf_mj.pilot.motion import PilotMotion


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
    made_up = Origin(title="flight", source="flight.csv")
    assert again.origin == (made_up if suffix == "csv" else flight.origin)
    for name in ("time", "specific_force", "angular_rate", "attitude"):
        assert getattr(again.motion, name).tobytes() == getattr(flight.motion, name).tobytes()
    assert again.others["airspeed"].tobytes() == flight.others["airspeed"].tobytes()


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


@pytest.mark.parametrize("name", ["motion.csv", "motion.parquet"])
def test_a_file_without_units_and_origin_is_in_si(name: str, tmp_path: Path) -> None:
    motion = example().motion
    again = load_flight(motion.save(tmp_path / name))
    for part in ("time", "specific_force", "angular_rate", "attitude"):
        assert getattr(again.motion, part).tobytes() == getattr(motion, part).tobytes()
    assert again.motion.rate == pytest.approx(80.0)
    assert (again.origin.title, again.origin.source) == ("motion", name)


def test_what_cannot_be_loaded_or_saved_is_named(tmp_path: Path) -> None:
    flight = example()
    with pytest.raises(ValueError, match=r"airspeed: shape is \(3,\); allowed: \(40,\)"):
        Flight(flight.motion, flight.origin, {"airspeed": np.zeros(3)})
    for refused in (flight.save, load_flight):
        with pytest.raises(ValueError, match=r"must end in .csv or .parquet"):
            refused(tmp_path / "flight.txt")
    with pytest.raises(ValueError, match="is not one of approach, "):
        load_flight("loop")
