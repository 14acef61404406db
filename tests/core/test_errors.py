"""Only legs that no pose has, and plants without a linearisation, go without measures.

Whoever reads a run goes on where its legs flew apart, and where a plant has no linearisation. A
refusal of any other cause comes through, by name.
"""

from typing import Any, NoReturn

import numpy as np
import pytest
from followed_commands import record_of
from scipy import signal

from cmf_mj import InputError, NoPoseError, Record, signals
from cmf_mj.analysis.frequency_response import frequency_response
from cmf_mj.analysis.measures import Measures, measure_records
from cmf_mj.analysis.step_response import step_metrics
from cmf_mj.environments.environment import HexapodEnv
from cmf_mj.facility.session import Session
from cmf_mj.show.comparison import step_figure
from cmf_mj.studies import evaluation
from cmf_mj.studies.case import CaseResult, make_case, small_motion_loop

APART = np.array([-1.014, -1.014, 1.014, -1.014, -1.014, 1.014])
"""Legs within their stops that reach no common platform [m]."""


def changed(record: Record, **channels: Any) -> Record:
    held = {**record.channels, **channels}
    return Record(record.time.copy(), held, dict.fromkeys(held, "m"), record.metadata)


def refuse(*_: object, **__: object) -> NoReturn:
    raise InputError("law: is refused")


_CHIRP = signals.chirp("heave", 0.01, duration=20.0)
SWEEP = record_of(_CHIRP, _CHIRP.pose, 16)
_COMMAND = signals.step("heave", 0.0254)
STEP = record_of(_COMMAND, signal.lfilter([0.01], [1.0, -0.99], _COMMAND.pose, axis=0), 16)


def test_a_sweep_whose_legs_flew_apart_leaves_no_bandwidth() -> None:
    legs = SWEEP["leg_position"].copy()
    legs[-100:] = APART
    sweep = changed(SWEEP, leg_position=legs)
    with pytest.raises(NoPoseError, match="no platform pose"):
        frequency_response(sweep)
    assert np.isnan(measure_records(sweep, STEP, segment=10.0).phase_bandwidth_hz)


def test_a_sweep_that_cannot_be_read_is_refused() -> None:
    with pytest.raises(InputError, match="segment"):
        measure_records(SWEEP, STEP, segment=40.0)


def test_a_step_of_five_legs_is_refused() -> None:
    with pytest.raises(InputError, match="legs: shape is"):
        step_metrics(changed(STEP, leg_position=STEP["leg_position"][:, :5].copy()))


def test_a_sweep_without_true_extensions_has_no_crosstalk_to_read() -> None:
    with pytest.raises(InputError, match="leg_extension"):
        evaluation._sweep_crosstalk(SWEEP, make_case("velocity", quick=True))


def test_small_motion_of_a_loop_without_delay_is_refused() -> None:
    with pytest.raises(InputError, match="command_delay: 0"):
        small_motion_loop(make_case("velocity", plant="single_legs", command_delay=0))


def test_a_step_with_gaps_is_not_left_out_of_a_figure() -> None:
    legs = STEP["leg_position"].copy()
    legs[-1] = np.nan
    broken = changed(STEP, leg_position=legs)
    result = CaseResult(make_case("velocity"), None, Measures(), broken, 0.0, 0.0)
    with pytest.raises(InputError, match=r"leg_position\[\d+, 0\]: nan"):
        step_figure([result])


def test_an_environment_lets_a_refusal_through(monkeypatch: pytest.MonkeyPatch) -> None:
    """Legs apart, and legs that are no numbers, count as at the target; all else is refused."""
    env = HexapodEnv()
    env.reset(seed=0)
    assert isinstance(env.session, Session)
    legs = env.session.memory.extension
    for apart in (APART, np.full(6, np.nan)):
        legs[:] = apart
        assert np.isfinite(env.observation()).all()
        assert not env._pose_error.any()
    legs[:] = 0.0
    monkeypatch.setattr("cmf_mj.environments.environment.legs_to_pose", refuse)
    with pytest.raises(InputError, match="law: is refused"):
        env.observation()
