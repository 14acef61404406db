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

import control
import numpy as np
from numpy.typing import NDArray

from cmf_mj.analysis.frequency_response import line_bandwidths
from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.analysis.linear.loop import at_frames, closed_loop, labels
from cmf_mj.analysis.linear.plants import FEEDBACK
from cmf_mj.analysis.linear.poles import are_stable, loop_damping
from cmf_mj.analysis.modes import bound
from cmf_mj.analysis.step_response import NO_OVERSHOOT, damping_from_overshoot
from cmf_mj.control.law import Law, load_law
from cmf_mj.core.units import FRAME
from cmf_mj.machine.geometry import DOFS
from cmf_mj.report_2014.posterior.evidence import HELD_OUT_LAW, ROW_FIELDS, ROW_TABLES, fit_features
from cmf_mj.studies.engine import Row
from cmf_mj.studies.fit.evidence import LINES

Array = NDArray[np.float64]

shipped_law = lru_cache(load_law)
"""Laws by name, each read once."""

FLOWN_LAW = "velocity"
"""Law that must be stable with all cabs."""

SPEEDS = {"original": 0.063, "velocity": 0.103, HELD_OUT_LAW: 0.103, "fits": 0.133}
"""Amplitudes of leg speeds [m/s]: 0.33 in times the leg's cosine 0.832 and the gain of 0.8 at the
printed -90 deg; 1 in at 1 Hz."""

_STEP_SPEED_RATIO = 1.0 / 0.33  #: Leg speeds in a step of 1 in over those of the sweep.
_STEP_FRAMES = np.arange(8, 2048, 8)  #: Frames after a step at which its response is computed.
_LEGS, _HEAVE = len(DOFS), DOFS.index("heave")
_PRESSURES = ("cap_pressure", "rod_pressure")
_LEAST_GAIN = 0.05  #: Gain that every valve keeps.
_SHORTEST_LAG = 1e-5  #: [s].


@dataclass(frozen=True, eq=False)
class LinearPlant:
    """A linear plant that effects change: leg by leg within a kind of state or output."""

    linear: Linear  #: Without effects; states that effects add stand behind its own.
    a: Array  #: (n, n).
    b: Array  #: From commands, (n, 6).
    c: Array  #: To `FEEDBACK`, (30, n).

    @classmethod
    def of(cls, linear: Linear) -> "LinearPlant":
        """The plant of a linearised machine."""
        system = linear.system
        rows = [system.output_labels.index(label) for label in labels(FEEDBACK, _LEGS)]
        return cls(linear, np.asarray(system.A), np.asarray(system.B), np.asarray(system.C)[rows])

    @property
    def areas(self) -> Array:
        """A_cap and -A_rod [m^2]."""
        cylinder = self.linear.plant.hydraulics.cylinder[0]
        return np.array([float(cylinder.cap_area), -float(cylinder.rod_area)])

    @property
    def full_speed(self) -> float:
        """Speed of a leg at full command, k [m/s]."""
        return float(self.linear.plant.parameters.leg_speed.si)

    @cached_property
    def in_frames(self) -> control.StateSpace:
        """The plant at the control frames, see `at_frames`."""
        names = {"inputs": labels(("command",), _LEGS), "outputs": labels(FEEDBACK, _LEGS)}
        return at_frames(control.ss(self.a, self.b, self.c, 0.0, **names), FRAME)

    def states(self, kind: str) -> list[int]:
        """Indices of the states of a kind, leg by leg."""
        return [self.linear.system.state_labels.index(label) for label in labels((kind,), _LEGS)]

    def outputs(self, kind: str) -> list[int]:
        """Indices of the outputs of a kind, leg by leg."""
        return [FEEDBACK.index(kind) * _LEGS + leg for leg in range(_LEGS)]

    def scaled(self, kind: str, factor: float) -> "LinearPlant":
        """The plant with the derivatives of a kind of state times a factor."""
        a = self.a.copy()
        a[self.states(kind)] *= factor
        return replace(self, a=a)


def _with_damping(plant: LinearPlant, damping: float) -> LinearPlant:
    a, speeds = plant.a.copy(), plant.states("leg_velocity")
    inverse_mass = a[np.ix_(speeds, plant.states("cap_pressure"))] / plant.areas[0]
    a[np.ix_(speeds, speeds)] -= damping * inverse_mass
    return replace(plant, a=a)


