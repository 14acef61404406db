"""Hinges with motors become hydraulic cylinders: where to attach them, and how large they are.

A cylinder joins a point A of the parent body to a point B of the hinge's body, at an arm b from the
axis. With the range of the hinge 2 h about its middle, A lies on the line through both end places
of B, beyond the first of them, so that with L strokes from A to there

    stroke  s = 2 b sin h,   length at the ends  L s and (L + 1) s,
    a^2 = b^2 (cos^2 h + (1 + 2 L)^2 sin^2 h),   A's angle to B in the middle  cos m = b cos h / a

At the angle q from the middle the length l and the lever arm r are, with p = m + q,

    l^2 = a^2 + b^2 - 2 a b cos p,   r = dl/dq = a b sin p / l

and r is least at both ends, b cos h. There the weaker side, the rod's, gives the torque T at a
standstill: Ar = T / (b cos h (Ps - Pt Ac / Ar)). The bore goes with 1/sqrt(b) and the stroke with
b; b is chosen so that a stroke has `SLENDERNESS` bores.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from cmf_mj.core.errors import InputError
from cmf_mj.core.settings import merged, validated
from cmf_mj.plant.attach import attach_hydraulics, load_spec
from cmf_mj.plant.parameters import HydraulicParameters, load_hydraulics
from cmf_mj.plant.plant import Plant

SLENDERNESS = 5.0  #: Bores in a stroke, by default.

_LEAST_SLENDER, _MOST_SLENDER = 2.0, 12.0
"""Bores in a stroke: below there is no room for piston and glands, above the rod buckles."""

_LARGEST_RANGE = np.deg2rad(150.0)  #: [rad]; the lever arm is a quarter of its largest there.

_RETRACTED_LENGTH = 1.5  #: L, in strokes, at the near end: one of oil, half of one of metal.

_END_MARGIN = 0.05
"""Of the stroke beyond either end of the range, which the hinge's own stops keep free."""

_AT_JOINT = mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT


class HingeCylinder(NamedTuple):
    """A cylinder across a hinge; angles [rad] count from the middle of the range.

    >>> from cmf_mj.plant.hinge import HingeCylinder
    >>> across = HingeCylinder(half_range=0.5, arm=0.1)
    >>> float(across.length(0.5) - across.length(-0.5)) / across.stroke
    1.0
    """

    half_range: float  #: h [rad].
    arm: float  #: b, from the axis to the point on the hinge's body [m].

    @property
    def stroke(self) -> float:
        """Travel over the range [m]."""
        return 2.0 * self.arm * np.sin(self.half_range)

    @property
    def base(self) -> float:
        """From the axis to the point on the parent [m]."""
        opposite = (1.0 + 2.0 * _RETRACTED_LENGTH) * np.sin(self.half_range)
        return float(self.arm * np.hypot(np.cos(self.half_range), opposite))

    @property
    def middle(self) -> float:
        """Angle between both points at the middle [rad]."""
        return float(np.arccos(self.arm * np.cos(self.half_range) / self.base))

    def length(self, angle: ArrayLike) -> NDArray[np.float64]:
        """From point to point [m]."""
        product = 2.0 * self.base * self.arm * np.cos(self.middle + np.asarray(angle))
        return np.asarray(np.sqrt(self.base**2 + self.arm**2 - product))

    def lever(self, angle: ArrayLike) -> NDArray[np.float64]:
        """Torque per force [m]."""
        product = self.base * self.arm * np.sin(self.middle + np.asarray(angle))
        return np.asarray(product / self.length(angle))


