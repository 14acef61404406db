"""The predictive washout: a plan over a horizon that the legs can follow, made again each frame.

Per mode the model is that of `optimal`, with x = (x_v, x_d), u the simulator's rate and
acceleration and v the aircraft's inputs,

    dx/dt = A x + B u + E v,    J = int_0^H (x, v, u)^T W (x, v, u) dt + (x, v)^T P (x, v) at H

u and v run straight between the knots 0 = t_0 < t_1 < ... < t_N = H, t_1 one frame, later ones
farther apart by a constant ratio. Transitions and the cost of a span are exact (one exponential,
doubled). P solves the Riccati equation of `optimal`: beyond the horizon that washout takes over.
With U = (u_1 .. u_N) and what is given, s = (x_0, u_0, v_0 .. v_N), the states condense to

    J = U^T H U + 2 U^T G s + const,    z = R U with R^T R = H,    min z^T z / 2 + z^T R^-T G s

subject, at each knot, with q head displacement and attitude, L(q) legs and pose, J = dL/dq,

    |L(q*) + J (q - q*)| <= share of travel,   |J q'| <= share of speed,
    |J q'' + J'* (2 q' - q'*)| <= share of acceleration,   q*: the plan of the frame before
    with q + 2 T_k q' + T_k^2 q'' for q and q' + T_k q'' for q': no limit is run into; the
    acceleration at t_0 too, as that of the rotation jumps
    min(0, w) - R <= rate of roll, pitch <= max(0, w) + R
    min(0, s) - S <= specific force sensed <= max(0, s) + S

w the aircraft's Euler rate, R the largest tilt rate, s the specific force sensed in the aircraft, S
the size of a false cue: the platform may turn and push less than the aircraft, but against it or
beyond it only unnoticed. Each row may be passed at a price, so that a solution always exists: a
linear and steep one keeps all rows of legs and pose that can be kept, that of a false cue counts
with the time. If the solver does not end within its iterations, or live within its share of the
frame, the last plan goes on; after its end the linear washout u = -F (x, 0) takes over.

v ahead is `constant`; a `guess`, (v + m T (1 - exp(-t / T))) exp(-t / T_f) with the slope m
low-passed; or `known` from the flight. What is sent is the plan of the machine that follows it the
law's delay later, for v of that time: a guess and what is known lead by it, constant cannot. The
specific force that the small angles of the model miss is taken off v.
"""

from time import perf_counter
from typing import NamedTuple

import control
import daqp
import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from cmf_mj.core.compiled import allocating
from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.machine.cab import Cab
from cmf_mj.machine.geometry import Geometry
from cmf_mj.machine.kinematics import about, rotation, write_legs, write_pose_jacobian
from cmf_mj.machine.limits import MotionLimits
from cmf_mj.pilot.motion import turn_to_body
from cmf_mj.pilot.optimal import PLACES, condense, knots, parts, washout_modes
from cmf_mj.pilot.perception import load_senses, otolith_response, otoliths_ahead, state_space
from cmf_mj.pilot.washout_settings import PredictiveSettings

Matrix = NDArray[np.float64]

_MOVES = {"pitch_surge": (0, 4), "roll_sway": (1, 3), "yaw": (None, 5), "heave": (2, None)}
"""Displacement and angle of each mode among those of a pose."""

_BEGUN = 9  #: Accelerations bounded where a frame begins: of the legs and of the centroid's shift.
_STEP = 1e-6  #: Of time, to differentiate the Jacobian along the motion [s].
_SOLVED = (1, 2)  #: Exit flags of DAQP at an optimum, and at one that passes soft rows.
_SOFT = 8  #: How DAQP marks a row that may be passed at a price.
_STEEP = 1e-6  #: Reciprocal of the quadratic price of rows whose price is linear.
_TWICE = 20.0  #: Thresholds by which a false cue is passed where the next costs twice the first.
_GO_ON = 0.5  #: Time for which the last plan goes on alone, and then fades to a washout [s].

INPUTS = {name: list(inputs) for name, (inputs, _) in PLACES.items()}
"""Inputs of each mode among Euler rates and specific force."""

_EFFORTS = ("rate", "acceleration")  #: Names of the sizes of u.

