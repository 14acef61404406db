"""Measures of a step response, of a record or of a linear loop.

With y0 the rest before a step, y1 the mean of the last second and r the demanded step,

    overshoot           OS = max((y - y1) / (y1 - y0))
    damping ratio       zeta = -ln OS / sqrt(pi^2 + ln^2 OS)     second order, from overshoot
    steady-state error  (r - (y1 - y0)) / r
    rise time           10 % to 90 % of y1 - y0,   settling time into 2 % of it

A run is *stable* when its ringing ends or is ending: over the last second no leg swings more than
2 % of the largest leg step, or the swing is less than 0.75 of that three seconds earlier. A mode at
3 Hz then has a damping ratio of at least 0.005; a limit cycle has a ratio of 1. It also holds its
position: no leg ends farther from its demand than a leg would that stood still.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.analysis.measurable import checked_legs, dof_history, least_demand
from cmf_mj.core.errors import InputError, NoPoseError
from cmf_mj.record.record import Record
from cmf_mj.signals.single import Step

TAIL = 1.0  #: Length of the window that gives the final value and the verdict [s].
NO_OVERSHOOT = 1e-3  #: Overshoot below which a response counts as having none (damping 0.91).
_SETTLED = 0.02  #: Distance from the final value, or swing of the legs, over the step, at rest.
_DECAY = 0.75  #: Swing of the last window over that of the earlier one that counts as ending.
_DECAY_TIME = 3.0  #: Distance of the two windows of the verdict [s].
_REST_MOTION = 0.1  #: Motion before the step, over the step, up to which it starts from rest.
_REST_TIME = 0.25  #: Window before the step in which that motion is measured [s].
_LEAST_RATE = 64.0  #: Least sampling rate [Hz]: four a cycle of the legs' fastest modes, 15 Hz.

_NAN = float("nan")


class StepMetrics(NamedTuple):
    """Measures of one step; fractions of the step unless a unit is given.

    >>> cmf_mj.StepMetrics._fields[:3]
    ('overshoot', 'damping_ratio', 'steady_state_error')
    """

    overshoot: float = _NAN  #: Largest excess over the final value.
    damping_ratio: float = _NAN  #: From the overshoot; NaN below an overshoot of 0.001.
    steady_state_error: float = _NAN  #: Demanded minus reached.
    rise_time: float = _NAN  #: 10 to 90 % [s].
    settling_time: float = _NAN  #: From the step to staying within 2 % of the final value [s].
    residual: float = _NAN  #: Largest leg swing of the last second over the leg step.
    stable: bool = False  #: The verdict.


def damping_from_overshoot(overshoot: float) -> float:
    """Damping ratio of the second-order system with this overshoot; 0 from 1, NaN without one."""
    if not 0.0 < overshoot < 1.0:
        return 0.0 if overshoot >= 1.0 else _NAN
    logarithm = np.log(overshoot)
    return float(-logarithm / np.hypot(np.pi, logarithm))


def measure_step(
    reached: NDArray[np.float64], rate: float, *, final: float, demanded: float = 1.0
) -> StepMetrics:
    """Measure a step response of a stable system, one that ends, at `final`.

    `reached` is the motion from rest, sampled from the step on, (N,); `demanded` is the step.
    """
    share = reached / final
    overshoot = float(share.max() - 1.0)
    row_of_10_percent = int(np.argmax(share >= 0.1))
    row_of_90_percent = int(np.argmax(share >= 0.9))
    unsettled_rows = np.flatnonzero(np.abs(share - 1.0) > _SETTLED)
    settled_row = int(unsettled_rows[-1]) + 1 if unsettled_rows.size else 0
    return StepMetrics(
        overshoot=overshoot,
        damping_ratio=damping_from_overshoot(overshoot if overshoot >= NO_OVERSHOOT else 0.0),
        steady_state_error=1.0 - final / demanded,
        rise_time=(row_of_90_percent - row_of_10_percent) / rate,
        settling_time=settled_row / rate,
        stable=True,
    )


def step_metrics(record: Record, dof: str | None = None) -> StepMetrics:
    """Measure a step response from leg demand to leg feedback in one degree of freedom.

    The record is of a `signals.step` that goes on for at least five seconds after the step; `dof`
    is by default what the command moved. Where no pose has the legs any more, the run is unstable
    and the measures of shape are NaN.

    >>> command = cmf_mj.signals.step("heave", 0.0254, duration=6.5)
    >>> record = cmf_mj.simulate(cmf_mj.SingleLegs(), "velocity", command)
    >>> round(cmf_mj.step_metrics(record).overshoot, 2)
    0.22
    """
    command, rate = record.signal_as(Step), record.rate
    axis = dof if dof is not None else command.dof
    _check_sampling(record, command.at)
    checked_legs(record, "leg_position", axis)
    demand = dof_history(record, "leg_reference", axis)
    step_row = int(np.searchsorted(record.time, command.at - 1e-9))
    demanded = float(demand[-1] - demand[step_row - 1])
    if abs(demanded) < least_demand(record, axis):
        raise InputError(f"dof: the record holds no step in {axis}; it moved {command.dof}")
    residual, ringing_ends = _ringing(record)
    try:
        feedback = dof_history(record, "leg_position", axis)
    except NoPoseError:
        return StepMetrics(residual=residual, stable=False)
    rest = float(feedback[step_row - 1])
    final = float(feedback[-round(TAIL * rate) :].mean()) - rest
    motion_at_rest = float(np.ptp(feedback[max(step_row - round(_REST_TIME * rate), 0) : step_row]))
    if ringing_ends and motion_at_rest > _REST_MOTION * abs(demanded):
        raise InputError(
            f"record: moves by {motion_at_rest:.3g} m or rad in the {_REST_TIME} s before a step "
            f"of {abs(demanded):.3g}; allowed: {_REST_MOTION:g} of it, so a larger step or a later "
            "one"
        )
    metrics = measure_step(feedback[step_row:] - rest, rate, final=final, demanded=demanded)
    if ringing_ends and not metrics.rise_time > 0.0:
        raise InputError(
            f"record: goes from 10 to 90 % of the step within a sample of {1.0 / rate:.4g} s; "
            "allowed: a motion, in a record that shows it"
        )
    stable = ringing_ends and not ends_off_demand(record)
    return metrics._replace(residual=residual, stable=stable)


def _check_sampling(record: Record, step_time: float) -> None:
    """Refuse a record too slow for the legs' modes, or too short about its step at a time [s]."""
    rate = record.rate
    if rate < _LEAST_RATE:
        raise InputError(f"record_every: {rate:g} samples a second; allowed: from {_LEAST_RATE:g}")
    begin, end = float(record.time[0]), float(record.time[-1]) + 1.0 / rate
    needed = _DECAY_TIME + 2.0 * TAIL
    if end - step_time < needed - 1e-6 or begin >= step_time:
        raise InputError(
            f"record: must begin before the step at {step_time:g} s and must go on for "
            f"{needed} s after the step; it has {begin:g} to {end:g} s"
        )


def _ringing(record: Record) -> tuple[float, bool]:
    """Residual swing of the legs over their step, and whether the ringing ends or is ending."""
    legs: NDArray[np.float64] = record["leg_position"]
    reference = record["leg_reference"]
    largest_step = float(np.abs(reference[-1] - reference[0]).max())
    tail, distance = round(TAIL * record.rate), round(_DECAY_TIME * record.rate)
    last_swing = float(np.ptp(legs[-tail:], axis=0).max())
    earlier_swing = float(np.ptp(legs[-tail - distance : -distance], axis=0).max())
    residual = last_swing / largest_step
    return residual, bool(residual < _SETTLED or last_swing < _DECAY * earlier_swing)


def ends_off_demand(record: Record) -> bool:
    """Whether a step ends with a leg farther from its demand than if it had stood still.

    With x the legs' mean of the last second less their rest, r the step of their demands, both (n,)
    [m], that is max |x - r| > max |r|: a law without position feedback, or with its sign turned.
    """
    legs, reference = record["leg_position"], record["leg_reference"]
    demanded = reference[-1] - reference[0]
    reached = legs[-round(TAIL * record.rate) :].mean(axis=0) - legs[0]
    return bool(np.abs(reached - demanded).max() > np.abs(demanded).max())
