"""The 737 of JSBSim obeys mechanics at the pilot's eye."""

from pathlib import Path

import jsbsim
import numpy as np
import pytest

from cmf_mj.core.units import FOOT, KNOT
from cmf_mj.pilot.airframe import RATE, Airframe, Controls, without_network
from cmf_mj.pilot.motion import at_lever_arm


def test_jsbsims_own_pilot_acceleration_is_ours_one_step_later() -> None:
    """Forces, rates and lever arm of two programs, in turbulence; the rate that JSBSim takes for
    the centripetal part is already that of the later step, which is the remaining difference."""
    airframe = Airframe(4)
    throttle = airframe.in_air(Controls(gear=0.0), height=450.0, airspeed=250.0 * KNOT, path=0.0)
    airframe.start_turbulence(40.0 * KNOT, "milspec")
    controls = Controls(throttle=throttle, gear=0.0, aileron=0.1, elevator=-0.05)
    airframe.step(controls)
    largest = 0.0
    for _ in range(3 * RATE):
        before, mass = airframe.state(), airframe["inertia/mass-slugs"]
        force = airframe.vector("forces/fb{}-total-lbs") / mass * FOOT
        turning = airframe.vector("accelerations/{}idot-rad_sec2", "pqr")
        airframe.step(controls)
        rate = airframe.vector("velocities/{}i-rad_sec", "pqr")
        blended = force + at_lever_arm(rate, turning, airframe.state().lever)
        theirs = [FOOT * airframe[f"accelerations/a-pilot-{axis}-ft_sec2"] for axis in "xyz"]
        np.testing.assert_allclose(theirs, blended, rtol=0, atol=1e-9)
        largest = max(largest, float(np.abs(blended - before.specific_force).max()))
    assert 0.0 < largest < 5e-3


def test_a_gust_has_its_size_and_shape() -> None:
    airframe = Airframe()
    throttle = airframe.in_air(Controls(gear=0.0), height=500.0, airspeed=120.0, path=0.0)
    airframe.start_gust((0.0, 0.0, -8.0), 2.0)
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


def test_no_network_port_is_opened(tmp_path: Path) -> None:
    """The shipped aircraft listens for telnet and data; the copy that is flown does not."""
    shipped = Path(jsbsim.get_default_root_dir()) / "aircraft" / "737"
    without_network(shipped, tmp_path / "737")
    texts = [(folder / "737.xml").read_text() for folder in (shipped, tmp_path / "737")]
    assert ["<input port" in text for text in texts] == [True, False]
    assert all("<flight_control" in text for text in texts)


def test_what_cannot_be_flown_is_named() -> None:
    with pytest.raises(ValueError, match=r"airspeed: 20.0 m/s at 500 m .* cannot be trimmed"):
        Airframe().in_air(Controls(gear=0.0), height=500.0, airspeed=20.0, path=0.0)
