"""Effects that the report neglects, as changes of a linear plant, and what such a machine shows.

With x' = A x + B c the plant of `linearize`, v, p speeds and pressures of its legs, k their full
speed, a = (A_cap, -A_rod), and motions whose leg speeds have an amplitude V,

    coulomb, viscous   dv/dt = ... - M^-1 d v,  d = 4 Fc / (pi V) of sliding legs, or given
    lap                B N(o k / V), N(r) = 1 - sgn(r) (2 / pi) (asin |r| + |r| sqrt(1 - r^2)), |r|
                       at most 1: less gain of an overlap o > 0, twice the gain within an underlap
    flow_shape         B (V / V0)^n of a flow that grows as the command^(1 + n), V0 the sweep's
    dead_time          (1 - s t / 2) / (1 + s t / 2), second_lag 1 / (1 + s t) before the drive
    velocity_filter, pressure_filter   1 / (1 + s t) behind the sensors
    compliance         legs, gimbals and floor in series with the oil, softer by a share x of its
                       spring K: of x_p = l + a p x / K the law reads, dp/dt = (1 - g a x / K)^-1
                       (...), with g what p gains of v, K = -a g
    soft_cap           x more give of the cap chambers: hoses, trapped air
    measured_mass      what was measured carried x times the mass, not what was flown
    reading_delay      t between the demand that was read and the law's

The describing functions are those of a sine. Laws are closed at the sweep's 0.33 in for bandwidths
and at 1 in for damping ratios, plants at the 1 in and 1 Hz of the fits. A friction that keeps a leg
from moving, and whatever the supply does, do not enter: closed valves pass nothing.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import control
import numpy as np
from numpy.typing import NDArray

from cmf_mj.analysis.frequency_response import line_bandwidths
from cmf_mj.analysis.linear.linear import Linear, loop_damping
from cmf_mj.analysis.linear.loop import at_frames, closed_loop, labels
from cmf_mj.analysis.linear.plants import FEEDBACK
from cmf_mj.analysis.measures import NO_OVERSHOOT, are_stable, damping_from_overshoot
from cmf_mj.analysis.modes import bound
from cmf_mj.control.law import Law
from cmf_mj.core.units import FRAME
from cmf_mj.machine.geometry import DOFS
from cmf_mj.report_2014.posterior.evidence import (
    FIELDS,
    FLOWN,
    HELD_OUT,
    ROWS,
    fit_features,
    shipped,
)
from cmf_mj.studies.engine import Row
from cmf_mj.studies.fit.evidence import LINES

Array = NDArray[np.float64]

SPEEDS = {"original": 0.063, "velocity": 0.103, HELD_OUT: 0.103, "fits": 0.133}
"""Amplitudes of leg speeds [m/s]: 0.33 in times the leg's cosine 0.832 and the gain of 0.8 at the
printed -90 deg; 1 in at 1 Hz."""

_STEP = 1.0 / 0.33  #: Speeds of a step of 1 in over those of the sweep.
_TIMES = np.arange(8, 2048, 8)  # of steps [frames]
_LEGS, _HEAVE = len(DOFS), DOFS.index("heave")
_LEAST = 0.05  # gain that is left of a valve
_INSTANT = 1e-5  # shortest lag [s]


@dataclass(frozen=True, eq=False)
class Part:
    """A linear plant that effects change: leg by leg within a kind of state or output."""

    linear: Linear  #: Without effects; their states stand behind its own.
    a: Array  #: (n, n).
    b: Array  #: From commands, (n, 6).
    c: Array  #: To `FEEDBACK`, (30, n).

    @classmethod
    def of(cls, linear: Linear) -> "Part":
        """The plant of a linearised machine."""
        a, b, c = (np.asarray(m) for m in (linear.system.A, linear.system.B, linear.system.C))
        order = [linear.system.output_labels.index(name) for name in labels(FEEDBACK, _LEGS)]
        return cls(linear, a, b, c[order])

    @property
    def areas(self) -> Array:
        """A_cap and -A_rod [m^2]."""
        cylinder = self.linear.plant.hydraulics.cylinder[0]
        return np.array([float(cylinder.cap_area), -float(cylinder.rod_area)])

    @property
    def full_speed(self) -> float:
        """Of the legs, k [m/s]."""
        return float(self.linear.plant.parameters.leg_speed.si)

    @cached_property
    def held(self) -> control.StateSpace:
        """In frames, see `at_frames`."""
        names = {"inputs": labels(("command",), _LEGS), "outputs": labels(FEEDBACK, _LEGS)}
        return at_frames(control.ss(self.a, self.b, self.c, 0.0, **names), FRAME)

    def at(self, kind: str) -> list[int]:
        """States of a kind, leg by leg."""
        return [self.linear.system.state_labels.index(name) for name in labels((kind,), _LEGS)]

    def scaled(self, kind: str, factor: float) -> "Part":
        """With the derivatives of some states times a factor."""
        a = self.a.copy()
        a[self.at(kind)] *= factor
        return replace(self, a=a)


def _damped(part: Part, damping: float) -> Part:
    a, speed = part.a.copy(), part.at("leg_velocity")
    inverse = a[np.ix_(speed, part.at("cap_pressure"))] / part.areas[0]
    a[np.ix_(speed, speed)] -= damping * inverse
    return replace(part, a=a)


def lap_gain(ratio: float) -> float:
    """N(r), the gain of a valve with lap to a sine, over that of one without."""
    size = min(abs(ratio), 1.0)
    lost = 2.0 / np.pi * (np.arcsin(size) + size * np.sqrt(1.0 - size**2))
    return float(1.0 - np.sign(ratio) * lost)


def _gain(part: Part, factor: float) -> Part:
    return replace(part, b=part.b * max(factor, _LEAST))


def _before(part: Part, time: float, direct: float) -> Part:
    """Commands behind (1 + n s) / (1 + d s), d = `time`, n / d = `direct`."""
    time, size = max(time, _INSTANT), part.a.shape[0]
    one = np.eye(_LEGS)
    a = np.block([[part.a, (1.0 - direct) * part.b], [np.zeros((_LEGS, size)), -one / time]])
    b, c = np.vstack([direct * part.b, one / time]), np.pad(part.c, ((0, 0), (0, _LEGS)))
    return replace(part, a=a, b=b, c=c)


def _behind(part: Part, kinds: tuple[str, ...], time: float) -> Part:
    """Outputs of some kinds behind 1 / (1 + s t)."""
    time = max(time, _INSTANT)
    rows = [FEEDBACK.index(kind) * _LEGS + leg for kind in kinds for leg in range(_LEGS)]
    size, more = part.a.shape[0], len(rows)
    one = np.eye(more)
    a = np.block([[part.a, np.zeros((size, more))], [part.c[rows] / time, -one / time]])
    c = np.pad(part.c, ((0, 0), (0, more)))
    c[rows] = np.hstack([np.zeros((more, size)), one])
    return replace(part, a=a, b=np.vstack([part.b, np.zeros((more, _LEGS))]), c=c)


def _in_series(part: Part, share: float) -> Part:
    a, c = part.a.copy(), part.c.copy()
    areas = part.areas
    kinds = [part.at(kind) for kind in ("leg_velocity", "cap_pressure", "rod_pressure")]
    for leg, (speed, *chambers) in enumerate(zip(*kinds, strict=True)):
        gain = a[chambers, speed]
        spring = -areas @ gain / share
        a[chambers] = np.linalg.solve(np.eye(2) - np.outer(gain, areas) / spring, a[chambers])
        c[leg, chambers] += areas / spring
        c[_LEGS + leg] += areas @ a[chambers] / spring
    return replace(part, a=a, c=c)


_Change = Callable[[Part, float, float], Part]  # of a plant, by a value and the speed V

EFFECTS: Mapping[str, _Change] = {
    "coulomb": lambda part, force, v: _damped(part, 4.0 * force / (np.pi * v)),
    "viscous": lambda part, damping, v: _damped(part, damping),
    "lap": lambda part, lap, v: _gain(part, lap_gain(lap * part.full_speed / v)),
    "flow_shape": lambda part, n, v: _gain(part, (v / SPEEDS["velocity"]) ** n),
    "dead_time": lambda part, time, v: _before(part, 0.5 * time, -1.0),
    "second_lag": lambda part, time, v: _before(part, time, 0.0),
    "velocity_filter": lambda part, time, v: _behind(part, ("leg_velocity",), time),
    "pressure_filter": lambda part, time, v: _behind(part, FEEDBACK[3:], time),
    "compliance": lambda part, share, v: _in_series(part, max(share, 1e-6)),
    "soft_cap": lambda part, more, v: part.scaled("cap_pressure", 1.0 / (1.0 + more)),
    "measured_mass": lambda part, mass, v: part.scaled("leg_velocity", 1.0 / mass),
    "reading_delay": lambda part, time, v: part,
}
"""What `effect.NAME` of an unknown does, in SI; what any other path does its plant shows."""

_BY_SPEED = {"coulomb", "lap", "flow_shape"}
NOT_FLOWN = {"measured_mass", "reading_delay"}


def changed(part: Part, effects: Mapping[str, float], speed: float) -> Part:
    """A plant with effects, by name and value in SI."""
    for name, value in effects.items():
        part = EFFECTS[name](part, value, speed)
    return part


def read(part: Part, law: Law, delay: float = 0.0) -> Row:
    """What a sweep and a step in heave show under a law, the demand read so much earlier [s].

    `FIELDS` by name, all from the loop's poles; NaN of one that is unstable.
    """
    loop, jacobian = closed_loop(law, part.held), part.linear.jacobian
    poles, right = np.linalg.eig(loop.A)
    if not are_stable(poles):
        return dict.fromkeys(FIELDS, float("nan"))
    entry = np.linalg.solve(right, (loop.B @ jacobian[:, _HEAVE]).astype(complex))
    residue = (np.linalg.inv(jacobian)[_HEAVE] @ loop.C @ right) * entry
    z = np.exp(2j * np.pi * FRAME * LINES)
    response = (residue / (z[:, None] - poles)).sum(axis=1)
    widths = line_bandwidths(LINES, response * np.exp(-2j * np.pi * delay * LINES))
    each = residue / (1.0 - poles)
    moved = (1.0 - poles ** _TIMES[:, None]) @ each
    over = float(moved.real.max() / each.sum().real - 1.0)
    zeta = damping_from_overshoot(over if over >= NO_OVERSHOOT else 0.0)
    return dict(zip(FIELDS, (widths.phase_hz, widths.gain_hz, zeta), strict=True))


def shown(machines: Mapping[str, Linear], effects: Mapping[str, float]) -> Row:
    """What a machine with effects makes of all observations, and whether it can be flown.

    `machines` are its linear plants by cab, the first the one that was measured.
    """
    first, *others = machines.values()
    moving, row = bool(_BY_SPEED & effects.keys()), Row()
    still = changed(Part.of(first), effects, SPEEDS["fits"])

    def at(speed: float) -> Part:
        return changed(Part.of(first), effects, speed) if moving else still

    for name in (*(law for _, law in ROWS), HELD_OUT):
        law = shipped(name)
        sweep = read(at(SPEEDS[name]), law, effects.get("reading_delay", 0.0))
        step = read(at(_STEP * SPEEDS[name]), law) if moving else sweep
        sweep["damping_ratio"] = step["damping_ratio"]
        row |= {f"{name}_{field}": value for field, value in sweep.items()}
    jacobian = first.jacobian
    heave = np.linalg.inv(jacobian)[[_HEAVE]] @ still.c[_LEGS : 2 * _LEGS]
    row |= fit_features(control.ss(still.a, still.b @ jacobian[:, [_HEAVE]], heave, 0.0))
    flights = (closed_loop(shipped(FLOWN), carried(one, effects)) for one in (*others[::-1], first))
    return row | {"flown": all(are_stable(one.poles()) for one in flights)}


def carried(linear: Linear, effects: Mapping[str, float]) -> control.StateSpace:
    """A machine with effects as it flies, in frames."""
    flown = {name: value for name, value in effects.items() if name not in NOT_FLOWN}
    return changed(Part.of(linear), flown, SPEEDS[FLOWN]).held


def damping(linear: Linear, effects: Mapping[str, float], law: Law) -> dict[str, float]:
    """Damping ratios of a machine with effects under a law, see `loop_damping`."""
    loop = closed_loop(bound(law, linear.plant), carried(linear, effects))
    b, c = loop.B @ linear.jacobian, np.linalg.inv(linear.jacobian) @ loop.C
    return loop_damping(control.ss(loop.A, b, c, 0.0, law.frame))
