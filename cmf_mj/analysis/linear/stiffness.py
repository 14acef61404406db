"""What a force on the machine does under a law: compliance, stiffness and rejection by axis.

With the linearised machine x' = A x + B u + B_f F, in which a force F that extends a leg enters
where pressure times area does, and the law's loop closed in frames, the legs move by

    l = C (z 1 - A_loop)^-1 B_F F,    z = e^(j w T),

F held over a frame, which costs (w T)^2 / 24 of its size. A wrench W on the platform is J^-T W at
the legs, and x = J^-1 l. What a law takes off that motion is its disturbance rejection,

    |S| = |x / W| under the law over |x / W| with the valves shut,

for one leg the sensitivity 1 / (1 + loop gain). Bandwidth and peak of it are the DRB and DRP of
rotorcraft flight control: where |S| first rises through -3 dB, and the most it rises to.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import signal

from cmf_mj.analysis.frequency_response import falls
from cmf_mj.analysis.linear.assembly import linearize
from cmf_mj.analysis.linear.law import labels
from cmf_mj.analysis.linear.loop import closed_loop
from cmf_mj.analysis.linear.reduction import jacobian_of
from cmf_mj.control.law import Gains, Law, load_law
from cmf_mj.machine.geometry import DOFS
from cmf_mj.plant.plant import Plant

BAND = (0.5, 5.0)
"""Frequencies between which the least dynamic stiffness counts [Hz]."""

LINES = 0.05 * 10.0 ** (np.arange(105) / 40.0)
"""Lines the rejection is read from, 40 a decade, 0.05 to 19.9 Hz, the ends of `BAND` too."""

_SHUT = Law(name="shut", title="Valves shut", direct_gain=Gains())
_ENDLESS = 1e6  # times the least dynamic stiffness: round-off of no motion


def compliance(
    plant: Plant, law: str | Law, frequency: ArrayLike, pose: ArrayLike | None = None
) -> NDArray[np.complex128]:
    """Motion of legs per force that extends them, (K, n, n) [m/N], at `frequency` (K,) [Hz].

    At 0 Hz the force stays. A law in hydraulic modes must be bound to the plant's cab. The clamps
    do not act. Raises `InputError` as `linearize` and `closed_loop` do.

    >>> from cmf_mj.analysis.linear.stiffness import compliance
    >>> compliance(cmf_mj.SingleLegs(), "velocity", [1.0])[0].shape  # of six legs among each other
    (6, 6)
    """
    loaded, system, legs = load_law(law), linearize(plant, pose), plant.legs
    loop, a = closed_loop(loaded, system), np.asarray(system.A)
    speed, cap = (
        [system.state_labels.index(label) for label in labels((name,), legs)]
        for name in ("leg_velocity", "cap_pressure")
    )
    pushed = np.zeros((loop.nstates, legs))
    continuous = np.zeros((a.shape[0], legs))
    continuous[speed] = a[np.ix_(speed, cap)] / plant.hydraulics.cylinder.cap_area
    none = np.zeros((1, a.shape[0])), np.zeros((1, legs))
    pushed[: a.shape[0]] = signal.cont2discrete((a, continuous, *none), loaded.frame)[1]
    z = np.exp(2j * np.pi * np.asarray(frequency, dtype=float) * loaded.frame)
    inside = z[:, None, None] * np.eye(loop.nstates) - np.asarray(loop.A)
    return np.asarray(np.asarray(loop.C) @ np.linalg.solve(inside, pushed.astype(complex)))


def dynamic_stiffness(
    plant: Plant, law: str | Law, frequency: ArrayLike, pose: ArrayLike | None = None
) -> NDArray[np.float64]:
    """Size of a force or moment along an axis over the motion along it, (K, 6) [N/m, N m/rad].

    Of a plant with six legs that carry a platform, at `frequency` (K,) [Hz]; all axes are free.

    >>> from cmf_mj.analysis.linear.stiffness import dynamic_stiffness
    >>> stiff = dynamic_stiffness(cmf_mj.Hexapod("gfd"), "velocity", [0.1, 2.0])
    >>> stiff.shape, bool(stiff[0, 0] > stiff[1, 0])
    ((2, 6), True)
    """
    back = np.linalg.inv(jacobian_of(plant, pose))
    moved = back @ compliance(plant, law, frequency, pose) @ back.T
    return np.asarray(1.0 / np.abs(np.diagonal(moved, axis1=1, axis2=2)))


def disturbance(plant: Plant, law: str | Law) -> NDArray[np.float64]:
    """Stiffness at rest, the least in `BAND`, bandwidth [Hz] and peak [dB] of rejection, (4, 6).

    By axis at neutral, as `dynamic_stiffness`; NaN if unstable. Stiffness at rest is infinite under
    an error integral or a law without pressures: shut valves hold a load in cylinders of two areas.

    >>> from cmf_mj.analysis.linear.stiffness import disturbance
    >>> static, least, bandwidth, peak = disturbance(cmf_mj.Hexapod("gfd"), "velocity")
    >>> bandwidth.round(1)
    array([1.5, 1.5, 1.5, 1.5, 1.5, 1.5])
    """
    if not np.abs(closed_loop(load_law(law), linearize(plant)).poles()).max() < 1.0:
        return np.full((4, len(DOFS)), np.nan)
    static, *held = dynamic_stiffness(plant, law, [0.0, *LINES])
    shut = dynamic_stiffness(plant, _SHUT.on(plant.machine), LINES)
    rejection = 20.0 * np.log10(shut / held)
    least = np.min(np.array(held)[(BAND[0] <= LINES) & (LINES <= BAND[1])], axis=0)
    bandwidth = [falls(LINES, -level, 3.0)[0] for level in rejection.T]
    static = np.where(static > _ENDLESS * least, np.inf, static)
    return np.array([static, least, bandwidth, rejection.max(axis=0)])
