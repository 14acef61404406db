"""The predictive washout: a plan over a horizon that the legs can follow, made again each frame.

Each frame solves the `programme` of the `horizon`, linearised along the plan of the frame before,
and sends the first efforts of the plan. If the solver does not end within its iterations, or live
within its share of the frame, the last plan goes on; after its end the linear washout
u = -F (x, 0) takes over.

The aircraft's inputs v ahead are `constant`; a `guess`, (v + m T (1 - exp(-t / T))) exp(-t / T_f)
with the slope m low-passed; or `known` from the flight. What is sent is the plan of the machine
that follows it the law's delay later, for v of that time: a guess and what is known lead by it,
constant cannot. The specific force that the small angles of the model miss is taken off v.
"""

from dataclasses import dataclass
from time import perf_counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.machine.cab import Cab
from cmf_mj.machine.limits import MotionLimits
from cmf_mj.pilot.classical import HeadMotion, Sample
from cmf_mj.pilot.horizon import Condensed, Horizon, make_horizon, otoliths_ahead, resting_state
from cmf_mj.pilot.motion import turn_to_body
from cmf_mj.pilot.optimal import ModeLayout
from cmf_mj.pilot.programme import PlanLimits, SoftSolver
from cmf_mj.pilot.washout_settings import Prediction, PredictiveSettings

Matrix = NDArray[np.float64]

_BRIDGE = 0.5  #: Time for which the last plan goes on alone, and then fades to a washout [s].


class Solves(NamedTuple):
    """What the solver did in a run, frame by frame."""

    seconds: list[float]  #: Of the whole frame, model and solver.
    iterations: list[int]
    bridged: list[bool]  #: Whether the last plan went on instead.

    def report(self, interval: float) -> str:
        """Times of frames `interval` [s] apart, how many were late or bridged, and the first."""
        seconds, bridged = np.array(self.seconds or [0.0]), np.array(self.bridged or [False])
        times = " / ".join(f"{1e3 * np.quantile(seconds, q):.2g}" for q in (0.95, 0.999, 1.0))
        late = seconds > interval
        first = np.flatnonzero(late | bridged)[:1]
        return (
            f"plans made in {times} ms (95, 99.9 %, worst) of {1e3 * interval:.3g} ms: "
            f"{late.sum()} late, {bridged.sum()} of {len(self.bridged)} bridged by the last plan"
            + "".join(f", first at {interval * (1.0 + row):.2f} s" for row in first)
        )


class Forecast:
    """The aircraft's inputs over the horizon, Euler rates and specific force beyond level rest."""

    def __init__(self, settings: Prediction, times: Matrix, lead: float, inputs: Matrix) -> None:
        """Begin with inputs (6,) that were constant; `lead` is the law's delay [s]."""
        self._settings, self._times, self._lead = settings, times, lead
        self._sample, self._slope = inputs, np.zeros(6)
        self.first = inputs  #: Inputs that the plan begins with, (6,).

    def ahead(self, sample: Matrix, known: Matrix | None) -> Matrix:
        """Inputs at all knots, (N + 1, 6), of a new sample and those known at t_2 .. t_N."""
        times, guess_time = self._times, self._settings.guess_time.si
        change = (sample - self._sample) / times[1] - self._slope
        self._slope += change * times[1] / self._settings.guess_lag.si
        inputs = np.vstack([self.first, np.broadcast_to(sample, (len(times) - 1, 6))])
        if known is not None:
            inputs[2:] = known
        elif self._settings.reference == "guess":
            later = times[1:, None] - times[1]
            growth = 1.0 - np.exp(-(self._lead + later) / guess_time)
            inputs[1:] += self._slope * guess_time * growth
            inputs[1:] *= np.exp(-later / self._settings.guess_fade.si)
        self._sample, self.first = sample, inputs[1]
        return inputs


@dataclass
class ModePlan:
    """What one mode does now and next."""

    condensed: Condensed
    state: Matrix  #: x, (n,).
    efforts: Matrix  #: u at the knots, (N + 1, m).
    slope: Matrix  #: du/dt now, (m,).

    @property
    def layout(self) -> ModeLayout:
        """What the mode moves."""
        return self.condensed.mode.layout

    def parameters(self, inputs: Matrix) -> Matrix:
        """The mode's s for the aircraft's inputs at all knots, (N + 1, 6)."""
        aircraft = inputs[:, self.layout.input_columns]
        return np.concatenate([self.state, self.efforts[0], aircraft.ravel()])

    def fade(self, inputs: Matrix, plan: Matrix, share: float) -> None:
        """Turn a share of the first efforts of a plan (N, m) into those of the linear washout.

        At t_1 these are u = -F (x, v), where x depends on u.
        """
        parameters, (_, efforts) = self.parameters(inputs), plan.shape
        next_state, feedback = self.condensed.states[1], self.condensed.mode.feedback
        without_first = plan.copy()
        without_first[0] = 0.0
        state = next_state @ np.concatenate([parameters, without_first.ravel()])
        state_gain = next_state[:, parameters.size : parameters.size + efforts]
        loop = np.eye(efforts) + feedback[:, : len(state)] @ state_gain
        aircraft = inputs[1, self.layout.input_columns]
        washout = np.linalg.solve(loop, feedback @ np.concatenate([state, aircraft]))
        plan[0] -= share * (washout + plan[0])

    def follow(self, inputs: Matrix, plan: Matrix, horizon: Horizon) -> None:
        """Move by a frame along a plan of the efforts at t_1 .. t_N, (N, m)."""
        signals = np.concatenate([self.parameters(inputs), plan.ravel()])
        self.state = self.condensed.states[1] @ signals
        efforts = np.vstack([self.efforts[:1], plan])
        self.slope = (efforts[1] - efforts[0]) / horizon.times[1]
        self.efforts = horizon.frame_step @ efforts


