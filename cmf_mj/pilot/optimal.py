"""The optimal washout: linear filters that minimise the error sensed within the travel.

After Sivan, Ish-Shalom and Huang (1982) and Telban and Cardullo (NASA CR-2005-213747). Per mode,
with x_v the states of canals and otoliths driven by simulator less aircraft, x_d the states to be
kept small and x_n the aircraft's inputs, modelled as first-order noise of corner b,

    dx_v/dt = A_v x_v + B_v (v_S - v_A),   e = C_v x_v + D_v (v_S - v_A)
    dx_d/dt = A_d x_d + B_d u,             dx_n/dt = -b x_n + w,    v_A = x_n
    J = E int (e/e0)^2 + (x_d/x_d0)^2 + (u/u0)^2 dt

where v = (rate, specific force), and u = (rate, acceleration) of the simulator:

    pitch, surge   f_S = a + g pitch         x_d = int p, p, dp/dt, angle
    roll, sway     f_S = a - g roll          likewise
    heave          f_S = a                   x_d = int p, p, dp/dt
    yaw            rate only                 x_d = int angle, angle

Unlike the originals the aircraft's specific force is a separate input, not acceleration and
tilt: it is known, and large attitudes need no small angles. The integrals make position and yaw
wash out wholly. The Riccati equation gives u = -F (x_v, x_d, x_n); with x_n = v_A that is a linear
filter from v_A to u, whose states hold the simulator's position and angle. Sizes e0, x_d0, u0 are
the settings (Bryson's rule). The canals are taken without their lead of 0.06 s, to be proper.
"""

from collections.abc import Iterable
from typing import NamedTuple

import control
import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.optimize import brentq

from cmf_mj.core.compiled import allocating
from cmf_mj.core.filters import hold
from cmf_mj.core.settings import Settings
from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.pilot.classical import Filter, Matrices, empty_filter, push_sample, start_filter
from cmf_mj.pilot.perception import canal_response, load_senses, otolith_response, state_space
from cmf_mj.pilot.washout_settings import OptimalSettings, TiltCost

Matrix = NDArray[np.float64]


class WashoutMode(NamedTuple):
    """A linear-quadratic problem and its solution."""

    plant: tuple[Matrix, Matrix]  #: A, B of dx/dt = A x + B u with x = (x_v, x_d, x_n).
    cost: tuple[Matrix, Matrix, Matrix]  #: Q, N, R of x Q x + 2 x N u + u R u.
    riccati: Matrix  #: P of the algebraic Riccati equation.
    feedback: Matrix  #: F of u = -F x.
    filter: Matrices
    """A, B, C, D from the aircraft's inputs to the simulator's motion; states (x_v, x_d)."""
    sensed: Matrix  #: e of x, less what u adds at once, (rate and force, n).


class Optimal(NamedTuple):
    """The algorithm at work; its arrays are overwritten by each sample."""

    filter: Filter
    """Euler rates (3), specific force less that of level rest (3) and slopes of the Euler rates
    and the force (6) to angles and displacements with two derivatives (18)."""
    interval: float  #: T [s].

    def start(self, euler_rates: Matrix, force: Matrix, angular: Matrix, linear: Matrix) -> None:
        """As `Classical.start`."""
        beyond = force + [0.0, 0.0, STANDARD_GRAVITY]
        start_filter(self.filter, np.concatenate([euler_rates, beyond, np.zeros(6)]))
        move_optimal(self, euler_rates, np.zeros(3), force, angular, linear)


def _solve(
    vestibular: control.StateSpace,
    tilt: float,
    chain: tuple[Matrix, Matrix],
    sizes: tuple[list[float], list[float], list[float]],
    corners: list[float],
    motion: tuple[Matrix, Matrix],
) -> WashoutMode:
    """Solve one mode, whose filter's outputs are the rows `motion` of x_d and u.

    `vestibular` leads from v to what is sensed, `tilt` is the specific force of its last input per
    last state of the chain A_d, B_d; sizes are of errors, of x_d, of u, corners b [rad/s].
    """
    av, bv, cv, dv = control.ssdata(vestibular)
    ad, bd = chain
    nv, nd, nn = len(av), len(ad), len(corners)
    # v_S = S u + G x_d: tilt adds to the specific force.
    gravity = np.zeros((nn, nd))
    gravity[-1, -1] = tilt
    a = linalg.block_diag(av, ad, -np.diag(corners))
    a[:nv, nv:] = np.hstack([bv @ gravity, -bv])
    b = np.vstack([bv, bd, np.zeros((nn, nn))])
    errors, states, efforts = (np.diag(1.0 / np.square(size)) for size in sizes)
    sensed = np.hstack([cv, dv @ gravity, -dv])
    q = sensed.T @ errors @ sensed
    q = 0.5 * (q + q.T)
    q[nv : nv + nd, nv : nv + nd] += states
    n = sensed.T @ errors @ dv
    r = efforts + dv.T @ errors @ dv
    p = linalg.solve_continuous_are(a, b, q, r, s=n)
    feedback = linalg.solve(r, b.T @ p + n.T, assume_a="pos")
    kept, aircraft = feedback[:, : nv + nd], feedback[:, nv + nd :]
    own, entry = a[: nv + nd], b[: nv + nd]
    closed = own[:, : nv + nd] - entry @ kept, own[:, nv + nd :] - entry @ aircraft
    rows, efforts_in = motion
    c = np.hstack([np.zeros((len(rows), nv)), rows]) - efforts_in @ kept
    filtering = (*closed, c, -efforts_in @ aircraft)
    return WashoutMode((a, b), (q, n, r), p, feedback, filtering, sensed)


