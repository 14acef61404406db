"""The programme that a predictive washout solves each frame: the limits of a plan, at a price.

At each knot of the horizon, with q head displacement and attitude, the reach L(q) legs and pose of
the centroid, and J = dL/dq,

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
with the time. All rows are in units of their limit.
"""

from typing import NamedTuple

import daqp
import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.compiled import allocating
from cmf_mj.machine.cab import Cab
from cmf_mj.machine.geometry import Geometry
from cmf_mj.machine.kinematics import geometry_about, rotation, write_legs, write_pose_jacobian
from cmf_mj.machine.limits import MotionLimits
from cmf_mj.pilot.horizon import Horizon
from cmf_mj.pilot.perception import load_senses
from cmf_mj.pilot.washout_settings import Prediction

Matrix = NDArray[np.float64]

_DISPLACEMENT, _TILT = slice(0, 3), slice(3, 5)  #: Displacement, and roll and pitch, of a pose.
_REACH_SIZE = 12  #: Legs and pose.
_BOUNDED_AT_START = slice(0, 9)  #: Of the reach at t_0: the legs and the centroid's displacement.
_TIME_STEP = 1e-6  #: To differentiate the Jacobian along the motion [s].
_ANGLE_STEP = 1e-4  #: To differentiate the rotation [rad].
_SOLVED = (1, 2)  #: Exit flags of DAQP at an optimum, and at one that passes soft rows.
_SOFT = 8  #: How DAQP marks a row that may be passed at a price.
_STEEP, _STEEP_TILT = 1e-6, 1e-3
"""Reciprocals of the quadratic price of rows whose price is linear: legs and pose, tilt rate."""
_DOUBLING = 20.0  #: Thresholds by which a false cue is passed where the next costs twice the first.


class Reach(NamedTuple):
    """Legs and pose of the centroid at N knots of a motion of the head."""

    values: Matrix  #: L, (N, 12).
    jacobian: Matrix  #: J, (N, 12, 6).
    turning: Matrix  #: J', (N, 12, 6).


@allocating
def _write_jacobian(geometry, station, pose, jacobian):  # type: ignore[no-untyped-def]
    """Write J (12, 6) at a pose of the head (6,)."""
    write_pose_jacobian(geometry, pose, jacobian[:6])
    jacobian[6:] = np.eye(6)
    for axis in range(3, 6):
        pose_above = pose.copy()
        pose_above[axis] += _ANGLE_STEP
        pose_below = pose.copy()
        pose_below[axis] -= _ANGLE_STEP
        change = rotation(pose_above[3], pose_above[4], pose_above[5]) - rotation(
            pose_below[3], pose_below[4], pose_below[5]
        )
        jacobian[6:9, axis] = -(change @ station) / (2.0 * _ANGLE_STEP)


@allocating
def reach_along(geometry, station, poses, rates):  # type: ignore[no-untyped-def]
    """The reach of poses of the head at a station and their rates, (N, 6) each."""
    count = poses.shape[0]
    reach = Reach(np.empty((count, 12)), np.empty((count, 12, 6)), np.empty((count, 12, 6)))
    jacobian_ahead = np.empty((12, 6))
    for knot in range(count):
        pose, values, jacobian = poses[knot], reach.values[knot], reach.jacobian[knot]
        write_legs(geometry, pose, values[:6])
        values[6:] = pose
        values[6:9] -= rotation(pose[3], pose[4], pose[5]) @ station - station
        _write_jacobian(geometry, station, pose, jacobian)
        _write_jacobian(geometry, station, pose + _TIME_STEP * rates[knot], jacobian_ahead)
        reach.turning[knot] = (jacobian_ahead - jacobian) / _TIME_STEP
    return reach


class Rows(NamedTuple):
    """Rows of a programme, low <= matrix z <= high."""

    matrix: Matrix
    low: Matrix
    high: Matrix


class Prices(NamedTuple):
    """What a unit beyond each row of a programme costs."""

    linear: Matrix
    ease: Matrix  #: Reciprocal of the quadratic price.


