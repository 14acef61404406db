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
from functools import cached_property, lru_cache
from typing import NamedTuple

import control
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from cmf_mj.analysis.frequency_response import line_bandwidths
from cmf_mj.analysis.linear.linear import Linear, loop_damping
from cmf_mj.analysis.linear.loop import dcl_state_space, labels
from cmf_mj.analysis.linear.plants import FEEDBACK
from cmf_mj.analysis.measures import NO_OVERSHOOT, are_stable, damping_from_overshoot
from cmf_mj.analysis.modes import bound
from cmf_mj.control.law import Law, load_law
from cmf_mj.core.units import FRAME
from cmf_mj.machine.geometry import DOFS
from cmf_mj.report_2014.posterior.evidence import FLOWN, HELD_OUT, ROWS, fit_features
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

    a: Array  #: (n, n).
    b: Array  #: From commands, (n, 6).
    c: Array  #: To `FEEDBACK`, (30, n).
    states: tuple[str, ...]
    areas: tuple[float, float]  #: Of cap and rod [m^2].
    full_speed: float  #: k [m/s].

    @classmethod
    def of(cls, linear: Linear) -> "Part":
        """The plant of a linearised machine."""
        system, cylinder = linear.system, linear.plant.hydraulics.cylinder[0]
        a, b, c = (np.asarray(m) for m in (system.A, system.B, system.C))
        order = [system.output_labels.index(name) for name in labels(FEEDBACK, _LEGS)]
        areas = float(cylinder.cap_area), float(cylinder.rod_area)
        full = float(linear.plant.parameters.leg_speed.si)
        return cls(a, b, c[order], tuple(system.state_labels), areas, full)

    @cached_property
    def held(self) -> Array:
        """From states and commands to the states a frame later, (n, n + 6)."""
        size = self.a.shape[0]
        rows = np.block([[self.a, self.b], [np.zeros((_LEGS, size + _LEGS))]])
        return np.asarray(expm(FRAME * rows)[:size])

    def at(self, kind: str) -> list[int]:
        """States of a kind, leg by leg."""
        return [self.states.index(name) for name in labels((kind,), _LEGS)]

    def scaled(self, kinds: tuple[str, ...], factor: float) -> "Part":
        """With the derivatives of some states times a factor."""
        a = self.a.copy()
        for kind in kinds:
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
    areas = np.array([part.areas[0], -part.areas[1]])
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
    "soft_cap": lambda part, more, v: part.scaled(("cap_pressure",), 1.0 / (1.0 + more)),
    "measured_mass": lambda part, mass, v: part.scaled(("leg_velocity",), 1.0 / mass),
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


def _matrices(law: Law) -> tuple[Array, ...]:
    system = dcl_state_space(law, _LEGS)
    return tuple(np.asarray(m) for m in (system.A, system.B, system.C, system.D))


@lru_cache(maxsize=16)
def _dcl(law: str) -> tuple[Array, ...]:
    return _matrices(load_law(law))


def close(part: Part, law: str | Law) -> tuple[Array, Array, Array]:
    """A, B and C of the legs' loop with a law, in frames, as `linear.loop.closed_loop`."""
    ak, bk, ck, dk = _dcl(law) if isinstance(law, str) else _matrices(law)
    size, order = part.a.shape[0], ak.shape[0]
    none = np.zeros((_LEGS, _LEGS))
    a = np.block(
        [
            [part.held, np.zeros((size, order))],
            [dk[:, _LEGS:] @ part.c, none, ck],
            [bk[:, _LEGS:] @ part.c, np.zeros((order, _LEGS)), ak],
        ]
    )
    b = np.vstack([np.zeros((size, _LEGS)), dk[:, :_LEGS], bk[:, :_LEGS]])
    return a, b, np.hstack([part.c[:_LEGS], np.zeros((_LEGS, _LEGS + order))])


def _poles(part: Part, law: str) -> NDArray[np.complex128]:
    return np.asarray(np.linalg.eigvals(close(part, law)[0]), dtype=np.complex128)


class Reading(NamedTuple):
    """What a sweep and a step in heave show of a loop; NaN of one that is unstable."""

    phase_bandwidth_hz: float
    gain_bandwidth_hz: float
    damping_ratio: float


def read(part: Part, law: str, jacobian: Array, delay: float = 0.0) -> Reading:
    """Of a plant under a law, the demand read so much earlier [s]: all from the loop's poles."""
    a, b, c = close(part, law)
    poles, right = np.linalg.eig(a)
    if not are_stable(poles):
        return Reading(*[float("nan")] * 3)
    entry = np.linalg.solve(right, (b @ jacobian[:, _HEAVE]).astype(complex))
    residue = (np.linalg.inv(jacobian)[_HEAVE] @ c @ right) * entry
    z = np.exp(2j * np.pi * FRAME * LINES)
    response = (residue / (z[:, None] - poles)).sum(axis=1)
    widths = line_bandwidths(LINES, response * np.exp(-2j * np.pi * delay * LINES))
    each = residue / (1.0 - poles)
    moved = (1.0 - poles ** _TIMES[:, None]) @ each
    over = float(moved.real.max() / each.sum().real - 1.0)
    zeta = damping_from_overshoot(over if over >= NO_OVERSHOOT else 0.0)
    return Reading(widths.phase_hz, widths.gain_hz, zeta)


def shown(machines: Mapping[str, Linear], effects: Mapping[str, float]) -> Row:
    """What a machine with effects makes of all observations, and whether it can be flown.

    `machines` are its linear plants by cab, the first the one that was measured.
    """
    first, *others = machines.values()
    jacobian, moving, row = first.jacobian, bool(_BY_SPEED & effects.keys()), Row()
    still = changed(Part.of(first), effects, SPEEDS["fits"])

    def at(speed: float) -> Part:
        return changed(Part.of(first), effects, speed) if moving else still

    for law in (*(law for _, law in ROWS), HELD_OUT):
        sweep = read(at(SPEEDS[law]), law, jacobian, effects.get("reading_delay", 0.0))
        step = read(at(_STEP * SPEEDS[law]), law, jacobian) if moving else sweep
        row |= {f"{law}_{name}": value for name, value in sweep._asdict().items()}
        row[f"{law}_damping_ratio"] = step.damping_ratio
    heave = np.linalg.inv(jacobian)[[_HEAVE]] @ still.c[_LEGS : 2 * _LEGS]
    row |= fit_features(control.ss(still.a, still.b @ jacobian[:, [_HEAVE]], heave, 0.0))
    flown = {name: value for name, value in effects.items() if name not in NOT_FLOWN}
    own = still if not moving and flown == effects else None
    parts = ((one, None) for one in others[::-1])
    return row | {
        "flown": all(
            are_stable(_poles(part or carried(one, flown), FLOWN))
            for one, part in (*parts, (first, own))
        )
    }


def carried(linear: Linear, effects: Mapping[str, float]) -> Part:
    """A machine with effects as it flies."""
    return changed(Part.of(linear), effects, SPEEDS[FLOWN])


def damping(linear: Linear, effects: Mapping[str, float], law: Law) -> dict[str, float]:
    """Damping ratios of a machine with effects under a law, see `loop_damping`."""
    flown = {name: value for name, value in effects.items() if name not in NOT_FLOWN}
    a, b, c = close(carried(linear, flown), bound(law, linear.plant))
    jacobian = linear.jacobian
    return loop_damping(control.ss(a, b @ jacobian, np.linalg.inv(jacobian) @ c, 0.0, law.frame))
