"""Mechanisms of the IFToMM library of computational benchmark problems, as MuJoCo models.

A02 N-four-bar (N = 2), A03 Andrews' squeezer, A04 Bricard's mechanism, A05 stiff flyball governor
(M. Gonzalez, D. Dopico, U. Lugris and J. Cuadrado, Multibody System Dynamics 16 (2006) 179-190,
names A01 to A05). The numbers of A02, A04 and A05 are those of MBSbenchmarksInOpenSim (L.
Tagliapietra and others, Padova), those of A03 of the test set of E. Hairer and G. Wanner (Solving
Ordinary Differential Equations II, VII.7). Each has a reference that knows no MuJoCo.

World axes are the library's: gravity along -y, along -z in A05.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import integrate

Array = NDArray[np.float64]

GRAVITY = 9.81
CRANK = 0.007
"""From O to F of Andrews' squeezer [m]."""
TESTSET_TIME = 0.03
TESTSET = (
    *(15.81077119629904, -15.75637105984298, 0.04082224013073101, -0.5347301163226948),
    *(0.5244099658805304, 0.5347301163226948, 1.048080741042263),
)
"""Beta, Theta, gamma, Phi, delta, Omega, epsilon of Andrews' squeezer at 0.03 s [rad]."""


class Mechanism(NamedTuple):
    """A model without solver settings, and what the library asks of it."""

    name: str
    bodies: str  #: MJCF of worldbody, and of tendons and connects where there are any.
    gravity: str
    seconds: float  #: Length of the library's run [s].
    step: float  #: The step of the table [s].
    start: tuple[float, ...] = ()  #: Joint coordinates at the start.
    speed: tuple[float, ...] = ()  #: Joint rates at the start.
    torque: float = 0.0  #: On the first joint [N m].


def _body(place: str, joint: str, inner: str, hinge: str = "hinge") -> str:
    return f'<body pos="{place}"><joint type="{hinge}" axis="{joint}"/>{inner}</body>'


def _mass(mass: float, centre: str, inertia: str) -> str:
    return f'<inertial mass="{mass}" pos="{centre}" diaginertia="{inertia}"/>'


def four_bars(windows: int = 2) -> Mechanism:
    """Upright bars on hinges 1 m apart, joined by bars at their tops; B0 moves at 1 m/s."""
    flat, high = (_mass(1.0, at, i) for at, i in _RODS)
    joined = ""
    for index in reversed(range(windows)):  # a chain of the bars at the top
        joined = _body("0 1 0" if index == 0 else "1 0 0", "0 0 1", f"{flat}{_top(index)}{joined}")
    bars = _body("0 0 0", "0 0 1", high + joined)
    ends, pins = "", ""
    for index in range(1, windows + 1):
        tip = f'<site name="bar{index}" pos="0 1 0"/>'
        ends += _body(f"{index} 0 0", "0 0 1", high + tip)
        pins += f'<connect class="pin" site1="top{index}" site2="bar{index}"/>'
    speed = (-1.0, 1.0, *[0.0] * (windows - 1), *[-1.0] * windows)
    bodies = f"<worldbody>{bars}{ends}</worldbody><equality>{pins}</equality>"
    return Mechanism("A02 N-four-bar", bodies, f"0 -{GRAVITY} 0", 10.0, _FRAME, (), speed)


_FRAME = 1.0 / 2048.0
_RODS = (
    ("0.5 0 0", "1e-3 0.08333333333333333 0.08333333333333333"),
    ("0 0.5 0", "0.08333333333333333 1e-3 0.08333333333333333"),
)
"""Centre and inertia of slender rods of 1 m and 1 kg along x and along y."""


def _top(index: int) -> str:
    return f'<site name="top{index + 1}" pos="1 0 0"/>'


