"""The modes of a washout over a horizon, condensed to what a plan decides.

Per mode the model is that of `optimal`, with x = (x_v, x_d), u the simulator's rate and
acceleration and v the aircraft's inputs,

    dx/dt = A x + B u + E v,    J = int_0^H (x, v, u)^T W (x, v, u) dt + (x, v)^T P (x, v) at H

u and v run straight between the knots 0 = t_0 < t_1 < ... < t_N = H, t_1 one frame, later ones
farther apart by a constant ratio. Transitions and the cost of a span are exact (one exponential,
doubled). P solves the Riccati equation of `optimal`: beyond the horizon that washout takes over.
With the decisions U = (u_1 .. u_N) and the parameters s = (x_0, u_0, v_0 .. v_N) the states
condense to

    J = U^T H U + 2 U^T G s + const,    z = R U with R^T R = H,    min z^T z / 2 + z^T R^-T G s
"""

from typing import NamedTuple

import control
import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.optimize import brentq

from cmf_mj.core.filters import discretise
from cmf_mj.pilot.optimal import WashoutMode, washout_modes
from cmf_mj.pilot.perception import load_senses, otolith_response, state_space
from cmf_mj.pilot.washout_settings import PredictiveSettings

Matrix = NDArray[np.float64]


def knot_times(count: int, span: float, horizon: float) -> Matrix:
    """Times t_0 .. t_N [s], (N + 1,): a first span, later ones longer by one ratio."""
    if horizon <= count * span * (1.0 + 1e-9):
        return np.asarray(span * np.arange(count + 1))
    powers = np.arange(count)
    ratio = brentq(lambda r: span * np.sum(r**powers) - horizon, 1.0, horizon / span + 1.0)
    return np.concatenate([[0.0], np.cumsum(span * ratio**powers)])


class FiniteProblem(NamedTuple):
    """The problem of a mode over a finite time, where v is an input and no noise."""

    a: Matrix  #: A, (n, n).
    inputs: Matrix  #: (B, E), of (u, v), (n, 2 m).
    weight: Matrix  #: W with its rows in the order (x, u, v).
    terminal: Matrix  #: P, of (x, v).


def finite_problem(mode: WashoutMode) -> FiniteProblem:
    """The problem of a mode over a finite time."""
    a, b = mode.plant
    n, m = len(mode.filter.a), b.shape[1]
    order = np.r_[:n, len(a) : len(a) + m, n : len(a)]
    cost = np.block([[mode.cost.states, mode.cost.cross], [mode.cost.cross.T, mode.cost.efforts]])
    inputs = np.hstack([b[:n], a[:n, n:]])
    return FiniteProblem(a[:n, :n], inputs, cost[np.ix_(order, order)], mode.riccati)


def resting_state(mode: WashoutMode, inputs: Matrix, largest_angles: Matrix) -> Matrix:
    """State x at rest under constant inputs v (m,), tilted by what costs least.

    The angle is at most that of its axis in `largest_angles`, (3,).
    """
    problem = finite_problem(mode)
    states, aircraft = len(problem.a), slice(-inputs.size, None)
    sensing = slice(states - len(mode.layout.states))
    sense_dynamics = problem.a[sensing, sensing]
    resting = np.zeros(len(problem.weight))
    resting[aircraft] = inputs
    resting[sensing] = -np.linalg.solve(sense_dynamics, problem.inputs[sensing, aircraft] @ inputs)
    if mode.layout.tilt:
        tilted, angle = np.zeros(len(problem.weight)), states - 1
        tilted[angle] = 1.0
        tilted[sensing] = -np.linalg.solve(sense_dynamics, problem.a[sensing, angle])
        best = -(tilted @ problem.weight @ resting) / (tilted @ problem.weight @ tilted)
        largest = largest_angles[mode.layout.axes["rate"]]
        resting += tilted * np.clip(best, -largest, largest)
    return resting[:states]


