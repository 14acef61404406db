"""The optimal washout: Riccati equation, optimality, closed forms."""

import control
import numpy as np
import pytest
from cab_motions import G, pushed, sustained, turned

from cmf_mj.pilot.motion import PilotMotion
from cmf_mj.pilot.optimal import washout_modes
from cmf_mj.pilot.washout import Washout
from cmf_mj.pilot.washout_settings import load_washout

SETTINGS = load_washout("optimal")
MODES = washout_modes(SETTINGS)


@pytest.mark.parametrize("name", MODES)
def test_feedback_and_riccati_solution_are_python_controls(name):
    """python-control solves the same problem by slycot or its own Schur method."""
    (a, b), (q, n, r), p = MODES[name].plant, MODES[name].cost, MODES[name].riccati
    gain, solution, poles = control.lqr(a, b, q, r, n)
    np.testing.assert_allclose(p, solution, rtol=1e-6, atol=1e-8 * np.abs(p).max())
    np.testing.assert_allclose(MODES[name].feedback, gain, rtol=1e-6, atol=1e-8)
    assert poles.real.max() < 0.0


@pytest.mark.parametrize("name", ["yaw", "heave"])
def test_with_travel_and_effort_for_nothing_the_simulator_does_what_the_aircraft_does(name):
    """W tends to 1 above a corner that falls as a root of the sizes; with the shipped ones it does
    not."""
    mode = getattr(SETTINGS, name)
    free = {
        field: size.model_copy(update={"value": 1e5 * size.value})
        for field, size in mode
        if field.removesuffix("_integral") in ("position", "velocity", "acceleration", "angle")
        or field == "rate"
    }
    freed = washout_modes(SETTINGS.model_copy(update={name: mode.model_copy(update=free)}))
    points = 1j * np.array([3.0, 10.0])
    for point in points:
        ours, bound = (
            np.ravel(control.ss(*each[name].filter)(point))[-1] for each in (freed, MODES)
        )
        assert abs(ours - 1.0) < 0.03
        assert abs(bound - 1.0) > 0.05


def test_sway_mirrors_surge_with_equal_sizes():
    sizes = SETTINGS.pitch_surge
    mirrored = washout_modes(SETTINGS.model_copy(update={"roll_sway": sizes}))
    points = 1j * np.geomspace(0.05, 20.0, 9)
    surge, sway = (control.ss(*mirrored[n].filter) for n in ("pitch_surge", "roll_sway"))
    for point in points:
        # Angle to force and force to angle change sign, the rest does not.
        actual = surge(point) * np.outer([1, 1, -1, -1, -1], [1.0, 1.0]) * np.array([1.0, -1.0])
        np.testing.assert_allclose(sway(point), actual, rtol=1e-6, atol=1e-9)


def felt(motion):
    washout = Washout("optimal")
    stream = washout.run(motion)
    return stream, PilotMotion.from_platform(stream, washout.station)


def test_heave_and_yaw_wash_to_zero_and_surge_is_held_by_tilt():
    stream, motion = felt(pushed(2, sustained(1.0)))
    assert np.abs(stream.pose[:, 2]).max() > 0.05
    np.testing.assert_allclose(stream.pose[-1, 2], 0.0, atol=1e-3)
    stream, _ = felt(turned(2, sustained(0.1, seconds=300.0)))
    assert np.abs(stream.pose[:, 5]).max() > 0.05
    assert np.abs(stream.pose[-1, 5]) < 0.02 * np.abs(stream.pose[:, 5]).max()
    stream, motion = felt(pushed(0, sustained(1.0)))
    assert motion.specific_force[-1, 0] == pytest.approx(G * np.sin(stream.pose[-1, 4]), abs=1e-3)
    share = np.asarray(control.ss(*MODES["pitch_surge"].filter)(0.0))[0, 1] * G
    assert motion.specific_force[-1, 0] == pytest.approx(0.6 * share, rel=0.05)
    assert share > 0.5