def four_bars_reference(times: Array) -> Array:
    """B0 of two windows, (K, 2): all bars stay parallel, so one angle from upright moves all.

    T = (1/2) (3 m l^2 / 3 + 2 m l^2) w^2, V = m g l (3 / 2 + 2) cos(angle).
    """

    def rates(_: float, state: Array) -> list[float]:
        return [state[1], 3.5 * GRAVITY * np.sin(state[0]) / 3.0]

    angle = _solved(rates, [0.0, 1.0], times)[0]
    return np.stack([np.sin(angle), np.cos(angle)], axis=1)


def _solved(rates: Callable[[float, Array], object], start: object, times: Array) -> Array:
    end = (0.0, float(times[-1]))
    options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13}
    return np.asarray(integrate.solve_ivp(rates, end, start, t_eval=times, **options).y)


def squeezer() -> Mechanism:
    """Seven bodies in a plane with three loops through E, a spring from D to C, a motor at O."""
    third = '<site name="e3" pos="0 -.035 0"/><site name="d" pos=".02 -.018 0"/>'

    def link(mass: float, x: float, y: float, inertia: float) -> str:
        return _mass(mass, f"{x} {y} 0", f"{inertia} {inertia} {inertia}")

    z = "0 0 1"
    second = link(0.00365, -0.0115, 0.0, 4.41e-7) + '<site name="e2" pos="-.028 0 0"/>'
    fourth = link(0.00706, 0.0, -0.00579, 5.667e-7) + '<site name="e4" pos="0 -.02 0"/>'
    sixth = link(0.00706, 0.00579, 0.0, 5.667e-7) + '<site name="e6" pos=".02 0 0"/>'
    parts = (
        _body("0 0 0", z, link(0.04325, 0.00092, 0.0, 2.194e-6) + _body(f"{CRANK} 0 0", z, second)),
        _body("-.03635 .03273 0", z, link(0.02373, 0.01043, -0.01874, 5.255e-6) + third),
        _body(
            "-.06934 -.00227 0",
            z,
            link(0.0705, 0.02308, 0.00916, 1.169e-5) + _body(".04 0 0", z, fourth),
        ),
        _body(
            "-.06934 -.00227 0",
            z,
            link(0.05498, -0.00449, -0.01228, 1.912e-5) + _body("0 -.04 0", z, sixth),
        ),
    )
    pins = "".join(f'<connect class="pin" site1="e{i}" site2="e3"/>' for i in (2, 4, 6))
    spring = (
        '<spatial stiffness="4530" springlength=".07785"><site site="d"/><site site="c"/></spatial>'
    )
    bodies = (
        f'<worldbody><site name="c" pos=".014 .072 0"/>{"".join(parts)}</worldbody>'
        f"<tendon>{spring}</tendon><equality>{pins}</equality>"
    )
    # Joints in the order of the model: beta, Theta, gamma, delta, Phi, epsilon, Omega.
    start = (
        *(-0.0617138900142764496, 0.0, 0.455279819163070380, 0.487364979543842550),
        *(0.222668390165885884, 1.23054744454982119, -0.222668390165885884),
    )
    return Mechanism("A03 Andrews' squeezer", bodies, "0 0 0", 0.05, 1e-5, start, torque=0.033)


def squeezer_coordinates(joints: Array) -> Array:
    """The coordinates of `TESTSET`, from those of the model."""
    return joints[[0, 1, 2, 4, 3, 6, 5]]


BRICARD_POINTS = ((0, 0, 0), (1, 0, 0), (1, -1, 0), (1, -1, 1), (0, -1, 1), (0, 0, 1))
BRICARD_AXES = ((0, 1, 0), (0, 0, 1), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, 0))


