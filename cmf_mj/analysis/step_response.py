"""Measures of a step response, and the stability verdict.

With y0 the rest before the step, y1 the mean of the last second and r the demanded step,

    overshoot           OS = max((y - y1) / (y1 - y0))
    damping ratio       zeta = -ln OS / sqrt(pi^2 + ln^2 OS)     second order, from overshoot
    steady-state error  (r - (y1 - y0)) / r
    rise time           10 % to 90 % of y1 - y0,   settling time into 2 % of it

A run is *stable* when its ringing ends or is ending: over the last second no leg swings more than
2 % of the largest leg step, or the swing is less than 0.75 of that three seconds earlier. A mode at
3 Hz then has a damping ratio of at least 0.005; a limit cycle has a ratio of 1.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.analysis.measurable import checked_legs, dof_history, least_demand
from cmf_mj.core.errors import InputError, NoPoseError
from cmf_mj.record.record import Record
from cmf_mj.signals.single import Step

TAIL = 1.0
"""Length of the window that gives the final value and the verdict [s]."""

NO_OVERSHOOT = 1e-3
"""Overshoot below which a step response counts as having none (damping ratio 0.91)."""

RESIDUAL = 0.02
"""Swing over the last window, relative to the leg step, that counts as settled."""

DECAY = 0.75
"""Swing of the last window over that of `DECAY_TIME` earlier that counts as ending."""

DECAY_TIME = 3.0
"""Distance of the two windows of the verdict [s]."""

REST, REST_TIME = 0.1, 0.25
"""Motion before the step, over the step, and the time it is looked for in [s], up to which a
response counts as one from rest."""

LEAST_RATE = 64.0
"""Least sampling rate [Hz]: four samples a cycle of the legs' fastest modes, 15 Hz, of whose swing
they show 0.71 or more."""


class StepMetrics(NamedTuple):
    """Measures of one step; fractions of the step unless a unit is given.

    >>> cmf_mj.StepMetrics._fields[:3]
    ('overshoot', 'damping_ratio', 'steady_state_error')
    """

    overshoot: float  #: Largest excess over the final value.
    damping_ratio: float  #: From the overshoot; NaN below an overshoot of 0.001.
    steady_state_error: float  #: Demanded minus reached.
    rise_time: float  #: 10 to 90 % [s].
    settling_time: float  #: From the step to staying within 2 % of the final value [s].
    residual: float
    """Largest leg swing of the last second over the largest leg step; NaN of a linear loop."""
    stable: bool  #: The verdict.


def damping_from_overshoot(overshoot: float) -> float:
    """Damping ratio of the second-order system with this overshoot; 0 from 1, NaN without one."""
    if not 0.0 < overshoot < 1.0:
        return 0.0 if overshoot >= 1.0 else float("nan")
    logarithm = np.log(overshoot)
    return float(-logarithm / np.hypot(np.pi, logarithm))


def resonant_damping(peak: float) -> float:
    """Damping ratio of the second-order system whose gain peaks at `peak`: 1 / (2 z sqrt(1 - z^2)).

    NaN for a peak of no more than 1, which every damping ratio above 0.707 has.
    """
    return float(np.sin(0.5 * np.arcsin(1.0 / peak))) if peak > 1.0 else float("nan")


def measure_step(
    reached: NDArray[np.float64], rate: float, *, final: float, demanded: float = 1.0
) -> StepMetrics:
    """Measure a step response of a stable system, one that ends, at `final`.

    `reached` is the motion from rest, sampled from the step on, (N,); `demanded` is the step.
    """
    shape = reached / final
    overshoot = float(shape.max() - 1.0)
    ten = int(np.argmax(shape >= 0.1))
    ninety = int(np.argmax(shape >= 0.9))
    outside = np.flatnonzero(np.abs(shape - 1.0) > 0.02)
    inside = int(outside[-1]) + 1 if outside.size else 0
    return StepMetrics(
        overshoot=overshoot,
        damping_ratio=damping_from_overshoot(overshoot if overshoot >= NO_OVERSHOOT else 0.0),
        steady_state_error=1.0 - final / demanded,
        rise_time=(ninety - ten) / rate,
        settling_time=inside / rate,
        residual=float("nan"),
        stable=True,
    )


def step_metrics(record: Record, dof: str | None = None) -> StepMetrics:
    """Measure a step response from leg demand to leg feedback in one degree of freedom.

    The record is of a `signals.step` that goes on for at least five seconds after the step, another
    is refused; `dof` is by default what the command moved. Where the legs have gone so far apart
    that no pose has them, the run is unstable and the measures of shape are NaN.

    >>> command = cmf_mj.signals.step("heave", 0.0254, duration=6.5)
    >>> record = cmf_mj.simulate(cmf_mj.SingleLegs(), "velocity", command)
    >>> round(cmf_mj.step_metrics(record).overshoot, 2)
    0.22
    """
    command, rate = record.signal_as(Step), record.rate
    chosen = dof if dof is not None else command.dof
    if rate < LEAST_RATE:
        raise InputError(f"record_every: {rate:g} samples a second; allowed: from {LEAST_RATE:g}")
    begin, end = float(record.time[0]), float(record.time[-1]) + 1.0 / rate
    if end - command.at < DECAY_TIME + 2.0 * TAIL - 1e-6 or begin >= command.at:
        raise InputError(
            f"record: must begin before the step at {command.at:g} s and must go on for "
            f"{DECAY_TIME + 2.0 * TAIL} s after the step; it has {begin:g} to {end:g} s"
        )
    checked_legs(record, "leg_position", chosen)
    demand = dof_history(record, "leg_reference", chosen)
    at = int(np.searchsorted(record.time, command.at - 1e-9))
    demanded = float(demand[-1] - demand[at - 1])
    if abs(demanded) < least_demand(record, chosen):
        raise InputError(f"dof: the record holds no step in {chosen}; it moved {command.dof}")
    residual, stable = _verdict(record)
    try:
        feedback = dof_history(record, "leg_position", chosen)
    except NoPoseError:
        nan = float("nan")
        return StepMetrics(nan, nan, nan, nan, nan, residual, False)
    tail = round(TAIL * rate)
    rest = float(feedback[at - 1])
    final = float(feedback[-tail:].mean())
    size = final - rest
    before = float(np.ptp(feedback[max(at - round(REST_TIME * rate), 0) : at]))
    if stable and before > REST * abs(demanded):
        raise InputError(
            f"record: moves by {before:.3g} m or rad in the {REST_TIME} s before a step of "
            f"{abs(demanded):.3g}; allowed: {REST:g} of it, so a larger step or a later one"
        )
    measured = measure_step(feedback[at:] - rest, rate, final=size, demanded=demanded)
    if stable and not measured.rise_time > 0.0:
        raise InputError(
            f"record: goes from 10 to 90 % of the step within a sample of {1.0 / rate:.4g} s; "
            "allowed: a motion, in a record that shows it"
        )
    return measured._replace(residual=residual, stable=stable)


def _verdict(record: Record) -> tuple[float, bool]:
    legs: NDArray[np.float64] = record["leg_position"]
    reference = record["leg_reference"]
    size = float(np.abs(reference[-1] - reference[0]).max())
    tail, back = round(TAIL * record.rate), round(DECAY_TIME * record.rate)
    last = float(np.ptp(legs[-tail:], axis=0).max())
    earlier = float(np.ptp(legs[-tail - back : -back], axis=0).max())
    residual = last / size
    return residual, bool(residual < RESIDUAL or last < DECAY * earlier)