def attach_to_hinges(
    model: str | Path | mujoco.MjSpec,
    hinges: Sequence[str] | Mapping[str, float | None],
    hydraulics: str | Path | HydraulicParameters = "hardware",
    *,
    arms: Mapping[str, float] | None = None,
    against: Sequence[str] = (),
    **options: Any,
) -> Plant:
    """Put a hydraulic cylinder in the place of each motor of some hinges of a MuJoCo model.

    Sites, tendons and sizes of the cylinders are as the head of `cmf_mj/plant/hinge.py` says; B
    lies towards the centre of mass of the hinge's body. A cylinder is named `HINGE_cylinder`.

    Args:
        model: path of an MJCF file, or an `MjSpec`, which is left as it is.
        hinges: names of hinge joints with a range, or a mapping from them to the torque [N m] that
            a cylinder gives at a standstill either way, anywhere in the range; None, as in a plain
            list, for that of the motor or of `actuatorfrcrange`. Motors of these hinges go.
        hydraulics: a set whose supply feeds the cylinders; bores, rods (in the set's proportion)
            and strokes are replaced.
        arms: b by hinge [m], where it is not to follow from the torque.
        against: hinges that turn to negative angles as their cylinder extends.
        **options: `payload` and `timestep`, as for `attach_hydraulics`.

    >>> door = mujoco.MjSpec.from_string('''<mujoco model="door"><worldbody><body>
    ...   <joint name="hinge" axis="0 0 1" range="-45 45"/><geom size="0.1" pos="0.5 0 0"/>
    ... </body></worldbody></mujoco>''')
    >>> plant = cmf_mj.attach_to_hinges(door, {"hinge": 5e3})
    >>> plant.actuators
    ('hinge_cylinder',)
    """
    spec, parameters = load_spec(model), load_hydraulics(hydraulics)
    if isinstance(hinges, str) or not hinges:
        raise InputError(f"hinges: {hinges!r} names no hinges; allowed: a list")
    torques = dict(hinges) if isinstance(hinges, Mapping) else dict.fromkeys(hinges)
    arms = arms or {}
    for field, names in (("arms", arms), ("against", against)):
        if unknown := sorted(set(names) - torques.keys()):
            raise InputError(f"{field}: {unknown[0]!r} is not one of {', '.join(torques)}")
    compiled = spec.compile()
    data = mujoco.MjData(compiled)
    mujoco.mj_forward(compiled, data)
    changes, retracted_lengths = dict[str, Any](), dict[str, float | None]()
    for hinge, stated_torque in torques.items():
        half_range = _half_range(compiled, hinge)
        torque = _motor_torque(compiled, hinge) if stated_torque is None else stated_torque
        cylinder, bore = _size_cylinder(hinge, half_range, torque, parameters, arms.get(hinge))
        _remove_motors(spec, hinge)
        _add_tendon(spec, data, hinge, cylinder, -1.0 if hinge in against else 1.0)
        name = f"{hinge}_cylinder"
        lengths = {
            "bore_diameter": bore,
            "rod_diameter": bore / parameters.bore_diameter.si * parameters.rod_diameter.si,
            "half_stroke": (0.5 + _END_MARGIN) * cylinder.stroke,
        }
        origin = {"unit": "m", "status": "derived", "source": f"{torque:g} N m about {hinge}"}
        changes[name] = {field: {"value": length} | origin for field, length in lengths.items()}
        retracted_lengths[name] = (_RETRACTED_LENGTH - _END_MARGIN) * cylinder.stroke
    table = parameters.model_dump(exclude_none=True)
    table["actuators"] = merged(table["actuators"], changes, 1)
    changed = validated(HydraulicParameters, table, f"{parameters.name} on hinges")
    return attach_hydraulics(spec, retracted_lengths, changed, **options)


def _half_range(model: mujoco.MjModel, hinge: str) -> float:
    """Half of a hinge's range [rad]."""
    kind = mujoco.mjtJoint.mjJNT_HINGE
    names = [model.joint(i).name for i in range(model.njnt) if model.jnt_type[i] == kind]
    if hinge not in names:
        raise InputError(f"hinges: {hinge!r} is not one of the hinges {', '.join(names) or 'none'}")
    joint = model.joint(hinge)
    width = float(np.ptp(joint.range)) if model.jnt_limited[joint.id] else np.inf
    if not 0.0 < width <= _LARGEST_RANGE:
        raise InputError(
            f"{hinge}: a range of {np.rad2deg(width):.4g} deg is refused; allowed: above 0, up to "
            f"{np.rad2deg(_LARGEST_RANGE):.0f} deg"
        )
    if model.body_jntnum[joint.bodyid[0]] != 1:
        raise InputError(
            f"{hinge}: its body moves by other joints too; allowed: a body of its own for each"
        )
    return 0.5 * width


