"""Hydraulics for any MuJoCo model: cylinders on named slide joints or tendons of an MJCF.

A cylinder's length l is the position of its slide joint or the length of its tendon, and

    extension = l - (retracted length + half stroke)

so that a machine may start with its cylinders anywhere in their stroke. The retracted length is
given, or follows from a range [a, b] of the joint or tendon: (a + b) / 2 is then half stroke. The
range is the machine's own stops and must lie within the cylinder's; a joint or tendon without one
gets the cylinder's stroke as its range.

Bores, strokes, valves, hoses and the supply come from the parameter set, where the table
`actuators` gives each cylinder, by the name of its joint or tendon, what differs.
"""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np

from cmf_mj.core.errors import InputError
from cmf_mj.core.settings import checked_name
from cmf_mj.core.units import FRAME
from cmf_mj.plant.parameters import HydraulicParameters, load_hydraulics
from cmf_mj.plant.plant import Plant, set_timestep

_STOP_TIME = 0.01  #: Time constant of the stops given to joints and tendons without a range [s].

_TOLERANCE = 1e-9  #: Lengths this close are equal [m].


def attach_hydraulics(
    model: str | Path | mujoco.MjSpec,
    cylinders: Sequence[str] | Mapping[str, float | None],
    hydraulics: str | Path | HydraulicParameters = "hardware",
    *,
    payload: Sequence[str] = (),
    timestep: float = FRAME,
) -> Plant:
    """Drive slide joints or tendons of a MuJoCo model by hydraulic cylinders.

    Args:
        model: path of an MJCF file, or an `MjSpec`, which is left as it is.
        cylinders: names of the slide joints or tendons, or a mapping from them to the length at
            which the cylinder is fully retracted [m], None for the middle of the range at half
            stroke. Their order is that of all arrays with a leg axis.
        hydraulics: `report`, `hardware`, `lossy`, a TOML file or a loaded set.
        payload: names of the bodies an `overload` rests on.
        timestep: mechanical step [s], in place of the model's own; divides 1/2048 s.

    Returns:
        A `Plant` for `simulate(..., legs=True)` and `drive`, named like the model. It starts in
        the model's `qpos0`; `Plant.configuration` finds others.

    >>> press = mujoco.MjSpec()
    >>> load = press.worldbody.add_body(name="load", mass=2e3, inertia=[1, 1, 1])
    >>> load.explicitinertial = True
    >>> _ = load.add_joint(name="lift", type=mujoco.mjtJoint.mjJNT_SLIDE, range=[-0.5, 0.5])
    >>> cmf_mj.attach_hydraulics(press, ["lift"]).legs
    1
    """
    spec, parameters = load_spec(model), load_hydraulics(hydraulics)
    if isinstance(cylinders, str) or not isinstance(cylinders, Collection) or not cylinders:
        raise InputError(f"cylinders: {cylinders!r} names no joints or tendons; allowed: a list")
    lengths = dict(cylinders) if isinstance(cylinders, Mapping) else dict.fromkeys(cylinders)
    set_timestep(spec.option, timestep)
    if spec.option.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        raise InputError(
            "integrator: RK4 cannot take its step in two halves; use Euler or implicitfast"
        )
    neutral = [_add_motor(spec, name, length, parameters) for name, length in lengths.items()]
    for name in payload:
        if spec.body(name) is None:
            raise InputError(f"payload: {name!r} is not one of {_names(spec.bodies)}")
    plant = Plant(
        spec.compile(), parameters, motors=list(lengths), payload=payload, neutral=neutral
    )
    plant.name = checked_name(spec.modelname, "model: name")
    half = plant.hydraulics.cylinder.half_stroke
    extensions = plant.extensions()
    for leg in np.flatnonzero(np.abs(extensions) > half + _TOLERANCE):
        neutral_length = plant.neutral[leg]
        raise InputError(
            f"cylinders: {plant.actuators[leg]!r} starts at a length of "
            f"{neutral_length + extensions[leg]:.4f} m; allowed: "
            f"{neutral_length - half[leg]:.4f} to {neutral_length + half[leg]:.4f} m"
        )
    return plant