def lap_gain(ratio: float) -> float:
    """N(r), the gain of a valve with lap to a sine, over that of one without."""
    size = min(abs(ratio), 1.0)
    lost = 2.0 / np.pi * (np.arcsin(size) + size * np.sqrt(1.0 - size**2))
    return float(1.0 - np.sign(ratio) * lost)


def _with_valve_gain(plant: LinearPlant, factor: float) -> LinearPlant:
    return replace(plant, b=plant.b * max(factor, _LEAST_GAIN))


def _with_command_lag(plant: LinearPlant, time: float, direct: float) -> LinearPlant:
    """Commands behind (1 + n s) / (1 + d s), d = `time`, n / d = `direct`."""
    lag, size, identity = max(time, _SHORTEST_LAG), plant.a.shape[0], np.eye(_LEGS)
    a = np.block([[plant.a, (1.0 - direct) * plant.b], [np.zeros((_LEGS, size)), -identity / lag]])
    b = np.vstack([direct * plant.b, identity / lag])
    return replace(plant, a=a, b=b, c=np.pad(plant.c, ((0, 0), (0, _LEGS))))


def _with_sensor_lag(plant: LinearPlant, kinds: tuple[str, ...], time: float) -> LinearPlant:
    """Outputs of some kinds behind 1 / (1 + s t)."""
    lag = max(time, _SHORTEST_LAG)
    rows = [row for kind in kinds for row in plant.outputs(kind)]
    size, added = plant.a.shape[0], len(rows)
    identity = np.eye(added)
    a = np.block([[plant.a, np.zeros((size, added))], [plant.c[rows] / lag, -identity / lag]])
    c = np.pad(plant.c, ((0, 0), (0, added)))
    c[rows] = np.hstack([np.zeros((added, size)), identity])
    return replace(plant, a=a, b=np.vstack([plant.b, np.zeros((added, _LEGS))]), c=c)


def _with_compliance(plant: LinearPlant, share: float) -> LinearPlant:
    a, c, areas = plant.a.copy(), plant.c.copy(), plant.areas
    speeds = plant.states("leg_velocity")
    chambers = np.transpose([plant.states("cap_pressure"), plant.states("rod_pressure")])
    positions, velocities = plant.outputs("leg_position"), plant.outputs("leg_velocity")
    for leg, pressures in enumerate(chambers):
        gain = a[pressures, speeds[leg]]
        spring = -areas @ gain / share
        softening = np.eye(2) - np.outer(gain, areas) / spring
        a[pressures] = np.linalg.solve(softening, a[pressures])
        c[positions[leg], pressures] += areas / spring
        c[velocities[leg]] += areas @ a[pressures] / spring
    return replace(plant, a=a, c=c)


_Change = Callable[[LinearPlant, float, float], LinearPlant]  # by a value and the speed V

EFFECTS: Mapping[str, _Change] = {
    "coulomb": lambda plant, force, v: _with_damping(plant, 4.0 * force / (np.pi * v)),
    "viscous": lambda plant, damping, v: _with_damping(plant, damping),
    "lap": lambda plant, lap, v: _with_valve_gain(plant, lap_gain(lap * plant.full_speed / v)),
    "flow_shape": lambda plant, n, v: _with_valve_gain(plant, (v / SPEEDS["velocity"]) ** n),
    "dead_time": lambda plant, time, v: _with_command_lag(plant, 0.5 * time, -1.0),
    "second_lag": lambda plant, time, v: _with_command_lag(plant, time, 0.0),
    "velocity_filter": lambda plant, time, v: _with_sensor_lag(plant, ("leg_velocity",), time),
    "pressure_filter": lambda plant, time, v: _with_sensor_lag(plant, _PRESSURES, time),
    "compliance": lambda plant, share, v: _with_compliance(plant, max(share, 1e-6)),
    "soft_cap": lambda plant, give, v: plant.scaled("cap_pressure", 1.0 / (1.0 + give)),
    "measured_mass": lambda plant, mass, v: plant.scaled("leg_velocity", 1.0 / mass),
    "reading_delay": lambda plant, time, v: plant,
}
"""How each `effect.NAME` of an unknown, in SI, changes a plant whose legs move at V."""

