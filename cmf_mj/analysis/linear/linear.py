"""A plant linearised once at a pose, and all that is asked of it: loops, damping, stiffness.

A pole of a loop counts in a degree of freedom where its residue |c_i v| |w b_i| in the response
from that demand to that motion is at least `SHARE` of the largest. The damping ratio of a degree of
freedom is the least of the poles that count in it, between `DAMPED`. The *pair* are the least
damped poles in which the heavy modes of sway with roll and of surge with pitch lie, below
`PAIR_HZ`.

With x' = A x + B u + B_f F, in which a force F that extends a leg enters where pressure times area
does, and the law's loop closed in frames, the legs move by

    l = C (z 1 - A_loop)^-1 B_F F,    z = e^(j w T),

F held over a frame, which costs (w T)^2 / 24 of its size. A wrench W on the platform is J^-T W at
the legs, and x = J^-1 l. What a law takes off that motion is its disturbance rejection,

    |S| = |x / W| under the law over |x / W| with the valves shut,

for one leg the sensitivity 1 / (1 + loop gain). Bandwidth and peak of it are the DRB and DRP of
rotorcraft flight control: where |S| first rises through -3 dB, and the most it rises to.

Margins are of the loop broken at the valve commands, which all that a law feeds back passes, along
one axis at a time, the others closed. With the law's commands c = G d of those at the valves, J_i
a column of J and j_i that row of J^-1, -L = j_i c where d = J_i u + (1 - J_i j_i) c.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from functools import cached_property

import control
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import cont2discrete

from cmf_mj.analysis.frequency_response import bandwidths, falls
from cmf_mj.analysis.linear.assembly import linearize
from cmf_mj.analysis.linear.loop import STEP_DURATION, at_frames, closed_loop, labels
from cmf_mj.analysis.linear.operating_point import operating_point
from cmf_mj.analysis.linear.plants import FEEDBACK
from cmf_mj.analysis.linear.poles import Mode, leg_model, modes, reduced
from cmf_mj.analysis.linear.ports import Excitation
from cmf_mj.analysis.measures import (
    Measures,
    are_stable,
    least_damped_mode,
    measure_step,
    measures_from,
    oscillations,
)
from cmf_mj.analysis.modes import bound
from cmf_mj.control.law import Gains, Law, load_law
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.machine.geometry import DOFS, dof_index
from cmf_mj.machine.kinematics import pose_jacobian
from cmf_mj.plant.cylinder import Contact
from cmf_mj.plant.plant import Plant

Array = NDArray[np.float64]

SHARE = 0.003  #: Residue over the largest from which on a pole counts in a degree of freedom.

DAMPED = (0.5, 50.0)  #: Poles whose damping is looked at [Hz].

PAIR_HZ = 8.0  #: Below this, the least damped poles are the pair [Hz].

BAND = (0.1, 10.0)  #: Frequencies of responses [Hz].

FREQUENCIES = np.geomspace(*BAND, 120)  #: Lines of responses [Hz], next to those of their poles.

STIFF = (0.5, 5.0)  #: Frequencies between which the least dynamic stiffness counts [Hz].

LINES = 0.05 * 10.0 ** (np.arange(105) / 40.0)
"""Lines the rejection is read from, 40 a decade, 0.05 to 19.9 Hz, the ends of `STIFF` too."""

_MARGINS = np.geomspace(0.05, 500.0, 2000)  # lines that margins are read from [Hz]
_BLOCK = 64  #: Frames between the states that a step response goes through.
_SHUT = Law(name="shut", title="Valves shut", direct_gain=Gains())
_ENDLESS = 1e6  # times the least dynamic stiffness: round-off of no motion


class Linear:
    """A plant at rest in a pose, linearised once for any number of laws.

    A law in hydraulic modes is bound to the plant; no clamp of a law acts.

    >>> linear = cmf_mj.Linear(cmf_mj.Hexapod("gfd"))
    >>> round(linear.damping("velocity")["pair"], 2)
    0.13
    """

    def __init__(
        self,
        plant: Plant,
        pose: ArrayLike | None = None,
        *,
        excitation: Excitation = "noise",
        friction: Contact | None = None,
    ) -> None:
        """Linearise a plant in a pose, default neutral, as `linearize` does and with its errors.

        `excitation` is what moves the valves, `noise`, `sine` or `mean`; `friction` how dry
        friction enters, `none`, `stuck` or the speed amplitude of sliding legs [m/s].
        """
        self.plant, self.pose, self.friction = plant, pose, friction
        self.point = operating_point(plant, pose, excitation=excitation, friction=friction)
        self.system = linearize(plant, at=self.point)
        self._sampled: dict[float, control.StateSpace] = {}

    @cached_property
    def jacobian(self) -> Array:
        """d(legs)/d(pose), (6, 6), of a plant with the legs of the facility."""
        if self.plant.legs != len(DOFS):
            raise InputError(
                f"plant: has {self.plant.legs} legs; degrees of freedom need the facility's "
                f"{len(DOFS)}"
            )
        return pose_jacobian(np.zeros(6) if self.pose is None else self.pose, self.plant.machine)

    def sensed(self, errors: Mapping[str, Array]) -> "Linear":
        """The same plant behind sensors; `errors` are shares by channel, (n,) each."""
        off = copy(self)
        off.system, off._sampled = self.system.copy(), {}
        for channel, error in errors.items():
            for name, part in zip(labels((channel,), self.plant.legs), error, strict=True):
                off.system.C[off.system.output_labels.index(name)] *= 1.0 + part
        return off

    def modes(self) -> tuple[Mode, ...]:
        """Modes of the plant without a law, slowest first."""
        return modes(self.system, self.jacobian)

    def model(self, signal: str) -> control.StateSpace:
        """A `signal`: one degree of freedom, moved and read by all legs, or a leg, `leg_1`.

        With J = d(legs)/d(pose) the commands are c = J_i w and the pose J^-1 l. A leg of full speed
        k then makes a pose of speed k w while the oil does not give way. The motion the others make
        along is left free. The input `<dof>_command` is a fraction of full command per leg and unit
        of J [1 for m, 1/m for rad]; outputs are `<dof>` [m or rad], `<dof>_rate` and
        `<dof>_acceleration`.
        """
        system, legs = self.system, self.plant.legs
        if signal.startswith("leg_"):
            return leg_model(system, self._leg(signal) + 1)
        index = dof_index(signal)
        inverse = np.linalg.inv(self.jacobian)[index]
        rows = np.zeros((3, int(system.noutputs)))
        for i, name in enumerate(FEEDBACK[:3]):
            rows[i, [system.output_labels.index(n) for n in labels((name,), legs)]] = inverse
        columns = np.zeros((int(system.ninputs), 1))
        places = [system.input_labels.index(n) for n in labels(("command",), legs)]
        columns[places, 0] = self.jacobian[:, index]
        b, c, d = (np.asarray(m) for m in (system.B, system.C, system.D))
        matrices = system.A, b @ columns, rows @ c, rows @ d @ columns
        names = {"inputs": [f"{signal}_command"], "states": system.state_labels}
        names["outputs"] = [signal, f"{signal}_rate", f"{signal}_acceleration"]
        return reduced(control.ss(*matrices, system.dt, name=f"{system.name}_{signal}", **names))

    def _leg(self, signal: str) -> int:
        legs = [f"leg_{leg + 1}" for leg in range(self.plant.legs)]
        return legs.index(check_name("dof", signal, legs))

    def leg_loop(self, law: str | Law, *, command_delay: int = 1) -> control.StateSpace:
        """From the demands of all legs to their positions under a law, see `closed_loop`.

        `command_delay` counts frames from the law to the valves.
        """
        held = bound(load_law(law, self.plant.machine), self.plant)
        if held.frame not in self._sampled:
            self._sampled[held.frame] = at_frames(self.system, held.frame)
        return closed_loop(held, self._sampled[held.frame], command_delay=command_delay)

    def loop(
        self, law: str | Law, signal: str | None = None, *, command_delay: int = 1
    ) -> control.StateSpace:
        """From demands to motions of the six degrees of freedom under a law, J^-1 H J.

        From `surge_demand` and on to `surge` and on, m and rad. Where a `signal` is named, a degree
        of freedom or a leg, `leg_1` and so on, it has that one input and output; all other demands
        are zero. `command_delay` counts frames from the law to the valves.
        """
        loop = self.leg_loop(law, command_delay=command_delay)
        if signal is not None and signal.startswith("leg_"):
            index = self._leg(signal)
            return loop[index, index]
        jacobian, inverse = self.jacobian, np.linalg.inv(self.jacobian)
        a, b, c, d = (np.asarray(m) for m in (loop.A, loop.B, loop.C, loop.D))
        matrices = a, b @ jacobian, inverse @ c, inverse @ d @ jacobian
        names = {"inputs": [f"{dof}_demand" for dof in DOFS], "outputs": list(DOFS)}
        whole = control.ss(*matrices, loop.dt, name=f"{loop.name}_pose", **names)
        if signal is None:
            return whole
        index = dof_index(signal)
        return whole[index, index]

    def damping(self, law: str | Law) -> dict[str, float]:
        """Damping ratios of the loop under a law, see `loop_damping`."""
        return loop_damping(self.loop(law))

    def margins(self, law: str | Law, signals: Sequence[str] = DOFS) -> Array:
        """Gain [dB] and phase margins [deg] under a `law` along `signals`, (n, 2).

        Signals are degrees of freedom or legs.

        The change that brings the loop to the limit of stability, the nearer one where there are
        two: a negative gain margin is one by which gain may fall. NaN where there is no crossing
        from 0.05 to 500 Hz; they count for a stable loop alone.

        >>> gain, phase = cmf_mj.Linear(cmf_mj.Hexapod("gfd")).margins("velocity", ["heave"])[0]
        >>> bool(gain > 6.0), bool(phase > 60.0)
        (True, True)
        """
        held = bound(load_law(law, self.plant.machine), self.plant)
        legs, order = self.plant.legs, self.system.nstates
        loop = closed_loop(held, self.system, outputs=("command",))
        entry = np.zeros((loop.nstates, legs))
        entry[order : order + legs] = np.eye(legs)  # commands enter the register of the delay
        found = []
        for signal in signals:
            if signal.startswith("leg_"):
                row: Array = np.eye(legs)[[self._leg(signal)]]
                column = row.T
            else:
                index = dof_index(signal)
                column = self.jacobian[:, [index]]
                row = np.asarray(np.linalg.inv(self.jacobian)[[index]])
            seen = row @ np.asarray(loop.C)
            opened = np.asarray(loop.A) - entry @ column @ seen
            broken = control.ss(opened, entry @ column, -seen, 0.0, loop.dt)
            # With log(-L) = a + j b, b within half a turn: -a where b is 0, and b where a is.
            logarithm = np.log(-broken(np.exp(2j * np.pi * _MARGINS * loop.dt)))
            level, angle = logarithm.real, logarithm.imag
            gain, phase = _least_at_zero(level, angle), _least_at_zero(angle, level)
            found.append((-20.0 / np.log(10.0) * gain, np.degrees(phase)))
        return np.array(found)

    def measures(self, law: str | Law) -> tuple[Measures, ...]:
        """Measures of all degrees of freedom under a law, see `loop_measures`."""
        return loop_measures(self.loop(law))[0]

    def compliance(self, law: str | Law, frequency: ArrayLike) -> NDArray[np.complex128]:
        """Motion of legs per force that extends them, (K, n, n) [m/N], under a law.

        At `frequency` (K,) [Hz]; at 0 Hz the force stays.
        """
        loop, a, legs = self.leg_loop(law), np.asarray(self.system.A), self.plant.legs
        speed, cap = (
            [self.system.state_labels.index(label) for label in labels((name,), legs)]
            for name in ("leg_velocity", "cap_pressure")
        )
        pushed = np.zeros((loop.nstates, legs))
        continuous = np.zeros((a.shape[0], legs))
        continuous[speed] = a[np.ix_(speed, cap)] / self.plant.hydraulics.cylinder.cap_area
        none = np.zeros((1, a.shape[0])), np.zeros((1, legs))
        pushed[: a.shape[0]] = cont2discrete((a, continuous, *none), loop.dt)[1]
        z = np.exp(2j * np.pi * np.asarray(frequency, dtype=float) * loop.dt)
        inside = z[:, None, None] * np.eye(loop.nstates) - np.asarray(loop.A)
        return np.asarray(np.asarray(loop.C) @ np.linalg.solve(inside, pushed.astype(complex)))

    def stiffness(self, law: str | Law, frequency: ArrayLike) -> Array:
        """Size of a force or moment along an axis over the motion along it [N/m, N m/rad], (K, 6).

        Under a law, of a plant with six legs that carry a platform, at `frequency` (K,) [Hz]; all
        axes are free.

        >>> stiff = cmf_mj.Linear(cmf_mj.Hexapod("gfd")).stiffness("velocity", [0.1, 2.0])
        >>> stiff.shape, bool(stiff[0, 0] > stiff[1, 0])
        ((2, 6), True)
        """
        back = np.linalg.inv(self.jacobian)
        moved = back @ self.compliance(law, frequency) @ back.T
        return np.asarray(1.0 / np.abs(np.diagonal(moved, axis1=1, axis2=2)))

    def disturbance(self, law: str | Law) -> Array:
        """Stiffness at rest, the least in `STIFF`, bandwidth [Hz] and peak [dB] of rejection.

        By axis, (4, 6); NaN if the law is unstable. Stiffness at rest is infinite under an error
        integral or a law without pressures: shut valves hold a load in cylinders of two areas.
        """
        if not are_stable(self.leg_loop(law).poles()):
            return np.full((4, len(DOFS)), np.nan)
        static, *held = self.stiffness(law, [0.0, *LINES])
        shut = self.stiffness(_SHUT.on(self.plant.machine), LINES)
        rejection = 20.0 * np.log10(shut / held)
        least = np.min(np.array(held)[(STIFF[0] <= LINES) & (LINES <= STIFF[1])], axis=0)
        bandwidth = [falls(LINES, -level, 3.0)[0] for level in rejection.T]
        static = np.where(static > _ENDLESS * least, np.inf, static)
        return np.array([static, least, bandwidth, rejection.max(axis=0)])


def _least_at_zero(values: Array, other: Array) -> float:
    """The smallest of the values where the other passes 0, and not from half a turn to the next."""
    passes = (np.diff(np.sign(other)) != 0.0) & (np.abs(np.diff(other)) < np.pi)
    at = np.flatnonzero(passes)
    share = other[at] / (other[at] - other[at + 1])
    there = values[at] + share * (values[at + 1] - values[at])
    return float(min(there, key=abs, default=np.nan))


def loop_damping(loop: control.StateSpace) -> dict[str, float]:
    """Least damping ratios of a discrete loop from demands to motions of `DOFS`.

    `least` of all poles, of the `pair` with its frequency `pair_hz`, and of each degree of freedom;
    `stable` is the verdict `are_stable`, of real and slow poles too.
    """
    poles, right = np.linalg.eig(np.asarray(loop.A))
    moved = np.abs(np.asarray(loop.C) @ right)
    driven = np.abs(np.linalg.solve(right, np.asarray(loop.B)))
    upper = poles.imag > 1e-9
    residues = (moved * driven.T)[:, upper]
    pairs = oscillations(poles, loop.dt)
    size = np.abs(pairs) / (2.0 * np.pi)
    ratio = -pairs.real / np.abs(pairs)
    inside = (size > DAMPED[0]) & (size < DAMPED[1])
    counts = residues >= SHARE * residues[:, inside].max(axis=1, keepdims=True, initial=0.0)
    slow = inside & (size < PAIR_HZ)
    pair_hz = float(size[slow][np.argmin(ratio[slow])]) if slow.any() else float("nan")
    found = {"stable": are_stable(poles), "least": _least(ratio, inside)}
    found |= {"pair": _least(ratio, slow), "pair_hz": pair_hz}
    return found | {dof: _least(ratio, inside & counts[i]) for i, dof in enumerate(DOFS)}


def _least(ratio: Array, where: NDArray[np.bool_]) -> float:
    return float(ratio[where].min()) if where.any() else float("nan")


def loop_measures(
    loop: control.StateSpace,
) -> tuple[tuple[Measures, ...], NDArray[np.complex128] | None]:
    """Measures of each axis of a discrete loop, and its response (n, n, K).

    `loop` goes from n demands to n motions. Its lines are `FREQUENCIES` and those of its poles. A
    loop that is not stable has no response and only a mode, the least damped of all.
    """
    poles = np.linalg.eigvals(np.asarray(loop.A))
    mode = least_damped_mode(poles, frame=loop.dt)
    axes = int(loop.noutputs)
    if not are_stable(poles):
        return (measures_from(mode=mode),) * axes, None
    peaks = np.abs(oscillations(poles, loop.dt)) / (2.0 * np.pi)
    lines = np.union1d(FREQUENCIES, peaks[(peaks > BAND[0]) & (peaks < BAND[1])])
    omega = 2.0 * np.pi * lines
    response = np.asarray(control.frequency_response(loop, omega).frdata)
    steps = _steps(loop)
    final = np.real(np.asarray(np.atleast_2d(control.dcgain(loop))))
    measures = []
    for i in range(axes):
        widths = bandwidths(control.FrequencyResponseData(response[i, i], omega))
        step = measure_step(steps[:, i, i], 1.0 / loop.dt, final=float(final[i, i]))
        measures.append(measures_from(widths, step, mode))
    return tuple(measures), response


def _steps(loop: control.StateSpace) -> Array:
    """Responses to unit steps of a discrete loop, (N, outputs, inputs), from the step on.

    Blocks of outputs from states a block apart: [C; CA; ...] x_k, x_(k+1) = A^n x_k + b.
    """
    a, b, c = (np.asarray(m) for m in (loop.A, loop.B, loop.C))
    order, inputs = b.shape
    # The step is one more state that stands still.
    whole = np.block([[a, b], [np.zeros((inputs, order)), np.eye(inputs)]])
    rows = [np.hstack([c, np.asarray(loop.D)])]
    for _ in range(_BLOCK - 1):
        rows.append(rows[-1] @ whole)
    reader = np.vstack(rows)
    stride = np.linalg.matrix_power(whole, _BLOCK)
    state = np.vstack([np.zeros((order, inputs)), np.eye(inputs)])
    blocks = []
    for _ in range(round(STEP_DURATION / loop.dt / _BLOCK)):
        blocks.append((reader @ state).reshape(_BLOCK, c.shape[0], inputs))
        state = stride @ state
    return np.concatenate(blocks)
