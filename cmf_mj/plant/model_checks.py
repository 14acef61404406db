"""Checks that a MuJoCo model fits its hydraulics, the kinematics and the cab that it carries.

Control law and kinematics count with gimbals, neutral lengths and strokes of their own copy, and a
record states the masses of a cab. A model that differs would run, and the numbers would be of
neither machine. Each function raises an `InputError` with both values.
"""

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.core.errors import InputError
from cmf_mj.machine.cab import Cab
from cmf_mj.machine.geometry import FLIP, Geometry
from cmf_mj.machine.models import Payload

ROUND_OFF = 1e-9  #: Values this close are the same [m, kg, kg m^2], in proportion where above 1.
LARGEST_GAP = 1e-6  #: Of a closed loop at the start [m]; shipped models close to 1e-12 m.
_LEGS = range(1, 7)


def check_motor(model: mujoco.MjModel, name: str) -> None:
    """Refuse an actuator whose force is not its control, or that turns."""
    actuator = model.actuator(name)
    transmission, target = actuator.trntype[0], actuator.trnid[0]
    on_tendon = transmission == mujoco.mjtTrn.mjTRN_TENDON
    on_joint = transmission == mujoco.mjtTrn.mjTRN_JOINT
    if not on_tendon and not (on_joint and model.jnt_type[target] == mujoco.mjtJoint.mjJNT_SLIDE):
        raise InputError(f"motors: {name!r} must drive a slide joint or a tendon")
    is_static = actuator.dyntype[0] == mujoco.mjtDyn.mjDYN_NONE
    has_gain = actuator.gaintype[0] == mujoco.mjtGain.mjGAIN_FIXED and actuator.gainprm[0] == 1.0
    if not (is_static and has_gain and actuator.biastype[0] == mujoco.mjtBias.mjBIAS_NONE):
        raise InputError(f"motors: {name!r} must be a plain motor, force = ctrl")
    if actuator.gear[0] != 1.0 or actuator.ctrllimited[0]:
        raise InputError(f"motors: {name!r} must have gear 1 and no ctrlrange")
    limits = model.tendon_actfrclimited if on_tendon else model.jnt_actfrclimited
    if actuator.forcelimited[0] or limits[target]:
        raise InputError(f"motors: {name!r} must have no forcerange and no actuatorfrcrange")


def check_stops(
    model: mujoco.MjModel,
    motors: Sequence[str],
    neutral: NDArray[np.float64],
    half_stroke: NDArray[np.float64],
    hydraulics: str,
    *,
    equal: bool,
) -> None:
    """Compare the stops of each motor's joint or tendon with its cylinder.

    They must lie within neutral +- half stroke [m], (n,), or be its ends where `equal`. A joint or
    tendon without range has no stops: a run ends where it leaves the stroke.
    """
    for name, middle, half in zip(motors, neutral, half_stroke, strict=True):
        actuator = model.actuator(name)
        target = actuator.trnid[0]
        if actuator.trntype[0] == mujoco.mjtTrn.mjTRN_TENDON:
            has_stops, ends = model.tendon_limited[target], model.tendon_range[target]
        else:
            has_stops, ends = model.jnt_limited[target], model.jnt_range[target]
        low, high = ends - middle
        excess = (abs(low + half), abs(high - half)) if equal else (-half - low, high - half)
        if has_stops and not np.max(excess) <= ROUND_OFF:
            raise InputError(
                f"half_stroke: set {hydraulics!r} gives {name} +-{half:.6g} m, the model stops it "
                f"at {low:.6g} and {high:.6g} m from neutral; allowed: "
                f"{'both the same' if equal else 'stops within the stroke'}"
            )