_SPEED_DEPENDENT = {"coulomb", "lap", "flow_shape"}
NOT_FLOWN = {"measured_mass", "reading_delay"}


def with_effects(plant: LinearPlant, effects: Mapping[str, float], speed: float) -> LinearPlant:
    """A plant with effects, by name and value in SI."""
    for name, value in effects.items():
        plant = EFFECTS[name](plant, value, speed)
    return plant


def heave_measures(plant: LinearPlant, law: Law, delay: float = 0.0) -> dict[str, float]:
    """`ROW_FIELDS` by name of a sweep and a step in heave under a law.

    The demand is read `delay` [s] before the law receives it. All come from the loop's poles; they
    are NaN where the loop is unstable.
    """
    loop, jacobian = closed_loop(law, plant.in_frames), plant.linear.jacobian
    poles, right = np.linalg.eig(loop.A)
    if not are_stable(poles):
        return dict.fromkeys(ROW_FIELDS, float("nan"))
    entry = np.linalg.solve(right, (loop.B @ jacobian[:, _HEAVE]).astype(complex))
    residue = (np.linalg.inv(jacobian)[_HEAVE] @ loop.C @ right) * entry
    z = np.exp(2j * np.pi * FRAME * LINES)
    response = (residue / (z[:, None] - poles)).sum(axis=1)
    widths = line_bandwidths(LINES, response * np.exp(-2j * np.pi * delay * LINES))
    final = residue / (1.0 - poles)
    step = (1.0 - poles ** _STEP_FRAMES[:, None]) @ final
    overshoot = float(step.real.max() / final.sum().real - 1.0)
    return {
        "phase_bandwidth_hz": widths.phase_hz,
        "gain_bandwidth_hz": widths.gain_hz,
        "damping_ratio": damping_from_overshoot(overshoot if overshoot >= NO_OVERSHOOT else 0.0),
    }


def predictions(machines: Mapping[str, Linear], effects: Mapping[str, float]) -> Row:
    """What a machine with effects makes of all observations, and whether it can be flown.

    `machines` are its linear plants by cab, the first the one that was measured.
    """
    measured, *others = machines.values()
    is_speed_dependent = bool(_SPEED_DEPENDENT & effects.keys())
    fitted = with_effects(LinearPlant.of(measured), effects, SPEEDS["fits"])

    def plant_at(speed: float) -> LinearPlant:
        if not is_speed_dependent:
            return fitted
        return with_effects(LinearPlant.of(measured), effects, speed)

    row = Row()
    for name in (*ROW_TABLES, HELD_OUT_LAW):
        law, speed = shipped_law(name), SPEEDS[name]
        measures = heave_measures(plant_at(speed), law, effects.get("reading_delay", 0.0))
        if is_speed_dependent:
            step = heave_measures(plant_at(_STEP_SPEED_RATIO * speed), law)
            measures["damping_ratio"] = step["damping_ratio"]
        row |= {f"{name}_{field}": value for field, value in measures.items()}
    jacobian = measured.jacobian
    heave_command = jacobian[:, [_HEAVE]]
    heave_rate = np.linalg.inv(jacobian)[[_HEAVE]] @ fitted.c[fitted.outputs("leg_velocity")]
    row |= fit_features(control.ss(fitted.a, fitted.b @ heave_command, heave_rate, 0.0))
    flights = (
        closed_loop(shipped_law(FLOWN_LAW), flown_plant(machine, effects))
        for machine in (*reversed(others), measured)
    )
    return row | {"flown": all(are_stable(loop.poles()) for loop in flights)}


def flown_plant(linear: Linear, effects: Mapping[str, float]) -> control.StateSpace:
    """A machine with effects as it flies, in frames."""
    flown = {name: value for name, value in effects.items() if name not in NOT_FLOWN}
    return with_effects(LinearPlant.of(linear), flown, SPEEDS[FLOWN_LAW]).in_frames


def damping(linear: Linear, effects: Mapping[str, float], law: Law) -> dict[str, float]:
    """Damping ratios of a machine with effects under a law, see `loop_damping`."""
    loop = closed_loop(bound(law, linear.plant), flown_plant(linear, effects))
    b, c = loop.B @ linear.jacobian, np.linalg.inv(linear.jacobian) @ loop.C
    return loop_damping(control.ss(loop.A, b, c, 0.0, law.frame))
