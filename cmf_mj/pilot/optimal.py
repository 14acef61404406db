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

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import control
import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from cmf_mj.core.compiled import allocating
from cmf_mj.core.filters import discretise
from cmf_mj.core.settings import Settings
from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.pilot.classical import Filter, HeadMotion, Matrices, Sample, push_sample
from cmf_mj.pilot.perception import canal_response, load_senses, otolith_response, state_space
from cmf_mj.pilot.washout_settings import OptimalSettings

Matrix = NDArray[np.float64]

_FIRST_INPUT = {"rate": 0, "force": 3}
"""Of each axis' inputs among Euler rates (3) and specific force (3)."""
_FIRST_OUTPUTS = {
    "rate": {"angle": 0, "rate": 3},
    "force": {"position": 9, "velocity": 12, "acceleration": 15},
}
"""Of what an input moves among angles (9) and displacements (9) with two derivatives."""


class ModeLayout(NamedTuple):
    """What a mode moves, and the order of its signals, by the names of their sizes."""

    axes: dict[str, int]  #: Axis, 0 to 2, of each input of v: a rate about it, a force along it.
    states: tuple[str, ...]  #: Of x_d.
    efforts: tuple[str, ...]  #: Of u.
    tilt: float = 0.0  #: Specific force per angle [m/s^2/rad].

    @property
    def input_columns(self) -> list[int]:
        """Where its inputs are among Euler rates (3) and specific force (3)."""
        return [_FIRST_INPUT[signal] + axis for signal, axis in self.axes.items()]

    @property
    def output_rows(self) -> dict[str, int]:
        """Where its motion is among the outputs of `Optimal.filter`, by name."""
        return {
            name: first + axis
            for signal, axis in self.axes.items()
            for name, first in _FIRST_OUTPUTS[signal].items()
        }

    def motion(self, states: Matrix, efforts: Matrix, slopes: Matrix) -> dict[int, list[Matrix]]:
        """Displacement and angle by degree of freedom with two derivatives, of x, u and du/dt."""
        rows, motion = {name: -row for row, name in enumerate(self.states[::-1], 1)}, {}
        if "force" in self.axes:
            acceleration = efforts[self.efforts.index("acceleration")]
            displacement = [states[rows["position"]], states[rows["velocity"]]]
            motion[self.axes["force"]] = [*displacement, acceleration]
        if "rate" in self.axes:
            rate = self.efforts.index("rate")
            motion[3 + self.axes["rate"]] = [states[rows["angle"]], efforts[rate], slopes[rate]]
        return motion


_TRAVEL = ("position_integral", "position", "velocity")
_TILTING = ((*_TRAVEL, "angle"), ("rate", "acceleration"))
LAYOUTS = {
    "pitch_surge": ModeLayout({"rate": 1, "force": 0}, *_TILTING, tilt=STANDARD_GRAVITY),
    "roll_sway": ModeLayout({"rate": 0, "force": 1}, *_TILTING, tilt=-STANDARD_GRAVITY),
    "yaw": ModeLayout({"rate": 2}, ("angle_integral", "angle"), ("rate",)),
    "heave": ModeLayout({"force": 2}, _TRAVEL, ("acceleration",)),
}
"""All modes by name."""

_DERIVATIVES = {
    "position_integral": "position",
    "position": "velocity",
    "velocity": "acceleration",
    "angle_integral": "angle",
    "angle": "rate",
}
"""Derivative of each state of x_d, a state or an effort."""


class QuadraticCost(NamedTuple):
    """x Q x + 2 x N u + u R u."""

    states: Matrix  #: Q.
    cross: Matrix  #: N.
    efforts: Matrix  #: R.


class WashoutMode(NamedTuple):
    """A linear-quadratic problem and its solution."""

    layout: ModeLayout
    plant: tuple[Matrix, Matrix]  #: A, B of dx/dt = A x + B u with x = (x_v, x_d, x_n).
    cost: QuadraticCost
    riccati: Matrix  #: P of the algebraic Riccati equation.
    feedback: Matrix  #: F of u = -F x.
    filter: Matrices  #: From the aircraft's inputs to the simulator's motion; states (x_v, x_d).
    sensed: Matrix  #: e of x, less what u adds at once, (rate and force, n).


class Optimal(NamedTuple):
    """The algorithm at work; its arrays are overwritten by each sample."""

    filter: Filter
    """Euler rates (3), specific force less that of level rest (3) and slopes of the Euler rates
    and the force (6) to angles and displacements with two derivatives (18)."""
    interval: float  #: T [s].

    def start(self, sample: Sample, head: HeadMotion) -> None:
        """As `Classical.start`."""
        self.filter.start(np.concatenate([sample.inputs, np.zeros(6)]))
        self.move(sample, head)

    def move(self, sample: Sample, head: HeadMotion) -> None:
        """As `Classical.move`."""
        _move(self, sample, head)


def _selection(names: Iterable[str], signals: Sequence[str]) -> Matrix:
    """Rows that choose signals by name; zeros for a name that is none of these signals."""
    return np.array([[float(name == signal) for signal in signals] for name in names])


def _sizes(settings: Settings, names: Iterable[str], ending: str = "") -> list[float]:
    """Sizes in SI by their names in the settings, which may have an ending."""
    return [getattr(settings, name + ending).si for name in names]