def span_cost(dynamics: tuple[Matrix, Matrix], weight: Matrix, span: float) -> Matrix:
    """Cost matrix of (x_0, w_0, w_1) over a span [s], inputs w straight between; exact.

    int e^(M^T t) Q e^(M t) dt by Van Loan's exponential for a small part, then doubled.
    """
    a, b = dynamics
    n, m = b.shape
    chain = np.zeros((n + 2 * m, n + 2 * m))
    chain[:n, :n], chain[:n, n : n + m] = a, b
    chain[n : n + m, n + m :] = np.eye(m)
    cost = linalg.block_diag(weight, np.zeros((m, m)))
    doublings = max(0, int(np.ceil(np.log2(np.linalg.norm(chain, 1) * span))) + 1)
    part = span / 2**doublings
    exponential = linalg.expm(part * np.block([[-chain.T, cost], [np.zeros_like(chain), chain]]))
    transition = exponential[len(chain) :, len(chain) :]
    total = transition.T @ exponential[: len(chain), len(chain) :]
    for _ in range(doublings):
        total, transition = total + transition.T @ total @ transition, transition @ transition
    slope = np.eye(n + 2 * m)
    slope[n + m :, n : n + m], slope[n + m :, n + m :] = -np.eye(m) / span, np.eye(m) / span
    total = slope.T @ total @ slope
    return np.asarray(0.5 * (total + total.T))


class Condensed(NamedTuple):
    """One mode over the horizon; columns of states and efforts are those of (s, U)."""

    mode: WashoutMode
    hessian: Matrix  #: H, (m N, m N).
    gradient: Matrix  #: G, (m N, s).
    states: Matrix  #: x at each knot, (N + 1, n, s + m N).
    efforts: Matrix  #: u at each knot, (N + 1, m, s + m N).


def condense(mode: WashoutMode, times: Matrix, smooth: Matrix | None = None) -> Condensed:
    """Condense a mode over knots at some times [s]; slopes of u cost int (u' / smooth)^2 dt."""
    problem = finite_problem(mode)
    dynamics = (problem.a, problem.inputs)
    n, m = len(problem.a), problem.inputs.shape[1] // 2
    knot_count = len(times)
    parameter_count = n + m + m * knot_count
    size = parameter_count + m * (knot_count - 1)
    initial, effort, aircraft, plan = np.split(np.eye(size), [n, n + m, parameter_count])
    efforts = np.vstack([effort, plan]).reshape(knot_count, m, size)
    inputs = np.hstack([efforts, aircraft.reshape(knot_count, m, size)])

    states, total = np.zeros((knot_count, n, size)), np.zeros((size, size))
    states[0] = initial
    for knot, span in enumerate(np.diff(times)):
        begin, end = inputs[knot], inputs[knot + 1]
        discrete = discretise(*dynamics, np.zeros((0, n)), np.zeros((0, 2 * m)), float(span))
        states[knot + 1] = discrete.transition @ states[knot]
        states[knot + 1] += discrete.previous_gain @ begin + discrete.next_gain @ end
        stage = np.vstack([states[knot], begin, end])
        total += stage.T @ span_cost(dynamics, problem.weight, float(span)) @ stage
        if smooth is not None:
            for change in (efforts[knot + 1] - efforts[knot]) / smooth[:, None]:
                total += np.outer(change, change) / span
    last = np.vstack([states[-1], inputs[-1, m:]])
    total += last.T @ problem.terminal @ last
    gradient, hessian = np.split(total[parameter_count:], [parameter_count], axis=1)
    return Condensed(mode, hessian, gradient, states, efforts)


class LinearMap(NamedTuple):
    """What is linear in the parameters s and the decisions z, rows first."""

    of_parameters: Matrix
    of_decisions: Matrix


class Horizon(NamedTuple):
    """All modes over the horizon; s and U are those of the modes in a row."""

    times: Matrix  #: Of the knots [s], (N + 1,).
    frame_step: Matrix  #: From efforts at the knots to those a frame later, (N + 1, N + 1).
    modes: list[Condensed]
    factor: Matrix  #: R.
    unscale: Matrix  #: R^-1.
    gradient: Matrix  #: R^-T G.
    motion: LinearMap  #: Pose of the head with two derivatives at t_1 .. t_N, (3, N, 6, s or z).
    error: LinearMap
    """Specific force sensed in the simulator less that in the aircraft, over its threshold, at
    t_1 .. t_N, (N, 3, s) and (3 N, z)."""

    def scaled(self, plans: list[Matrix]) -> Matrix:
        """Vector z of the efforts of each mode at t_1 .. t_N, (N, m)."""
        return self.factor @ np.concatenate([plan.ravel() for plan in plans])

    def plans(self, z: Matrix) -> list[Matrix]:
        """Efforts of each mode at t_1 .. t_N, (N, m), of z."""
        ends = np.cumsum([len(mode.hessian) for mode in self.modes])
        plans = np.split(self.unscale @ z, ends[:-1])
        return [plan.reshape(len(self.times) - 1, -1) for plan in plans]