def load_spec(model: str | Path | mujoco.MjSpec) -> mujoco.MjSpec:
    """A copy of an editable model, or the model of a file."""
    try:
        if not isinstance(model, mujoco.MjSpec):
            return mujoco.MjSpec.from_file(str(model))
    except (ValueError, OSError) as error:
        raise InputError(f"model: {model} cannot be read: {error}") from None
    return model.copy()


def _add_motor(
    spec: mujoco.MjSpec, name: str, retracted: float | None, parameters: HydraulicParameters
) -> float:
    """Add a motor, 0 in key frames, and stops to a joint or tendon; its length at half stroke."""
    joint, tendon = spec.joint(name), spec.tendon(name)
    if joint is not None and tendon is not None:
        raise InputError(f"cylinders: {name!r} is a joint and a tendon; rename one")
    element = joint if tendon is None else tendon
    if element is None:
        slides = [slide for slide in spec.joints if slide.type == mujoco.mjtJoint.mjJNT_SLIDE]
        raise InputError(
            f"cylinders: {name!r} is not one of the slide joints ({_names(slides)}) or tendons "
            f"({_names(spec.tendons)})"
        )
    if tendon is None and joint.type != mujoco.mjtJoint.mjJNT_SLIDE:
        kind = joint.type.name.removeprefix("mjJNT_").lower()
        raise InputError(
            f"cylinders: {name!r} is a {kind} joint; a cylinder needs a slide joint or a tendon"
        )
    transmissions = [mujoco.mjtTrn.mjTRN_TENDON]
    if tendon is None:
        transmissions = [mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT]
    for actuator in spec.actuators:
        if actuator.target == name and actuator.trntype in transmissions:
            raise InputError(
                f"cylinders: {name!r} has the actuator {actuator.name!r} already; remove it"
            )
        if actuator.name == name:
            raise InputError(f"cylinders: an actuator is already named {name!r}; rename it")
    motor = spec.add_actuator(name=name, target=name, trntype=transmissions[0])
    motor.set_to_motor()
    # The model's defaults for actuators may say otherwise.
    motor.gear = np.eye(6)[0]
    motor.ctrllimited = motor.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE
    for key in spec.keys:
        if len(key.ctrl):
            key.ctrl = [*key.ctrl, 0.0]
    half = parameters.actuator(name)["half_stroke"].si
    return _set_stops(element, name, retracted, half)


def _set_stops(
    element: mujoco.MjsJoint | mujoco.MjsTendon, name: str, retracted: float | None, half: float
) -> float:
    """Check a range against the stroke, or make it the stroke; the length at half stroke [m]."""
    low, high = (float(end) for end in element.range)
    has_range = low < high and element.limited != mujoco.mjtLimited.mjLIMITED_FALSE
    if retracted is None:
        if not has_range:
            raise InputError(
                f"cylinders: {name!r} has no range; give the cylinder's retracted length, "
                f"{{{name!r}: length in m}}"
            )
        neutral = 0.5 * (low + high)
    else:
        neutral = retracted + half
    if not np.isfinite(neutral):
        raise InputError(f"cylinders: {name!r}: {retracted} m must be a finite retracted length")
    shortest, longest = neutral - half, neutral + half
    if not has_range:
        element.range = np.array([shortest, longest])
        element.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        element.solref_limit[:] = (_STOP_TIME, 1.0)
    elif low < shortest - _TOLERANCE or high > longest + _TOLERANCE:
        raise InputError(
            f"cylinders: {name!r} ranges from {low:.4f} to {high:.4f} m, its cylinder with half a "
            f"stroke of {half:.4f} m from {shortest:.4f} to {longest:.4f} m only"
        )
    return neutral


def _names(elements: Sequence[object]) -> str:
    names = [str(element.name) for element in elements if element.name]  # type: ignore[attr-defined]
    return ", ".join(sorted(names)) or "none"