def _pick(count: int, *places: int | None) -> Matrix:
    """Rows that pick each one of `count` variables, or none of them."""
    return np.eye(count + 1, count)[[count if place is None else place for place in places]]


def _si(sizes: Settings, *names: str) -> list[float]:
    return [getattr(sizes, name).si for name in names]


_TRAVEL = ("position_integral", "position", "velocity")


def washout_modes(settings: OptimalSettings) -> dict[str, WashoutMode]:
    """All four modes by name.

    Inputs of a filter are Euler rate and specific force, outputs angle, its rate, displacement,
    velocity and acceleration, as far as the mode has them.
    """
    senses = load_senses()
    proper = {"lead": senses.canals.lead.model_copy(update={"value": 0.0})}
    canals = state_space(canal_response(senses.canals.model_copy(update=proper)))
    otoliths = state_space(otolith_response(senses.otoliths))
    path, pushed = np.diag([1.0, 1.0], 1), np.array([[0.0], [0.0], [1.0]])
    turn, turned = np.diag([1.0], 1), np.array([[0.0], [1.0]])

    def tilting(sizes: TiltCost, sign: float) -> WashoutMode:
        chain = (linalg.block_diag(path, [[0.0]]), linalg.block_diag(pushed, [[1.0]])[:, ::-1])
        errors = _si(sizes, "rate_error", "force_error")
        kept = (errors, _si(sizes, *_TRAVEL, "angle"), _si(sizes, "rate", "acceleration"))
        corners = _si(sizes, "rate_bandwidth", "force_bandwidth")
        motion = (_pick(4, 3, None, 1, 2, None), _pick(2, None, 0, None, None, 1))
        both = control.append(canals, otoliths)
        return _solve(both, sign * STANDARD_GRAVITY, chain, kept, corners, motion)

    solved = {
        "pitch_surge": tilting(settings.pitch_surge, 1.0),
        "roll_sway": tilting(settings.roll_sway, -1.0),
    }
    yaw, heave = settings.yaw, settings.heave
    kept = _si(yaw, "rate_error"), _si(yaw, "angle_integral", "angle"), _si(yaw, "rate")
    motion = (_pick(2, 1, None), _pick(1, None, 0))
    corners = _si(yaw, "rate_bandwidth")
    solved["yaw"] = _solve(canals, 0.0, (turn, turned), kept, corners, motion)
    kept = _si(heave, "force_error"), _si(heave, *_TRAVEL), _si(heave, "acceleration")
    motion = (_pick(3, 1, 2, None), _pick(1, None, None, 0))
    corners = _si(heave, "force_bandwidth")
    solved["heave"] = _solve(otoliths, 0.0, (path, pushed), kept, corners, motion)
    return solved


PLACES = {
    "pitch_surge": ((1, 3), (1, 4, 9, 12, 15)),
    "roll_sway": ((0, 4), (0, 3, 10, 13, 16)),
    "yaw": ((2,), (2, 5)),
    "heave": ((5,), (11, 14, 17)),
}
"""Inputs and outputs of each mode among those of `Optimal.filter`."""


def make_optimal(settings: OptimalSettings, interval: float) -> Optimal:
    """The algorithm at samples `interval` [s] apart; `start` begins."""
    by_name = washout_modes(settings)
    a = linalg.block_diag(*(mode.filter[0] for mode in by_name.values()))
    b, c, d = np.zeros((len(a), 12)), np.zeros((18, len(a))), np.zeros((18, 12))
    begin = 0
    for name, mode in by_name.items():
        mode_a, mode_b, mode_c, mode_d = mode.filter
        states = slice(begin, begin + len(mode_a))
        begin = states.stop
        inputs, outputs = (np.array(place) for place in PLACES[name])
        b[states, inputs] = mode_b
        c[outputs, states] = mode_c
        d[np.ix_(outputs, inputs)] = mode_d
        # Angular acceleration is the derivative of the rate, an output with direct feed-through.
        for rate in outputs[(outputs >= 3) & (outputs < 6)]:
            row = list(outputs).index(rate)
            c[rate + 3, states] = mode_c[row] @ mode_a
            d[rate + 3, inputs] = mode_c[row] @ mode_b
            d[rate + 3, inputs + 6] = mode_d[row]
    return Optimal(empty_filter(hold(a, b, c, d, interval)), interval)