_TILTING = ("pitch_surge", "roll_sway")


@allocating
def _reach(geometry, station, q, jacobian):  # type: ignore[no-untyped-def]
    """Write d(legs, pose of the centroid)/dq, (12, 6), at the head's q (6,)."""
    write_pose_jacobian(geometry, q, jacobian[:6])
    jacobian[6:] = np.eye(6)
    for axis in range(3, 6):
        there = q.copy()
        there[axis] += 1e-4
        back = q.copy()
        back[axis] -= 1e-4
        change = rotation(there[3], there[4], there[5]) - rotation(back[3], back[4], back[5])
        jacobian[6:9, axis] = -(change @ station) / 2e-4


@allocating
def along(geometry, station, q, q1, reached, jacobian, turning):  # type: ignore[no-untyped-def]
    """Write legs and pose (N, 12), their Jacobians and J' (N, 12, 6) of q and q' (N, 6)."""
    ahead = np.empty((12, 6))
    for k in range(q.shape[0]):
        write_legs(geometry, q[k], reached[k, :6])
        reached[k, 6:] = q[k]
        turn = rotation(q[k, 3], q[k, 4], q[k, 5])
        reached[k, 6:9] -= turn @ station - station
        _reach(geometry, station, q[k], jacobian[k])
        _reach(geometry, station, q[k] + _STEP * q1[k], ahead)
        turning[k] = (ahead - jacobian[k]) / _STEP