def bricard() -> Mechanism:
    """Five rods along edges of a cube, six hinges: one freedom that counting does not find."""
    inner, points = "", np.array(BRICARD_POINTS, dtype=float)
    for index in reversed(range(5)):
        rod = points[index + 1] - points[index]
        before = points[index] - points[index - 1] if index else np.zeros(3)
        along = np.where(np.abs(rod) > 0.5, *_BRICK)
        if index == 4:
            inner = "".join(
                f'<site name="a{k}" pos="{_text(rod + [0.2 * k, 0, 0])}"/>' for k in (0, 1)
            )
        centre = _mass(1.0, _text(0.5 * rod), _text(along))
        inner = _body(_text(before), _text(BRICARD_AXES[index]), centre + inner)
    ground = "".join(f'<site name="b{k}" pos="{0.2 * k} 0 1"/>' for k in (0, 1))
    pins = "".join(f'<connect class="pin" site1="a{k}" site2="b{k}"/>' for k in (0, 1))
    bodies = f"<worldbody>{ground}{inner}</worldbody><equality>{pins}</equality>"
    return Mechanism("A04 Bricard", bodies, f"0 -{GRAVITY} 0", 10.0, _FRAME)


_BRICK = (0.02 / 12.0, 1.01 / 12.0)
"""Inertia of a rod of 1 kg, 1 m, 0.1 m square about its length and across [kg m^2]."""


def _text(values: object) -> str:
    return " ".join(repr(float(value)) for value in np.asarray(values, dtype=float))


def _bricard_motion(angles: Array) -> tuple[Array, Array, Array, Array]:
    """Of the five rods: rotations, hinge axes, hinge points and P5, in the world."""
    points, turn, place = np.array(BRICARD_POINTS, dtype=float), np.eye(3), np.zeros(3)
    turns, axes, places = [], [], []
    for index, angle in enumerate(angles):
        axis = np.array(BRICARD_AXES[index], dtype=float)
        axes.append(turn @ axis)
        places.append(place)
        cross = np.cross(axis, np.eye(3)).T
        turn = turn @ (np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)
        place = place + turn @ (points[index + 1] - points[index])
        turns.append(turn)
    return np.array(turns), np.array(axes), np.array(places), place


def _bricard_mode(angles: Array, before: Array) -> tuple[Array, float, float]:
    """The unit motion that keeps the loop closed, its inertia and the height of all centres."""
    turns, axes, places, end = _bricard_motion(angles)
    last = turns[4] @ np.array([1.0, 0.0, 0.0])  # stays along x, the axis of the sixth hinge
    rows = np.vstack([np.cross(axes, end - places).T, np.cross(axes, last).T])
    mode = np.linalg.svd(rows)[2][-1]
    mode = mode if mode @ before > 0.0 else -mode
    points, inertia, height = np.array(BRICARD_POINTS, dtype=float), 0.0, 0.0
    for index in range(5):
        rod = points[index + 1] - points[index]
        centre = places[index] + 0.5 * turns[index] @ rod
        spin = mode[: index + 1] @ axes[: index + 1]
        speed = mode[: index + 1] @ np.cross(axes[: index + 1], centre - places[: index + 1])
        own = turns[index].T @ spin
        inertia += float(speed @ speed + own @ (np.where(np.abs(rod) > 0.5, *_BRICK) * own))
        height += float(centre[1])
    return mode, inertia, height


def bricard_reference(times: Array) -> Array:
    """P3, (K, 3): d/dt(m v) = (1/2) m' v^2 - V' along the one motion that keeps the loop closed.

    The motion is the null vector of the closure's Jacobian; m' and V' are central differences.
    """
    small = 1e-5
    near: list[Array] = [np.ones(5)]

    def rates(_: float, state: Array) -> Array:
        mode, inertia, _ = _bricard_mode(state[:5], near[0])
        near[:] = [mode]
        after, behind = (_bricard_mode(state[:5] + way * small * mode, mode) for way in (1.0, -1.0))
        slope, pull = np.subtract(after[1:], behind[1:]) * (0.5 / small) * (1.0, GRAVITY)
        return np.append(mode * state[5], -(0.5 * slope * state[5] ** 2 + pull) / inertia)

    angles = _solved(rates, np.zeros(6), times)[:5].T
    return bricard_points(angles)


def bricard_points(angles: Array) -> Array:
    """P3, (K, 3), of joint angles, (K, 5)."""
    return np.array([_bricard_motion(each)[2][3] for each in angles])


ROD, TIP, SLIDER = 0.3, 5.0, 3.0
STIFF, DAMPED, FREE = 8e5, 4e4, 0.5