class Condensed(NamedTuple):
    """One mode over the horizon; given s = (x_0, u_0, v_0 .. v_N) and free U = (u_1 .. u_N)."""

    hessian: Matrix  #: H, (mN, mN).
    gradient: Matrix  #: G, (mN, s).
    states: Matrix  #: x at each knot of (s, U), (N + 1, n, s + mN).
    inputs: Matrix  #: u at each knot of (s, U), (N + 1, m, s + mN).


def knots(count: int, first: float, horizon: float) -> Matrix:
    """Times t_0 .. t_N [s], (N + 1,): the first span given, later ones longer by one ratio."""
    if horizon <= count * first * (1.0 + 1e-9):
        return np.asarray(first * np.arange(count + 1))
    sums = np.arange(count)
    ratio = brentq(lambda r: first * np.sum(r**sums) - horizon, 1.0, horizon / first + 1.0)
    return np.concatenate([[0.0], np.cumsum(first * ratio**sums)])


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
    joined = linalg.expm(part * np.block([[-chain.T, cost], [np.zeros_like(chain), chain]]))
    over = joined[len(chain) :, len(chain) :]
    total = over.T @ joined[: len(chain), len(chain) :]
    for _ in range(doublings):
        total, over = total + over.T @ total @ over, over @ over
    slope = np.eye(n + 2 * m)
    slope[n + m :, n : n + m], slope[n + m :, n + m :] = -np.eye(m) / span, np.eye(m) / span
    total = slope.T @ total @ slope
    return np.asarray(0.5 * (total + total.T))


def parts(mode: WashoutMode) -> tuple[Matrix, Matrix, Matrix, Matrix]:
    """A, (B, E), the weight of (x, u, v) and P of (x, v) of a mode."""
    n, m = len(mode.filter[0]), mode.plant[1].shape[1]
    (a, b), (q, cross, r) = mode.plant, mode.cost
    order = np.r_[:n, len(a) : len(a) + m, n : len(a)]
    weight = np.block([[q, cross], [cross.T, r]])[np.ix_(order, order)]
    return a[:n, :n], np.hstack([b[:n], a[:n, n:]]), weight, mode.riccati


def condense(mode: WashoutMode, times: Matrix, smooth: Iterable[float] = ()) -> Condensed:
    """Condense a mode over knots at some times [s]; slopes of u cost int (u' / smooth)^2 dt."""
    a, b, weight, terminal = parts(mode)
    n, m, both = len(a), mode.plant[1].shape[1], b.shape[1]
    count, p = len(times) - 1, both - m
    given = n + m + p * (count + 1)
    size = given + m * count
    states, inputs = np.zeros((count + 1, n, size)), np.zeros((count + 1, both, size))
    states[0, :, :n] = np.eye(n)
    for k in range(count + 1):
        own = n if k == 0 else given + m * (k - 1)
        inputs[k, :m, own : own + m] = np.eye(m)
        ahead = n + m + p * k
        inputs[k, m:, ahead : ahead + p] = np.eye(p)
    total = np.zeros((size, size))
    for k, span in enumerate(np.diff(times)):
        held = hold(a, b, np.zeros((0, n)), np.zeros((0, both)), float(span))
        states[k + 1] = held.transition @ states[k]
        states[k + 1] += held.earlier @ inputs[k] + held.later @ inputs[k + 1]
        stage = np.vstack([states[k], inputs[k], inputs[k + 1]])
        total += stage.T @ span_cost((a, b), weight, float(span)) @ stage
        for row, size in enumerate(smooth):
            change = (inputs[k + 1, row] - inputs[k, row]) / size
            total += np.outer(change, change) / span
    last = np.vstack([states[-1], inputs[-1, m:]])
    total += last.T @ terminal @ last
    return Condensed(total[given:, given:], total[given:, :given], states, inputs[:, :m])


@allocating
def move_optimal(optimal, euler_rates, slopes, force, angular, linear):  # type: ignore[no-untyped-def]
    """One sample; arguments as for `move_classical`."""
    inputs, out = np.empty(12), np.empty(18)
    inputs[:3], inputs[3:6], inputs[6:9] = euler_rates, force, slopes
    inputs[5] += STANDARD_GRAVITY
    inputs[9:] = (inputs[3:6] - optimal.filter.inputs[3:6]) / optimal.interval
    push_sample(optimal.filter, inputs, out)
    angular[:] = out[:9].reshape(3, 3)
    linear[:] = out[9:].reshape(3, 3)