def check_closed(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Refuse a configuration in which a closed loop (an equality constraint) is open."""
    is_loop = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
    gaps = np.where(is_loop, np.abs(data.efc_pos), 0.0)
    if gaps.size and not gaps.max() <= LARGEST_GAP:
        row = int(gaps.argmax())
        name = model.eq(int(data.efc_id[row])).name
        raise InputError(
            f"start: the loop {name!r} is open by {gaps[row]:.3g} m; allowed: {LARGEST_GAP:g} m; "
            "`Plant.configuration` closes it"
        )


def check_hexapod(model: mujoco.MjModel, data: mujoco.MjData, geometry: Geometry, cab: Cab) -> None:
    """Compare gimbals, pins, leg axes and masses, all at `qpos0`, with kinematics and cab."""
    _check_geometry(model, data, geometry)
    _check_pins(model)
    _check_masses(model, data, cab)


def _ids(model: mujoco.MjModel, element: str, name: str) -> list[int]:
    """Ids of an element of all legs, whose numbers fill the gap of its name."""
    return [_id(model, element, name.format(leg)) for leg in _LEGS]


def _id(model: mujoco.MjModel, element: str, name: str) -> int:
    try:
        return int(getattr(model, element)(name).id)
    except KeyError:
        raise InputError(
            f"spec: has no {element} {name!r}; allowed: the names of the shipped model"
        ) from None


def _check_geometry(model: mujoco.MjModel, data: mujoco.MjData, geometry: Geometry) -> None:
    """Compare gimbals and leg axes with the kinematics."""
    upper, lower = geometry.upper * FLIP, geometry.lower * FLIP
    upper_sites, rod_ends = _ids(model, "site", "upper_{}"), _ids(model, "site", "rod_end_{}")
    cylinders, slides = _ids(model, "body", "cylinder_{}"), _ids(model, "joint", "leg_{}")
    x_joints, y_joints = (_ids(model, "joint", f"gimbal_{{}}_{axis}") for axis in "xy")
    axes = (upper - lower) / geometry.neutral[:, None]
    _check_vectors("upper gimbal {} on the platform", model.site_pos[upper_sites], upper)
    _check_vectors("lower gimbal {}", data.xpos[cylinders], lower)
    _check_vectors("joint gimbal_{}_x", data.xanchor[x_joints], lower)
    _check_vectors("joint gimbal_{}_y", data.xanchor[y_joints], lower)
    _check_vectors("upper gimbal {} at neutral", data.site_xpos[upper_sites], upper)
    _check_vectors("rod end {} at neutral", data.site_xpos[rod_ends], upper)
    _check_vectors("axis of leg {} at neutral", data.xaxis[slides], axes, unit="")


def _check_vectors(
    part: str, actual: NDArray[np.float64], expected: NDArray[np.float64], unit: str = " m"
) -> None:
    """Compare a vector of each leg, (6, 3), with that of the kinematics."""
    for leg in np.flatnonzero(~(np.abs(actual - expected).max(axis=1) <= ROUND_OFF)).tolist():
        raise InputError(
            f"spec: {part.format(leg + 1)} is {_text(actual[leg])}{unit} in the "
            f"model, {_text(expected[leg])}{unit} in the kinematics; allowed: both the same"
        )


def _check_pins(model: mujoco.MjModel) -> None:
    """Refuse a rod that no active pin ties to the platform."""
    pins_are_off = model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_EQUALITY
    for leg in _LEGS:
        pin = _id(model, "equality", f"gimbal_{leg}")
        sites = {_id(model, "site", f"upper_{leg}"), _id(model, "site", f"rod_end_{leg}")}
        ends = {int(model.eq_obj1id[pin]), int(model.eq_obj2id[pin])}
        if pins_are_off or not model.eq_active0[pin] or ends != sites:
            raise InputError(
                f"spec: gimbal_{leg} does not pin the rod to the platform; allowed: an active "
                f"connect constraint of the sites rod_end_{leg} and upper_{leg}"
            )


def _check_masses(model: mujoco.MjModel, data: mujoco.MjData, cab: Cab) -> None:
    """Compare the masses of platform, legs and cab with those of the cab's file."""
    is_carried = model.body_rootid == _id(model, "body", "platform")
    turns = data.ximat[is_carried].reshape(-1, 3, 3)
    tensors = (turns * model.body_inertia[is_carried, None]) @ turns.transpose(0, 2, 1)
    payload = Payload.of(model.body_mass[is_carried], data.xipos[is_carried], tensors)
    _check_mass("mass of platform and cab", payload.mass, cab.payload.mass, "kg", cab)
    _check_mass("centre of mass of platform and cab", payload.centre, cab.payload.centre, "m", cab)
    _check_mass("inertia of platform and cab", payload.inertia, cab.payload.inertia, "kg m^2", cab)
    for part, mass in (("cylinder", cab.legs.cylinder_mass.si), ("rod", cab.legs.rod_mass.si)):
        for leg in _LEGS:
            body = _id(model, "body", f"{part}_{leg}")
            _check_mass(f"mass of {part}_{leg}", model.body_mass[body], mass, "kg", cab)


def _check_mass(part: str, actual: ArrayLike, stated: ArrayLike, unit: str, cab: Cab) -> None:
    difference = np.max(np.abs(np.subtract(actual, stated)))
    if not difference <= ROUND_OFF * max(1.0, np.max(np.abs(stated))):
        raise InputError(
            f"cab: {part} is {_text(actual)} {unit} in the model, {_text(stated)} {unit} in "
            f"{cab.name!r}; allowed: both the same; other masses are a cab of their own"
        )


def _text(values: ArrayLike) -> str:
    """Numbers for a message, to the micrometre."""
    return " ".join(np.array2string(np.asarray(values), precision=6, suppress_small=True).split())