def _prices(settings: Prediction, times: Matrix) -> Prices:
    """Prices of all rows over knots at some times [s], in the order of `PlanLimits.programme`."""
    spans, count = np.convolve(np.diff(times), [0.5, 0.5])[1:], times.size - 1
    cue_prices = np.repeat(settings.false_price.si * spans, 3)
    cue_ease = _DOUBLING / np.maximum(cue_prices, 1e-9)
    # At t_0 acceleration alone is bounded; at each knot travel, speed and acceleration are.
    row_counts = (_BOUNDED_AT_START.stop + 3 * _REACH_SIZE * count, 2 * count)
    prices = np.repeat([settings.price.si, settings.tilt_price.si], row_counts)
    ease = np.repeat([_STEEP, _STEEP_TILT], row_counts)
    return Prices(np.concatenate([prices, cue_prices]), np.concatenate([ease, cue_ease]))


class PlanLimits:
    """Limits of legs, pose, tilt and false cues over a horizon."""

    def __init__(
        self, settings: Prediction, horizon: Horizon, cab: Cab, limits: MotionLimits
    ) -> None:
        """Take the usable share of a cab's limits."""
        self._settings, self._horizon, self._station = settings, horizon, cab.station
        self._geometry: Geometry = geometry_about(cab.station, cab.machine)
        leg, (low, high) = limits.leg, limits.operational.T
        leg_limits = np.array([leg.position.si, leg.velocity.si, leg.acceleration.si])
        pose_limits = np.array([high, limits.velocity, limits.acceleration])
        share, legs = settings.share.si, np.repeat(leg_limits[:, None], 6, axis=1)
        self.high = share * np.hstack([legs, pose_limits])  #: Of the reach, (3, 12).
        self.low = -self.high
        self.low[0, 6:] = share * low

        self._thresholds = load_senses().thresholds.si[:3]
        motion, later = horizon.motion.of_decisions, horizon.times[1:]
        lead = settings.approach.si + settings.foresight.si * later
        ones, zeros = np.ones_like(lead), np.zeros_like(lead)
        bounded = [[ones, 2.0 * lead, lead**2], [zeros, ones, lead], [zeros, zeros, ones]]
        self._bound_weights = np.array(bounded)
        """What of q, q' and q'' is bounded as travel, speed and acceleration, (3, 3, N)."""
        self._bounded_motion = np.einsum("ijk,jk...->ik...", self._bound_weights, motion)
        tilt_rates = motion[1, :, _TILT].reshape(2 * later.size, -1)
        self._tilt_matrix = tilt_rates / settings.tilt_rate.si
        self._cue_matrix = horizon.error.of_decisions
        self.prices = _prices(settings, horizon.times)

    def programme(
        self, parameters: Matrix, plan: Matrix, inputs: Matrix, sensed: Matrix, acceleration: Matrix
    ) -> dict[str, Matrix]:
        """f, A and bounds of min z^T z / 2 + f^T z, linearised along the plan z.

        `parameters` is s of all modes, `inputs` the aircraft's at all knots, (N + 1, 6), `sensed`
        the specific force sensed in it at t_1 .. t_N, (N, 3), `acceleration` that of the head at
        t_0, (3,).
        """
        motion = self._horizon.motion
        resting = motion.of_parameters @ parameters
        pose, rate, _ = resting + motion.of_decisions @ plan
        reach = reach_along(self._geometry, self._station, pose, rate)
        rows = (
            self._start_rows(reach, resting, rate, acceleration),
            self._reach_rows(reach, resting, pose, rate),
            self._tilt_rows(resting, inputs),
            self._cue_rows(parameters, sensed),
        )
        return {
            "f": self._horizon.gradient @ parameters,
            "A": np.vstack([group.matrix for group in rows]),
            "blower": np.concatenate([group.low.ravel() for group in rows]),
            "bupper": np.concatenate([group.high.ravel() for group in rows]),
        }

    def _start_rows(self, reach: Reach, resting: Matrix, rate: Matrix, head: Matrix) -> Rows:
        """Acceleration at t_0, where that of the rotation jumps, that of the `head` not."""
        limit = self.high[2, _BOUNDED_AT_START]
        acceleration, jump = resting[2, 0].copy(), self._horizon.motion.of_decisions[2, 0].copy()
        acceleration[_DISPLACEMENT], jump[_DISPLACEMENT] = head, 0.0
        jacobian, turning = reach.jacobian[0], reach.turning[0]
        start = (jacobian @ acceleration + turning @ rate[0])[_BOUNDED_AT_START] / limit
        matrix = (jacobian @ jump)[_BOUNDED_AT_START] / limit[:, None]
        return Rows(matrix, -1.0 - start, 1.0 - start)

    def _reach_rows(self, reach: Reach, resting: Matrix, pose: Matrix, rate: Matrix) -> Rows:
        """Travel, speed and acceleration of legs and pose, (3, N, 12) rows."""
        values = (reach.jacobian @ resting[..., None])[..., 0]
        values[0] += reach.values - (reach.jacobian @ pose[..., None])[..., 0]
        values[2] += (reach.turning @ (2.0 * resting[1] - rate)[..., None])[..., 0]
        values = np.einsum("ijk,jkl->ikl", self._bound_weights, values)
        turning = 2.0 * reach.turning @ self._horizon.motion.of_decisions[1]
        matrix = reach.jacobian @ self._bounded_motion
        matrix += self._bound_weights[:, 2, :, None, None] * turning
        scale = self.high[:, None]
        matrix /= scale[..., None]
        low, high = ((limit[:, None] - values) / scale for limit in (self.low, self.high))
        return Rows(matrix.reshape(-1, matrix.shape[-1]), low, high)

    def _tilt_rows(self, resting: Matrix, aircraft: Matrix) -> Rows:
        """Rates of roll and pitch, next to those of the aircraft."""
        limit = self._settings.tilt_rate.si
        rate, aircraft_rate = resting[1, :, _TILT] / limit, aircraft[1:, :2] / limit
        low, high = np.minimum(aircraft_rate, 0.0) - 1.0, np.maximum(aircraft_rate, 0.0) + 1.0
        return Rows(self._tilt_matrix, low - rate, high - rate)

    def _cue_rows(self, parameters: Matrix, sensed: Matrix) -> Rows:
        """The error: what the simulator's pilot senses less what the aircraft's does."""
        limit, error = self._settings.false_cue.si, self._horizon.error.of_parameters @ parameters
        force = sensed / self._thresholds
        low, high = -np.maximum(force, 0.0), -np.minimum(force, 0.0)
        return Rows(self._cue_matrix, low - limit - error, high + limit - error)