class Predictive:
    """The algorithm at work."""

    def __init__(
        self,
        settings: PredictiveSettings,
        interval: float,
        cab: Cab,
        limits: MotionLimits,
        lead: float = 0.0,
    ) -> None:
        """Condense all modes of a set at frames `interval` [s] apart, for a cab and its limits.

        A plan is of what the machine will do after its law's delay `lead` [s].
        """
        self._settings, self.lead = settings.prediction, lead
        self.reference, self.solves = self._settings.reference, Solves([], [], [])
        self._horizon = make_horizon(settings, interval)
        self.times = self._horizon.times
        self._limits = PlanLimits(self._settings, self._horizon, cab, limits)
        self.solver = SoftSolver(self._limits.prices, self._settings.iterations)
        self._otoliths = otoliths_ahead(self.times)

    def start(self, sample: Sample, head: HeadMotion) -> None:
        """As `Classical.start`: at rest, tilted by what costs least for a sustained force."""
        inputs = sample.inputs
        self.forecast = Forecast(self._settings, self.times, self.lead, inputs)
        self._unmodelled, self._lost_frames = np.zeros(6), 0
        self._otolith_states = self._otoliths.resting @ inputs[None, 3:]
        largest_angles = 0.5 * self._limits.high[0, 9:]
        self._plans = []
        for condensed in self._horizon.modes:
            layout = condensed.mode.layout
            state = resting_state(condensed.mode, inputs[layout.input_columns], largest_angles)
            efforts = np.zeros((self.times.size, len(layout.efforts)))
            self._plans.append(ModePlan(condensed, state, efforts, efforts[0]))
        self._write_motion(head)

    def move(self, sample: Sample, head: HeadMotion) -> None:
        """As `Classical.move`; `head` is as the frame before left it."""
        start_time = perf_counter()
        inputs = self.forecast.ahead(sample.inputs, sample.known)
        forces = np.vstack([self._otolith_states, inputs[:, 3:]])
        sensed = self._otoliths.sensed @ forces
        self._otolith_states = self._otoliths.next_state @ forces
        inputs = inputs - self._unmodelled

        parameters = np.concatenate([mode.parameters(inputs) for mode in self._plans])
        last_plan = self._horizon.scaled([mode.efforts[1:] for mode in self._plans])
        programme = self._limits.programme(parameters, last_plan, inputs, sensed, head.linear[2])
        z, iterations = self.solver.solve(programme)
        self._lost_frames = self._lost_frames + 1 if z is None else 0
        plans = self._horizon.plans(last_plan if z is None else z)
        for mode, plan in zip(self._plans, plans, strict=True):
            if self._lost_frames:
                lost_time = self._lost_frames * self.times[1]
                mode.fade(inputs, plan, np.clip(lost_time / _BRIDGE - 1.0, 0.0, 1.0))
            mode.follow(inputs, plan, self._horizon)

        self._write_motion(head)
        self._unmodelled[3:] = unmodelled_force(head)
        self.solves.seconds.append(perf_counter() - start_time)
        self.solves.iterations.append(iterations)
        self.solves.bridged.append(z is None)

    def _write_motion(self, head: HeadMotion) -> None:
        """Overwrite the motion of the head by that of the modes."""
        motion = np.zeros((3, 6))
        for mode in self._plans:
            signals = (mode.state, mode.efforts[0], mode.slope)
            for dof, derivatives in mode.layout.motion(*signals).items():
                motion[:, dof] = derivatives
        head.linear[:], head.angular[:] = motion[:, :3], motion[:, 3:]


def unmodelled_force(head: HeadMotion) -> Matrix:
    """Specific force that the small angles of the model miss, (3,)."""
    force, (angles, _, _), acceleration = np.empty(3), head.angular, head.linear[2]
    turn_to_body(angles, acceleration - [0.0, 0.0, STANDARD_GRAVITY], force)
    tilt = STANDARD_GRAVITY * np.array([angles[1], -angles[0], -1.0])
    return np.asarray(force - acceleration - tilt)
