"""Laws and blocks at another control rate: the same in time, not in frames."""

import numpy as np
import pytest

from cmf_mj import law_names, load_law
from cmf_mj.control import states
from cmf_mj.control.dcl import compensate, make_compensator, make_dcl
from cmf_mj.control.dcu.play import upsample
from cmf_mj.control.dcu.state import load_dcu, make_dcu, resting
from cmf_mj.control.feedback import filter_acceleration
from cmf_mj.control.law import SIGNALS, Law
from cmf_mj.control.protection import load_protection, make_protection
from cmf_mj.control.states import Request, State
from cmf_mj.core.errors import InputError
from cmf_mj.facility.host.stream import arrivals, make_stream


def held(law: Law, frames: int) -> np.ndarray:
    """Outputs of compensator and accelerometer filter for inputs held at 1, frame by frame."""
    compensator, feedback = make_compensator(law, 1), make_dcl(law, 1).feedback
    state = filtered = 0.0
    found = np.empty((frames, 2))
    for k in range(frames):
        output, state = compensate(compensator, 0, state, np.ones(len(SIGNALS)))
        found[k] = output, filtered
        filtered = filter_acceleration(feedback, filtered, 1.0)
    return found


@pytest.mark.parametrize("name", [n for n in law_names("all") if load_law(n).coordinates == "legs"])
def test_a_filter_settles_in_the_same_time_at_half_the_rate(name: str) -> None:
    """x = b (1 - a^k) / (1 - a) with inputs held: at common times the same to round-off."""
    law = load_law(name)
    whole, half = held(law, 400), held(law.at_rate(1024), 200)
    np.testing.assert_allclose(half, whole[::2], rtol=1e-9, atol=1e-15)


def test_a_rate_there_and_back_leaves_the_gains() -> None:
    law = load_law("acceleration")
    assert law.at_rate(2048) is law
    back = law.at_rate(500).at_rate(2048)
    assert back.state_gain == pytest.approx(law.state_gain, rel=1e-12)
    assert back.accelerometer_pole == pytest.approx(law.accelerometer_pole, rel=1e-12)
    for name in SIGNALS:
        again, first = getattr(back.input_gain, name), getattr(law.input_gain, name)
        assert again == pytest.approx(first, rel=1e-12)


def test_what_a_rate_forbids_is_refused() -> None:
    fast = load_law({"direct_gain": {"reference": 1.0}, "title": "fast", "derivative_pole": 3000.0})
    with pytest.raises(InputError, match="derivative_pole: 3000 rad/s must be below twice"):
        fast.at_rate(1000)
    turns = load_law({"direct_gain": {"reference": 1.0}, "title": "turns", "state_gain": -0.5})
    with pytest.raises(InputError, match="state_gain: -0.5 of law custom is made for 2048 Hz"):
        turns.at_rate(1000)
    with pytest.raises(InputError, match="minimum_interval: .* two control frames, 0.02 s"):
        make_dcu("default", 1.0 / 100)
    with pytest.raises(InputError, match="washout: .* must be below the control rate, 0.01 1/s"):
        make_protection(load_protection(), 100.0)


@pytest.mark.parametrize("rate", [256, 1024, 8192])
def test_the_valve_fades_in_the_same_time(rate: int) -> None:
    """From off, raised: the gain on the valve command is 1 after `valve_time`, not before."""
    settings = states.load_state_settings()
    compiled = states.make_states(settings)._replace(frame=1.0 / rate)
    state = states.start(compiled, State.OFF, np.full(6, -0.96))
    demand, reference = np.zeros((3, 6)), np.zeros((3, 6))
    frames = 0
    while state.phase[0].gain < 1.0:
        states.step(compiled, state, Request.RAISE.value, demand, np.full(6, -0.96), reference)
        frames += 1
    assert frames / rate == pytest.approx(settings.valve_time.si, abs=1.5 / rate)


def test_the_dcu_gives_the_same_demand_at_common_times() -> None:
    """Quintics through the host's frames do not depend on when they are read.

    After a second and a half: the gap to the first frame is closed from the control frame in which
    it is found. 1e-9 m: the play clock's slew is integrated frame by frame.
    """
    shipped = load_dcu()
    none = shipped.delay.transmission.model_copy(update={"value": 0.0})
    delay = shipped.delay.model_copy(update={"transmission": none, "dcl_frame": none})
    settings = shipped.model_copy(update={"delay": delay})
    time = np.arange(240) / 64.0  # whole control frames at all rates
    pose = np.zeros((240, 6))
    pose[:, 2] = 0.05 * (1.0 - np.cos(2.0 * np.pi * 0.5 * time))
    stream = make_stream(time, pose)
    found = {}
    for rate in (512, 1024, 2048):
        dcu = make_dcu(settings, 1.0 / rate)
        sent = arrivals(stream)
        sent = sent._replace(frame=np.round(stream.time * rate).astype(np.int64))
        demand = upsample(dcu, resting(dcu), sent, 3 * rate)
        found[rate] = demand[3 * rate // 2 :: rate // 512, 0, 2]
    assert np.abs(found[2048]).max() > 0.09
    for rate in (512, 1024):
        np.testing.assert_allclose(found[rate], found[2048], rtol=0, atol=1e-9)