class SoftSolver:
    """Solves programmes of the same shape in turn, each from the solution of the one before."""

    def __init__(self, prices: Prices, iterations: int) -> None:
        """Take the prices of all rows and the most iterations of a programme."""
        self.prices, self._model, self._is_ready = prices, daqp.Model(), False
        self._model.settings = {"iter_limit": iterations}

    def limit_time(self, seconds: float) -> None:
        """Let a solution take so long and no longer [s]; 0 counts its iterations alone."""
        self._model.settings = {"time_limit": seconds}

    def solve(self, programme: dict[str, Matrix]) -> tuple[Matrix | None, int]:
        """What solves a programme, or None where the solver did not end; iterations."""
        if self._is_ready:
            flag = self._model.update(**programme)
        else:
            flag = self._set_up(programme)
            self._is_ready = flag >= 0
        if flag < 0:
            return None, 0
        z, _, flag, account = self._model.solve()
        is_solved = flag in _SOLVED and bool(np.isfinite(z).all())
        return (z if is_solved else None), int(account["iterations"])

    def _set_up(self, programme: dict[str, Matrix]) -> int:
        soft = np.full(len(programme["A"]), _SOFT, dtype=np.int32)
        flag, _ = self._model.setup(np.eye(len(programme["f"])), sense=soft, **programme)
        linear, ease = self.prices.linear, self.prices.ease
        self._model.soft_weights(w_l=linear, w_u=linear, rho_l=ease, rho_u=ease)
        return int(flag)