def _motor_torque(model: mujoco.MjModel, hinge: str) -> float:
    """Largest torque of a hinge's motors, or what the hinge lets through [N m]."""
    joint, torque = model.joint(hinge), 0.0
    is_driven = model.actuator_trnid[:, 0] == joint.id
    is_driven &= np.isin(model.actuator_trntype, _AT_JOINT)
    for index in np.flatnonzero(is_driven).tolist():
        motor, force = model.actuator(index), np.inf
        if model.actuator_ctrllimited[index] and not motor.biastype[0]:
            force = float(abs(motor.gainprm[0]) * np.abs(motor.ctrlrange).max())
        if model.actuator_forcelimited[index]:
            force = min(force, float(np.abs(motor.forcerange).max()))
        torque += force * float(abs(motor.gear[0]))
    if model.jnt_actfrclimited[joint.id]:
        torque = min(torque or np.inf, float(np.abs(model.jnt_actfrcrange[joint.id]).max()))
    if not 0.0 < torque < np.inf:
        raise InputError(f"{hinge}: has no motor of limited torque; allowed: a torque, in N m")
    return torque


def _size_cylinder(
    hinge: str, half_range: float, torque: float, base: HydraulicParameters, arm: float | None
) -> tuple[HingeCylinder, float]:
    """A cylinder for a torque [N m] over a range, and its bore [m]."""
    if not 0.0 < torque < np.inf:
        raise InputError(f"{hinge}: a torque of {torque} N m is refused; allowed: above 0")
    pressure = base.supply_pressure.si - base.return_pressure.si * base.cap_area / base.rod_area
    if pressure <= 0.0:
        raise InputError(f"return_pressure: {base.return_pressure} leaves the rod's side no force")
    # The bore with an arm of 1 m; at another its square goes with 1 / arm.
    unit_area = torque / (np.cos(half_range) * pressure)
    unit_bore = base.bore_diameter.si * float(np.sqrt(unit_area / base.rod_area))
    slenderness = np.array([_LEAST_SLENDER, SLENDERNESS, _MOST_SLENDER])
    arms = (slenderness * unit_bore / (2.0 * np.sin(half_range))) ** (2 / 3)
    shortest, default, longest = arms.tolist()
    arm = default if arm is None else arm
    if not shortest <= arm <= longest:
        raise InputError(
            f"arms: {hinge} {arm} m is refused: its cylinder would not have {_LEAST_SLENDER:g} to "
            f"{_MOST_SLENDER:g} bores in a stroke; allowed: {shortest:.4g} to {longest:.4g} m"
        )
    return HingeCylinder(half_range, arm), unit_bore / float(np.sqrt(arm))


def _remove_motors(spec: mujoco.MjSpec, hinge: str) -> None:
    """Take a hinge's motors away, and their controls out of the key frames."""
    is_removed = [motor.target == hinge and motor.trntype in _AT_JOINT for motor in spec.actuators]
    for key in spec.keys:
        if len(key.ctrl):
            key.ctrl = np.array(key.ctrl)[np.logical_not(is_removed)]
    for index in np.flatnonzero(is_removed)[::-1].tolist():
        spec.delete(spec.actuators[index])
    spec.joint(hinge).actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE


def _add_tendon(
    spec: mujoco.MjSpec, data: mujoco.MjData, hinge: str, cylinder: HingeCylinder, sense: float
) -> None:
    """Add the points of a cylinder, where they belong at `qpos0`, and the tendon between them."""
    joint, child = data.model.joint(hinge), spec.joint(hinge).parent
    axis, anchor, body = data.xaxis[joint.id], data.xanchor[joint.id], int(joint.bodyid[0])
    direction = data.xipos[body] - anchor
    direction = direction - axis * (axis @ direction)
    if np.linalg.norm(direction) < 1e-9:
        direction = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    direction = direction / np.linalg.norm(direction)
    to_middle = float(np.mean(joint.range)) - float(data.qpos[joint.qposadr[0]])
    turn = Rotation.from_rotvec(axis * (to_middle - sense * cylinder.middle))
    tendon_name, parent_name, child_name = f"{hinge}_cylinder", f"{hinge}_parent", f"{hinge}_child"
    for element in (spec.tendon(tendon_name), spec.site(parent_name), spec.site(child_name)):
        if element is not None:
            raise InputError(f"{hinge}: the name {element.name!r} is taken already; rename it")
    tendon = spec.add_tendon(name=tendon_name)

    def add_site(name: str, owner: mujoco.MjsBody, owner_id: int, arm: NDArray[np.float64]) -> None:
        axes = data.xmat[owner_id].reshape(3, 3)
        position = axes.T @ (anchor + arm - data.xpos[owner_id])
        tendon.wrap_site(owner.add_site(name=name, pos=position).name)

    parent = int(data.model.body_parentid[body])
    add_site(parent_name, child.parent, parent, cylinder.base * turn.apply(direction))
    add_site(child_name, child, body, cylinder.arm * direction)