def _weight(settings: Settings, names: Iterable[str], ending: str = "") -> Matrix:
    """Diagonal weight of signals that cost one at their sizes (Bryson's rule)."""
    return np.diag(1.0 / np.square(_sizes(settings, names, ending)))


def _solve_mode(layout: ModeLayout, settings: Settings, senses: control.StateSpace) -> WashoutMode:
    """Solve one mode; `senses` lead from v to what is sensed."""
    av, bv, cv, dv = control.ssdata(senses)
    derivatives = [_DERIVATIVES[state] for state in layout.states]
    ad, bd = (_selection(derivatives, signals) for signals in (layout.states, layout.efforts))
    corners = _sizes(settings, layout.axes, "_bandwidth")
    nv, nd, nn = len(av), len(ad), len(corners)
    # v_S = S u + G x_d: tilt adds to the specific force.
    gravity = np.zeros((nn, nd))
    gravity[-1, -1] = layout.tilt
    a = linalg.block_diag(av, ad, -np.diag(corners))
    a[:nv, nv:] = np.hstack([bv @ gravity, -bv])
    b = np.vstack([bv, bd, np.zeros((nn, nn))])

    error_weight = _weight(settings, layout.axes, "_error")
    sensed = np.hstack([cv, dv @ gravity, -dv])
    q = sensed.T @ error_weight @ sensed
    q = 0.5 * (q + q.T)
    q[nv : nv + nd, nv : nv + nd] += _weight(settings, layout.states)
    efforts = _weight(settings, layout.efforts) + dv.T @ error_weight @ dv
    cost = QuadraticCost(q, sensed.T @ error_weight @ dv, efforts)

    riccati = linalg.solve_continuous_are(a, b, cost.states, cost.efforts, s=cost.cross)
    feedback = linalg.solve(cost.efforts, b.T @ riccati + cost.cross.T, assume_a="pos")
    filtering = _closed_filter(layout, (a, b), feedback)
    return WashoutMode(layout, (a, b), cost, riccati, feedback, filtering, sensed)


def _closed_filter(layout: ModeLayout, plant: tuple[Matrix, Matrix], feedback: Matrix) -> Matrices:
    """The filter from the aircraft's inputs to the motion of a mode under its feedback."""
    a, b = plant
    states = slice(len(a) - len(layout.axes))
    aircraft = slice(states.stop, None)
    effort_outputs = _selection(layout.output_rows, layout.efforts)
    state_outputs = _selection(layout.output_rows, layout.states)
    sense_outputs = np.zeros((len(state_outputs), states.stop - len(layout.states)))
    return Matrices(
        a[states, states] - b[states] @ feedback[:, states],
        a[states, aircraft] - b[states] @ feedback[:, aircraft],
        np.hstack([sense_outputs, state_outputs]) - effort_outputs @ feedback[:, states],
        -effort_outputs @ feedback[:, aircraft],
    )


def washout_modes(settings: OptimalSettings) -> dict[str, WashoutMode]:
    """All modes of `LAYOUTS`, solved.

    Inputs of a filter are Euler rate and specific force, outputs angle, its rate, displacement,
    velocity and acceleration, as far as the mode has them.
    """
    senses = load_senses()
    proper = {"lead": senses.canals.lead.model_copy(update={"value": 0.0})}
    systems = {
        "rate": state_space(canal_response(senses.canals.model_copy(update=proper))),
        "force": state_space(otolith_response(senses.otoliths)),
    }
    return {
        name: _solve_mode(
            layout,
            getattr(settings, name),
            control.append(*(systems[signal] for signal in layout.axes)),
        )
        for name, layout in LAYOUTS.items()
    }


def make_optimal(settings: OptimalSettings, interval: float) -> Optimal:
    """The algorithm at samples `interval` [s] apart; `start` begins."""
    modes = washout_modes(settings).values()
    a = linalg.block_diag(*(mode.filter.a for mode in modes))
    b, c, d = np.zeros((len(a), 12)), np.zeros((18, len(a))), np.zeros((18, 12))
    begin = 0
    for mode in modes:
        inputs, rows = np.array(mode.layout.input_columns), mode.layout.output_rows
        states = slice(begin, begin + len(mode.filter.a))
        begin = states.stop
        outputs = np.array(list(rows.values()))
        b[states, inputs] = mode.filter.b
        c[outputs, states] = mode.filter.c
        d[np.ix_(outputs, inputs)] = mode.filter.d
        # Angular acceleration is the derivative of the rate, an output with direct feed-through.
        if "rate" in rows:
            rate, acceleration = list(rows).index("rate"), rows["rate"] + 3
            c[acceleration, states] = mode.filter.c[rate] @ mode.filter.a
            d[acceleration, inputs] = mode.filter.c[rate] @ mode.filter.b
            d[acceleration, inputs + 6] = mode.filter.d[rate]
    return Optimal(Filter.of(discretise(a, b, c, d, interval)), interval)


@allocating
def _move(optimal, sample, head):  # type: ignore[no-untyped-def]
    inputs, motion = np.empty(12), np.empty(18)
    force, last_force = inputs[3:6], optimal.filter.inputs[3:6]
    inputs[:3], force[:], inputs[6:9] = sample.euler_rates, sample.force, sample.slopes
    force[2] += STANDARD_GRAVITY
    inputs[9:] = (force - last_force) / optimal.interval
    push_sample(optimal.filter, inputs, motion)
    head.angular[:] = motion[:9].reshape(3, 3)
    head.linear[:] = motion[9:].reshape(3, 3)
