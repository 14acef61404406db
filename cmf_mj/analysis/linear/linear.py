"""A plant linearised once at a pose, and all that is asked of it: loops, margins, stiffness.

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
from typing import NamedTuple

import control
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import cont2discrete

from cmf_mj.analysis.frequency_response import find_falls
from cmf_mj.analysis.linear.assembly import linearize
from cmf_mj.analysis.linear.loop import at_frames, closed_loop, labels
from cmf_mj.analysis.linear.operating_point import operating_point
from cmf_mj.analysis.linear.plants import MOTIONS, leg_model, reduced
from cmf_mj.analysis.linear.poles import Mode, are_stable, loop_damping, modes
from cmf_mj.analysis.linear.ports import Excitation
from cmf_mj.analysis.measures import Measures, measure_axes
from cmf_mj.analysis.modes import bound
from cmf_mj.control.law import Gains, Law, load_law
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.machine.geometry import DOFS, dof_index
from cmf_mj.machine.kinematics import pose_jacobian
from cmf_mj.plant.cylinder import Contact
from cmf_mj.plant.plant import Plant

Array = NDArray[np.float64]

_STIFFNESS_BAND = (0.5, 5.0)  #: Where the least dynamic stiffness is sought [Hz].
_REJECTION_LINES = 0.05 * 10.0 ** (np.arange(105) / 40.0)
"""Lines the rejection is read from, 40 a decade, 0.05 to 19.9 Hz, with the ends of that band."""
_MARGIN_LINES = np.geomspace(0.05, 500.0, 2000)  #: Lines that margins are read from [Hz].
_VALVES_SHUT = Law(name="shut", title="Valves shut", direct_gain=Gains())
_INFINITE_RATIO = 1e6  #: Stiffness at rest over the least dynamic one that counts as infinite.


class Disturbance(NamedTuple):
    """Answer of a platform under a law to forces, by axis, (6,) each; NaN where unstable."""

    static_stiffness: Array
    """At rest [N/m, N m/rad]; infinite under an error integral or a law without pressures: shut
    valves hold a load in cylinders of two areas."""
    least_stiffness: Array  #: Least from 0.5 to 5 Hz [N/m, N m/rad].
    bandwidth_hz: Array  #: Where the rejection first rises through -3 dB [Hz].
    peak_db: Array  #: Most it rises to [dB].


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

    @cached_property
    def _inverse(self) -> Array:
        return np.asarray(np.linalg.inv(self.jacobian))

    def sensed(self, errors: Mapping[str, Array]) -> "Linear":
        """The same plant behind sensors; `errors` are shares by channel, (n,) each."""
        measured = copy(self)
        measured.system, measured._sampled = self.system.copy(), {}
        for channel, shares in errors.items():
            rows = self._indices(self.system.output_labels, channel)
            measured.system.C[rows] *= 1.0 + np.asarray(shares)[:, None]
        return measured

    def modes(self) -> tuple[Mode, ...]:
        """Modes of the plant without a law, slowest first."""
        return modes(self.system, self.jacobian)

    def model(self, signal: str) -> control.StateSpace:
        """A `signal`: one degree of freedom, moved and read by all legs, or a leg, `leg_1`.

        With J = d(legs)/d(pose) the commands are c = J_i w and the pose J^-1 l; the others are left
        free. The input `<dof>_command` is a fraction of full command per leg and unit of J [1 for
        m, 1/m for rad]; outputs are `<dof>` [m or rad], `<dof>_rate` and `<dof>_acceleration`.
        """
        system = self.system
        if signal.startswith("leg_"):
            return leg_model(system, self._leg_index(signal) + 1)
        dof = dof_index(signal)
        to_dof = np.zeros((len(MOTIONS), int(system.noutputs)))
        for i, motion in enumerate(MOTIONS):
            to_dof[i, self._indices(system.output_labels, motion)] = self._inverse[dof]
        from_dof = np.zeros((int(system.ninputs), 1))
        from_dof[self._indices(system.input_labels, "command"), 0] = self.jacobian[:, dof]
        b, c, d = (np.asarray(m) for m in (system.B, system.C, system.D))
        matrices = system.A, b @ from_dof, to_dof @ c, to_dof @ d @ from_dof
        names = {"inputs": [f"{signal}_command"], "states": system.state_labels}
        names["outputs"] = [signal, f"{signal}_rate", f"{signal}_acceleration"]
        return reduced(control.ss(*matrices, system.dt, name=f"{system.name}_{signal}", **names))

    def _leg_index(self, signal: str) -> int:
        legs = [f"leg_{leg + 1}" for leg in range(self.plant.legs)]
        return legs.index(check_name("dof", signal, legs))

    def _indices(self, names: list[str], kind: str) -> list[int]:
        """Where the inputs, outputs or states of a kind stand among all, leg by leg."""
        return [names.index(name) for name in labels((kind,), self.plant.legs)]

    def leg_loop(self, law: str | Law, *, command_delay: int = 1) -> control.StateSpace:
        """From the demands of all legs to their positions under a law, see `closed_loop`.

        `command_delay` counts frames from the law to the valves.
        """
        bound_law = self._bound(law)
        frame = bound_law.frame
        if frame not in self._sampled:
            self._sampled[frame] = at_frames(self.system, frame)
        return closed_loop(bound_law, self._sampled[frame], command_delay=command_delay)

    def _bound(self, law: str | Law) -> Law:
        return bound(load_law(law, self.plant.machine), self.plant)

    def loop(
        self, law: str | Law, signal: str | None = None, *, command_delay: int = 1
    ) -> control.StateSpace:
        """From demands to motions of the six degrees of freedom under a law, J^-1 H J.

        From `surge_demand` and on to `surge` and on, m and rad; of a `signal`, a degree of freedom
        or a leg, `leg_1`, alone where it is named. `command_delay` counts frames to the valves.
        """
        loop = self.leg_loop(law, command_delay=command_delay)
        if signal is not None and signal.startswith("leg_"):
            leg = self._leg_index(signal)
            return loop[leg, leg]
        jacobian, inverse = self.jacobian, self._inverse
        a, b, c, d = (np.asarray(m) for m in (loop.A, loop.B, loop.C, loop.D))
        matrices = a, b @ jacobian, inverse @ c, inverse @ d @ jacobian
        names = {"inputs": [f"{dof}_demand" for dof in DOFS], "outputs": list(DOFS)}
        pose_loop = control.ss(*matrices, loop.dt, name=f"{loop.name}_pose", **names)
        if signal is None:
            return pose_loop
        dof = dof_index(signal)
        return pose_loop[dof, dof]

    def damping(self, law: str | Law) -> dict[str, float]:
        """Damping ratios of the loop under a law, see `loop_damping`."""
        return loop_damping(self.loop(law))

    def margins(self, law: str | Law, signals: Sequence[str] = DOFS) -> Array:
        """Gain [dB] and phase margins [deg] under a `law` along `signals`, (n, 2).

        Signals are degrees of freedom or legs.

        The change that brings a stable loop to the limit of stability, the nearer one of two: a
        negative gain margin is one by which gain may fall. NaN without a crossing from 0.05 to 500
        Hz.

        >>> gain, phase = cmf_mj.Linear(cmf_mj.Hexapod("gfd")).margins("velocity", ["heave"])[0]
        >>> bool(gain > 6.0), bool(phase > 60.0)
        (True, True)
        """
        legs, order = self.plant.legs, self.system.nstates
        loop = closed_loop(self._bound(law), self.system, outputs=("command",))
        entry = np.zeros((loop.nstates, legs))
        entry[order : order + legs] = np.eye(legs)  # commands enter the register of the delay
        margins = []
        for signal in signals:
            if signal.startswith("leg_"):
                row: Array = np.eye(legs)[[self._leg_index(signal)]]
                column = row.T
            else:
                dof = dof_index(signal)
                column, row = self.jacobian[:, [dof]], self._inverse[[dof]]
            command = row @ np.asarray(loop.C)
            broken_a = np.asarray(loop.A) - entry @ column @ command
            broken_loop = control.ss(broken_a, entry @ column, -command, 0.0, loop.dt)
            # With log(-L) = a + j b, b within half a turn: -a where b is 0, and b where a is.
            logarithm = np.log(-broken_loop(np.exp(2j * np.pi * _MARGIN_LINES * loop.dt)))
            log_gain, angle = logarithm.real, logarithm.imag
            gain_change = -_least_at_zero(log_gain, angle)
            angle_change = _least_at_zero(angle, log_gain)
            margins.append((20.0 / np.log(10.0) * gain_change, np.degrees(angle_change)))
        return np.array(margins)

    def measures(self, law: str | Law) -> tuple[Measures, ...]:
        """Measures of all degrees of freedom under a law, see `measure_axes`."""
        return measure_axes(self.loop(law)).measures

    def compliance(self, law: str | Law, frequency: ArrayLike) -> NDArray[np.complex128]:
        """Motion of legs per force that extends them, (K, n, n) [m/N], under a `law`.

        At `frequency` (K,) [Hz]; at 0 Hz the force stays.
        """
        loop, a, legs = self.leg_loop(law), np.asarray(self.system.A), self.plant.legs
        speeds = self._indices(self.system.state_labels, "leg_velocity")
        cap_pressures = self._indices(self.system.state_labels, "cap_pressure")
        order = a.shape[0]
        force_entry = np.zeros((order, legs))
        cap_area = self.plant.hydraulics.cylinder.cap_area
        force_entry[speeds] = a[np.ix_(speeds, cap_pressures)] / cap_area
        no_output = np.zeros((1, order)), np.zeros((1, legs))
        loop_entry = np.zeros((loop.nstates, legs), dtype=complex)
        loop_entry[:order] = cont2discrete((a, force_entry, *no_output), loop.dt)[1]
        z = np.exp(2j * np.pi * np.asarray(frequency, dtype=float) * loop.dt)
        characteristic = z[:, None, None] * np.eye(loop.nstates) - np.asarray(loop.A)
        return np.asarray(np.asarray(loop.C) @ np.linalg.solve(characteristic, loop_entry))

    def stiffness(self, law: str | Law, frequency: ArrayLike) -> Array:
        """Size of a force or moment along an axis over the motion along it [N/m, N m/rad], (K, 6).

        Under a law, at `frequency` (K,) [Hz]; all axes are free.

        >>> stiff = cmf_mj.Linear(cmf_mj.Hexapod("gfd")).stiffness("velocity", [0.1, 2.0])
        >>> stiff.shape, bool(stiff[0, 0] > stiff[1, 0])
        ((2, 6), True)
        """
        inverse = self._inverse
        compliance = inverse @ self.compliance(law, frequency) @ inverse.T
        return np.asarray(1.0 / np.abs(np.diagonal(compliance, axis1=1, axis2=2)))

    def disturbance(self, law: str | Law) -> Disturbance:
        """Stiffness and disturbance rejection of the platform by axis under a law."""
        if not are_stable(self.leg_loop(law).poles()):
            unknown = np.full(len(DOFS), np.nan)
            return Disturbance(unknown, unknown, unknown, unknown)
        stiffness = self.stiffness(law, [0.0, *_REJECTION_LINES])
        static, dynamic = stiffness[0], stiffness[1:]
        shut = self.stiffness(_VALVES_SHUT.for_machine(self.plant.machine), _REJECTION_LINES)
        rejection = 20.0 * np.log10(shut / dynamic)
        low, high = _STIFFNESS_BAND
        least = dynamic[(low <= _REJECTION_LINES) & (_REJECTION_LINES <= high)].min(axis=0)
        bandwidth = [find_falls(_REJECTION_LINES, -gain_db, 3.0)[0] for gain_db in rejection.T]
        return Disturbance(
            static_stiffness=np.where(static > _INFINITE_RATIO * least, np.inf, static),
            least_stiffness=least,
            bandwidth_hz=np.array(bandwidth),
            peak_db=rejection.max(axis=0),
        )


def _least_at_zero(values: Array, other: Array) -> float:
    """The smallest of the values where the other passes 0, and not from half a turn to the next."""
    passes = (np.diff(np.sign(other)) != 0.0) & (np.abs(np.diff(other)) < np.pi)
    rows = np.flatnonzero(passes)
    share = other[rows] / (other[rows] - other[rows + 1])
    crossings = values[rows] + share * (values[rows + 1] - values[rows])
    return float(min(crossings, key=abs, default=np.nan))