class Solves(NamedTuple):
    """What the solver did in a run, a number a frame."""

    seconds: list[float]  #: Of the whole frame, model and solver.
    iterations: list[int]
    bridged: list[bool]  #: Whether the last plan went on instead.

    def report(self, interval: float) -> str:
        """Times of frames `interval` [s] apart, how many were late or bridged, and the first."""
        taken, bridged = np.array(self.seconds or [0.0]), np.array(self.bridged or [False])
        shares = " / ".join(f"{1e3 * np.quantile(taken, q):.2g}" for q in (0.95, 0.999, 1.0))
        late = taken > interval
        first = np.flatnonzero(late | bridged)[:1]
        return (
            f"plans made in {shares} ms (95, 99.9 %, worst) of {1e3 * interval:.3g} ms: "
            f"{late.sum()} late, {bridged.sum()} of {len(self.bridged)} bridged by the last plan"
            + "".join(f", first at {interval * (1.0 + row):.2f} s" for row in first)
        )


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
        own, self.lead = settings.prediction, lead
        self.reference, self.times = own.reference, knots(own.knots, interval, own.horizon.si)
        self.solves = Solves([], [], [])
        self._by_name = washout_modes(settings)
        self._modes = {}
        for name, mode in self._by_name.items():
            sizes = getattr(settings, name)
            efforts = [getattr(sizes, key).si for key in _EFFORTS if hasattr(sizes, key)]
            smooth = np.array(efforts) / own.smoothing.si
            self._modes[name] = condense(mode, self.times, smooth)
        self._geometry: Geometry = about(cab.station, cab.machine)
        leg, (low, high) = limits.leg, limits.operational.T
        legs = [leg.position.si, leg.velocity.si, leg.acceleration.si]
        dofs = np.array([high, limits.velocity, limits.acceleration])
        most = own.share.si * np.hstack([np.repeat(np.array(legs)[:, None], 6, axis=1), dofs])
        self._bounds, self._station = (-most, most), cab.station
        self._bounds[0][0, 6:] = own.share.si * low
        self._tilt, self._false = own.tilt_rate.si, own.false_cue.si
        self._guess = (own.guess_time.si, own.guess_lag.si, own.guess_fade.si)
        self._otoliths, self._otoliths_on = otoliths_ahead(self.times)
        self._noticed = load_senses().thresholds.si[:3]
        near = own.approach.si + own.foresight.si * self.times[1:]
        one, nil = np.ones_like(near), np.zeros_like(near)
        self._approach = np.array([[one, 2.0 * near, near**2], [nil, one, near], [nil, nil, one]])
        moved = self.times + interval
        self._shift = np.array([np.interp(moved, self.times, row) for row in np.eye(own.knots + 1)])
        self._assemble()
        self._program, self._ready = daqp.Model(), False
        self._program.settings = {"iter_limit": own.iterations}
        spans = np.convolve(np.diff(self.times), [0.5, 0.5])[1:]
        many = _BEGUN + 36 * own.knots, 2 * own.knots
        prices = np.repeat([own.price.si, own.tilt_price.si], many)
        self._prices = np.concatenate([prices, np.repeat(own.false_price.si * spans, 3)])
        cues = _TWICE / np.maximum(self._prices[len(prices) :], 1e-9)
        steep = np.repeat([_STEEP, 1e3 * _STEEP], many)
        self._ease = np.concatenate([steep, cues])

    def _assemble(self) -> None:
        """Motion and cost of all modes at the knots 1 .. N, of s and of z = R U."""
        count, modes = len(self.times) - 1, self._modes.values()
        given = sum(mode.gradient.shape[1] for mode in modes)
        free = sum(len(mode.hessian) for mode in modes)
        motion, error = np.zeros((3, count, 6, given + free)), np.zeros((count, 3, given + free))
        spans = np.diff(self.times)[:, None]
        s_begin, u_begin = 0, given
        for name, mode in self._modes.items():
            s_count, u_count = mode.gradient.shape[1], len(mode.hessian)
            columns = np.r_[s_begin : s_begin + s_count, u_begin : u_begin + u_count]
            s_begin, u_begin = s_begin + s_count, u_begin + u_count
            place, angle = _MOVES[name]
            states, sensed = mode.states[1:], self._by_name[name].sensed[-1]
            if name != "yaw":
                error[:, INPUTS[name][-1] - 3, columns] = sensed[: states.shape[1]] @ states
            if place is not None:
                begin = -3 if angle is not None else -2
                moved = (states[:, begin], states[:, begin + 1], mode.inputs[1:, -1])
                motion[:, :, place, columns] = np.array(moved)
            if angle is not None:
                slope = np.diff(mode.inputs[:, 0], axis=0) / spans
                motion[:, :, angle, columns] = np.array([states[:, -1], mode.inputs[1:, 0], slope])
        self._factor = linalg.cholesky(linalg.block_diag(*(mode.hessian for mode in modes)))
        self._ends = np.cumsum([len(mode.hessian) for mode in modes])[:-1]
        unscale = linalg.solve_triangular(self._factor, np.eye(free))
        self._pull = unscale.T @ linalg.block_diag(*(mode.gradient for mode in modes))
        self._unscale, self._given = unscale, motion[..., :given]
        self._free = motion[..., given:] @ unscale
        self._near = np.einsum("ijk,jk...->ik...", self._approach, self._free)
        noticed = self._noticed[:, None]
        self._error = error[..., :given] / noticed
        turned = self._free[1, :, 3:5].reshape(2 * count, free) / self._tilt
        pushed = (error[..., given:] / noticed).reshape(3 * count, free) @ unscale
        self._soft = np.vstack([turned, pushed])

    def bound(self, seconds: float) -> None:
        """Let the solver take so long and no longer [s]; 0 counts its iterations alone."""
        self._program.settings = {"time_limit": seconds}

    def start(self, euler_rates: Matrix, force: Matrix, angular: Matrix, linear: Matrix) -> None:
        """As `Classical.start`: at rest, tilted by what costs least for a sustained force."""
        self._v = np.concatenate([euler_rates, force + [0.0, 0.0, STANDARD_GRAVITY]])
        self._now = self._v
        self._slope, self._offset, self._lost = np.zeros(6), np.zeros(6), 0
        a, b, _, _ = control.ssdata(state_space(otolith_response(load_senses().otoliths)))
        self._sensed = -np.linalg.solve(a, b) @ self._v[None, 3:]
        self._state, self._plan, self._turn = {}, {}, {}
        for name, mode in self._by_name.items():
            a, both, weight, _ = parts(mode)
            n, m = len(a), mode.plant[1].shape[1]
            sensed = n - {"yaw": 2, "heave": 3}.get(name, 4)
            v = self._v[INPUTS[name]]
            turned, driven = np.zeros(len(weight)), np.zeros(len(weight))
            turned[n - 1], driven[n + m :] = float(name in _TILTING), v
            for rest, pushed in (
                (turned, a[:sensed, n - 1] * turned[n - 1]),
                (driven, both[:sensed, m:] @ v),
            ):
                rest[:sensed] = -np.linalg.solve(a[:sensed, :sensed], pushed)
            if name in _TILTING:
                angle = -(turned @ weight @ driven) / (turned @ weight @ turned)
                most = 0.5 * self._bounds[1][0, 9 + (name == "pitch_surge")]
                driven += turned * np.clip(angle, -most, most)
            self._state[name] = driven[:n]
            self._plan[name], self._turn[name] = np.zeros((len(self.times), m)), np.zeros(m)
        self._read(angular, linear)

    def move(
        self,
        euler_rates: Matrix,
        force: Matrix,
        angular: Matrix,
        linear: Matrix,
        ahead: Matrix | None = None,
    ) -> None:
        """One sample; arguments as for `move_classical`.

        `ahead` are Euler rates and specific force less that of level rest at the knots 2 .. N.
        """
        begun, times = perf_counter(), self.times
        now = np.concatenate([euler_rates, force + [0.0, 0.0, STANDARD_GRAVITY]])
        inputs = self._inputs_ahead(now, ahead)
        forces = np.vstack([self._sensed, inputs[:, 3:]])
        sensed, self._sensed = self._otoliths @ forces, self._otoliths_on @ forces
        inputs = inputs - self._offset
        given = [
            np.concatenate([self._state[name], self._plan[name][0], inputs[:, places].ravel()])
            for name, places in INPUTS.items()
        ]
        start = self._factor @ np.concatenate([plan[1:].ravel() for plan in self._plan.values()])
        z, iterations = self._solve(self.programme(np.concatenate(given), start, inputs, sensed))
        self._lost = self._lost + 1 if z is None else 0
        plans = np.split(self._unscale @ (start if z is None else z), self._ends)
        for (name, mode), own, u in zip(self._modes.items(), given, plans, strict=True):
            if self._lost:  # the linear washout takes over from the plan
                share = np.clip(self._lost * times[1] / _GO_ON - 1.0, 0.0, 1.0)
                first, m = u.copy(), self._plan[name].shape[1]
                first[:m] = 0.0
                felt = mode.states[1] @ np.concatenate([own, first])
                felt = np.concatenate([felt, inputs[1, INPUTS[name]]])
                feedback, later = self._by_name[name].feedback, mode.states[1][:, len(own) :]
                loop = np.eye(m) + feedback[:, : len(later)] @ later[:, :m]
                u[:m] -= share * (np.linalg.solve(loop, feedback @ felt) + u[:m])
            before = self._plan[name][:1]
            self._state[name] = mode.states[1] @ np.concatenate([own, u])
            plan = np.vstack([before, u.reshape(len(times) - 1, -1)])
            self._plan[name] = self._shift.T @ plan
            self._turn[name] = (plan[1] - plan[0]) / times[1]
        self._read(angular, linear)
        felt = np.empty(3)
        turn_to_body(angular[0], linear[2] - [0.0, 0.0, STANDARD_GRAVITY], felt)
        tilt = STANDARD_GRAVITY * np.array([angular[0, 1], -angular[0, 0], -1.0])
        self._offset[3:] = felt - linear[2] - tilt
        self.solves.seconds.append(perf_counter() - begun)
        self.solves.iterations.append(iterations)
        self.solves.bridged.append(z is None)

    def _read(self, angular: Matrix, linear: Matrix) -> None:
        """Write attitude and displacement of the head with two derivatives, (3, 3) each."""
        motion = np.zeros((3, 6))
        for name, (place, angle) in _MOVES.items():
            x, u = self._state[name], self._plan[name][0]
            if place is not None:
                at = -3 if angle is not None else -2
                motion[:, place] = x[at], x[at + 1], u[-1]
            if angle is not None:
                motion[:, angle] = x[-1], u[0], self._turn[name][0]
        linear[:], angular[:] = motion[:, :3], motion[:, 3:]

    def _inputs_ahead(self, now: Matrix, ahead: Matrix | None) -> Matrix:
        """Euler rates and specific force less that of level rest at all knots, (N + 1, 6)."""
        time, lag, fade = self._guess
        self._slope += ((now - self._now) / self.times[1] - self._slope) * self.times[1] / lag
        rows = np.vstack([self._v, np.broadcast_to(now, (len(self.times) - 1, 6))])
        if ahead is not None:
            rows[2:] = ahead
        elif self.reference == "guess":
            since = self.times[1:, None] - self.times[1]
            rows[1:] += self._slope * time * (1.0 - np.exp(-(self.lead + since) / time))
            rows[1:] *= np.exp(-since / fade)
        self._now, self._v = now, rows[1]
        return rows

    def programme(
        self, given: Matrix, start: Matrix, inputs: Matrix, sensed: Matrix
    ) -> dict[str, Matrix]:
        """f, A and bounds of min z^T z / 2 + f^T z, linearised along the plan z = `start`.

        `given` is s of all modes, `inputs` the aircraft's at all knots, (N + 1, 6), `sensed` the
        specific force sensed in it at the knots 1 .. N, (N, 3).
        """
        count, size = self._free.shape[1], len(start)
        held = self._given @ given
        q, q1, _ = held + self._free @ start
        reached, jacobian = np.empty((count, 12)), np.empty((count, 12, 6))
        turning = np.empty_like(jacobian)
        along(self._geometry, self._station, q, q1, reached, jacobian, turning)
        rest = (jacobian @ held[..., None])[..., 0]
        rest[0] += reached - (jacobian @ q[..., None])[..., 0]
        rest[2] += (turning @ (2.0 * held[1] - q1)[..., None])[..., 0]
        rest = np.einsum("ijk,jkl->ikl", self._approach, rest)
        turned, aircraft = held[1, :, 3:5] / self._tilt, inputs[1:, :2] / self._tilt
        scale = self._bounds[1][:, None]
        curved = 2.0 * turning @ self._free[1]
        rows = jacobian @ self._near + self._approach[:, 2, :, None, None] * curved
        rows /= scale[..., None]
        low, high = ((bound[:, None] - rest) / scale for bound in self._bounds)
        low_turn, high_turn = np.minimum(aircraft, 0.0) - 1.0, np.maximum(aircraft, 0.0) + 1.0
        # The row bounds the error: what the simulator's pilot senses less what the aircraft's does.
        missed, pushed = self._error @ given, sensed / self._noticed
        low_push, high_push = -np.maximum(pushed, 0.0), -np.minimum(pushed, 0.0)
        # Where a frame begins, the acceleration of the rotation jumps, that of the shift does not.
        begun, jump = held[2, 0].copy(), self._free[2, 0].copy()
        for name, (place, _) in _MOVES.items():
            if place is not None:
                begun[place], jump[place] = self._plan[name][0, -1], 0.0
        most = self._bounds[1][2, :_BEGUN]
        begun = (jacobian[0] @ begun + turning[0] @ q1[0])[:_BEGUN] / most
        jump = (jacobian[0] @ jump)[:_BEGUN] / most[:, None]
        lows = (-1.0 - begun, low, low_turn - turned, low_push - self._false - missed)
        highs = (1.0 - begun, high, high_turn - turned, high_push + self._false - missed)
        return {
            "f": self._pull @ given,
            "A": np.vstack([jump, rows.reshape(-1, size), self._soft]),
            "blower": np.concatenate([values.ravel() for values in lows]),
            "bupper": np.concatenate([values.ravel() for values in highs]),
        }

    def _solve(self, programme: dict[str, Matrix]) -> tuple[Matrix | None, int]:
        """What solves a programme, or None where the solver did not end; iterations."""
        if self._ready:
            flag = self._program.update(**programme)
        else:
            soft = np.full(len(programme["A"]), _SOFT, dtype=np.int32)
            unit = np.eye(len(programme["f"]))
            flag, _ = self._program.setup(unit, sense=soft, **programme)
            self._ready = flag >= 0
            both = {"w_l": self._prices, "w_u": self._prices}
            self._program.soft_weights(**both, rho_l=self._ease, rho_u=self._ease)
        if flag < 0:
            return None, 0
        z, _, flag, said = self._program.solve()
        good = flag in _SOLVED and bool(np.isfinite(z).all())
        return (z if good else None), int(said["iterations"])