def make_horizon(settings: PredictiveSettings, interval: float) -> Horizon:
    """Condense all modes of a set at frames `interval` [s] apart."""
    prediction = settings.prediction
    times = knot_times(prediction.knots, interval, prediction.horizon.si)
    modes = []
    for name, mode in washout_modes(settings).items():
        costs = getattr(settings, name)
        sizes = np.array([getattr(costs, effort).si for effort in mode.layout.efforts])
        modes.append(condense(mode, times, sizes / prediction.smoothing.si))
    factor = linalg.cholesky(linalg.block_diag(*(mode.hessian for mode in modes)))
    unscale = linalg.solve_triangular(factor, np.eye(len(factor)))
    gradient = unscale.T @ linalg.block_diag(*(mode.gradient for mode in modes))
    motion, motion_of_plan = _join_maps(modes, [_motion_map(mode, times) for mode in modes])
    error, error_of_plan = _join_maps(modes, [_error_map(mode) for mode in modes])
    error_rows = error_of_plan.reshape(-1, len(factor))
    later, units = times + interval, np.eye(times.size)
    frame_step = np.array([np.interp(later, times, row) for row in units]).T
    motion_map = LinearMap(motion, motion_of_plan @ unscale)
    error_map = LinearMap(error, error_rows @ unscale)
    return Horizon(times, frame_step, modes, factor, unscale, gradient, motion_map, error_map)


def _motion_map(mode: Condensed, times: Matrix) -> Matrix:
    """Pose of the head with two derivatives at t_1 .. t_N, as one mode moves it, of (s, U)."""
    slopes = np.diff(mode.efforts, axis=0) / np.diff(times)[:, None, None]
    motion = np.zeros((3, len(slopes), 6, mode.states.shape[-1]))
    signals = (values.swapaxes(0, 1) for values in (mode.states[1:], mode.efforts[1:], slopes))
    for dof, derivatives in mode.mode.layout.motion(*signals).items():
        motion[:, :, dof] = derivatives
    return motion


def _error_map(mode: Condensed) -> Matrix:
    """Error of the force sensed over its threshold at t_1 .. t_N in one mode, of (s, U)."""
    states, axis = mode.states[1:], mode.mode.layout.axes.get("force")
    error = np.zeros((len(states), 3, states.shape[-1]))
    if axis is not None:
        error[:, axis] = mode.mode.sensed[-1, : states.shape[1]] @ states
    return error / load_senses().thresholds.si[:3, None]


def _join_maps(modes: list[Condensed], maps: list[Matrix]) -> tuple[Matrix, Matrix]:
    """Maps of (s, U) of each mode, as one of s and one of U of all modes in a row."""
    of_parameters, of_plans = [], []
    for mode, mode_map in zip(modes, maps, strict=True):
        parameter_count = mode.gradient.shape[1]
        of_parameters.append(mode_map[..., :parameter_count])
        of_plans.append(mode_map[..., parameter_count:])
    return np.concatenate(of_parameters, axis=-1), np.concatenate(of_plans, axis=-1)


class OtolithsAhead(NamedTuple):
    """Otoliths with states x_0 (2,) under a force f that runs straight between the knots."""

    sensed: Matrix  #: Rows S of what they sense at t_1 .. t_N, S (x_0, f_0 .. f_N), (N, N + 3).
    next_state: Matrix  #: Rows of x_1, (2, N + 3).
    resting: Matrix  #: x_0 of a constant force of 1 m/s^2, (2, 1).


def otoliths_ahead(times: Matrix) -> OtolithsAhead:
    """Otoliths over the knots at some times [s], (N + 1,)."""
    a, b, c, d = control.ssdata(state_space(otolith_response(load_senses().otoliths)))
    states = np.zeros((len(times), 2, len(times) + 2))
    states[0, :, :2] = np.eye(2)
    for knot, span in enumerate(np.diff(times)):
        discrete = discretise(a, b, c, d, float(span))
        states[knot + 1] = discrete.transition @ states[knot]
        input_gains = np.hstack([discrete.previous_gain, discrete.next_gain])
        states[knot + 1, :, 2 + knot : 4 + knot] += input_gains
    sensed = np.asarray(c @ states[1:])[:, 0]
    return OtolithsAhead(sensed, states[1], -np.linalg.solve(a, b))