def flyballs() -> Mechanism:
    """A shaft with a slider and two rods with balls, held by stiff springs with dampers."""
    thin, thick, cube = ROD * 2e-4 / 12.0, ROD * 1.0001 / 12.0, SLIDER * 0.02 / 12.0
    parts = _mass(ROD, "0 0 .5", f"{thick} {thick} {thin}")
    parts += _body(
        "0 0 0",
        "0 0 1",
        _mass(SLIDER, "0 0 0", f"{cube} {cube} {cube}")
        + '<site name="s0" pos=".05 0 0"/><site name="s1" pos="-.05 0 0"/>',
        "slide",
    )
    for index, side in enumerate((1, -1)):
        rod = _mass(ROD, f"{0.5 * side} 0 0", f"{thin} {thick} {thick}")
        ball = f'<body pos="{side} 0 0">{_mass(TIP, "0 0 0", "1e-9 1e-9 1e-9")}</body>'
        site = f'<site name="r{index}" pos="{0.5 * side} 0 0"/>'
        parts += _body(f"{0.05 * side} 0 1", f"0 {side} 0", rod + site + ball)
    springs = "".join(
        f'<spatial stiffness="{STIFF}" damping="{DAMPED}" springlength="{FREE}"><site site="s{i}"/>'
        f'<site site="r{i}"/></spatial>'
        for i in (0, 1)
    )
    bodies = f"<worldbody>{_body('0 0 0', '0 0 1', parts)}</worldbody><tendon>{springs}</tendon>"
    start, speed = (0.0, 0.5, np.pi / 6.0, np.pi / 6.0), (2.0 * np.pi, 0.0, 0.0, 0.0)
    return Mechanism("A05 flyballs", bodies, f"0 0 -{GRAVITY}", 10.0, _FRAME, start, speed)


def flyballs_reference(times: Array) -> Array:
    """Height of the slider, (K,): three coordinates, as both sides move alike.

    Rods hang at `angle` below level, I(angle) w is constant, and along the length d of a spring
    acts k (d - l) + c d'.
    """
    thin, thick = ROD * 2e-4 / 12.0, ROD * 1.0001 / 12.0
    swing = thick + 0.25 * ROD + TIP
    fixed = thin + SLIDER * 0.02 / 12.0

    def turning(angle: float) -> tuple[float, float]:
        """Inertia about the shaft and its slope."""
        cos, sin = np.cos(angle), np.sin(angle)
        half, whole = 0.05 + 0.5 * cos, 0.05 + cos
        inertia = ROD * half**2 + thick * cos**2 + thin * sin**2 + TIP * whole**2
        slope = -ROD * half * sin - 2.0 * (thick - thin) * sin * cos - 2.0 * TIP * whole * sin
        return fixed + 2.0 * inertia, 2.0 * slope

    momentum = turning(np.pi / 6.0)[0] * 2.0 * np.pi

    def rates(_: float, state: Array) -> list[float]:
        height, angle, lift, turn = state
        cos, sin = np.cos(angle), np.sin(angle)
        rise = 1.0 - 0.5 * sin - height
        length = np.hypot(0.5 * cos, rise)
        on_height, on_angle = -rise / length, -(0.25 * sin * cos + 0.5 * rise * cos) / length
        pull = STIFF * (length - FREE) + DAMPED * (on_height * lift + on_angle * turn)
        inertia, slope = turning(angle)
        weight = (0.5 * ROD + TIP) * GRAVITY * cos
        spin = 0.25 * slope * (momentum / inertia) ** 2
        up = -GRAVITY - 2.0 * pull * on_height / SLIDER
        return [lift, turn, up, (weight + spin - pull * on_angle) / swing]

    start, end = [0.5, np.pi / 6.0, 0.0, 0.0], (0.0, float(times[-1]))
    options = {"method": "Radau", "rtol": 1e-10, "atol": 1e-12}
    return np.asarray(integrate.solve_ivp(rates, end, start, t_eval=times, **options).y[0])
