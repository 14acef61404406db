"""The cylinders of any model as a plugin of MuJoCo, beside plain MJCF that names it.

The model then runs wherever MuJoCo does, in its viewer and in `mujoco.rollout`: a control is the
valve command of a cylinder. All cylinders of a machine share one supply, so one instance of the
plugin drives them all; what moves in the hydraulics is MuJoCo's plugin state.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import SubElement

import mujoco
import numba
import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.errors import InputError
from cmf_mj.export.header import defines
from cmf_mj.export.library import Files, make, mujoco_files, sources
from cmf_mj.export.machine import make_image
from cmf_mj.export.machine_code import constant_data, machine_code
from cmf_mj.plant.attach import attach_hydraulics, equipped
from cmf_mj.plant.events import Faults, no_faults
from cmf_mj.plant.hydraulics import Hydraulics, HydraulicState, advance, loads
from cmf_mj.plant.parameters import HydraulicParameters
from cmf_mj.plant.plant import Plant


class Fixed(NamedTuple):
    """What stays."""

    hydraulics: Hydraulics
    faults: Faults
    neutral: NDArray[np.float64]


class Moving(NamedTuple):
    """What a step changes."""

    state: HydraulicState
    command: NDArray[np.float64]
    before: NDArray[np.float64]
    after: NDArray[np.float64]
    load: NDArray[np.float64]


class _Both(NamedTuple):
    fixed: Fixed
    moving: Moving


def push(parts, first, last):  # type: ignore[no-untyped-def]
    """Advance the hydraulics by a step, unless it is the first, and write the forces."""
    hydraulics, moving = parts.fixed.hydraulics, parts.moving
    state = moving.state
    if first > 0:
        if not advance(
            hydraulics, state, parts.fixed.faults, moving.command, moving.before, moving.after
        ):
            moving.load[:] = np.nan
            return
    loads(hydraulics.cylinder, state.pressure, state.friction, moving.load)


def export_plugin(
    model: Path,
    cylinders: Sequence[str] | Mapping[str, float | None],
    hydraulics: str | Path | HydraulicParameters,
    out: Path,
) -> list[Path]:
    """Write the cylinders of an MJCF file as a plugin, and the model with it; the files written.

    Arguments are those of `attach_hydraulics`; the folder has `libcmf_cylinders.so`, the MJCF named
    like the model, sources and licences. The plugin starts at rest as the model stands in `qpos0`.
    Raises `InputError` as `attach_hydraulics`, and where there is no C compiler.
    """
    plant = attach_hydraulics(model, cylinders, hydraulics)
    written = out / f"{plant.name}.xml"
    if written.exists() and written.samefile(model):
        raise InputError(f"out: {str(out)!r} is refused: {written.name} there is the model itself")
    if ElementTree.parse(model).getroot().find(".//include") is not None:
        one = "the whole in one file, as MjSpec.to_xml writes it"
        raise InputError(f"model: {str(model)!r} includes other files; allowed: {one}")
    spec = equipped(model, cylinders, hydraulics)[0]
    state, legs = plant.start(), plant.legs
    fixed = Fixed(plant.hydraulics, no_faults(legs), plant.neutral)
    moving = Moving(state, *np.zeros((4, legs)))
    images = [make_image(fixed), make_image(moving)]
    shift = images[0].slots.size
    pointers = [*images[0].pointers, *(shift + slot for slot in images[1].pointers)]
    slots = np.concatenate([image.slots for image in images])
    blocks = {
        "cmf_slots_data": np.frombuffer(slots.tobytes(), dtype=np.uint8),
        "cmf_fixed_data": images[0].block,
        "cmf_moving_data": images[1].block,
    }
    numbers = {
        "NAME": f'"{plant.name}"',
        "LEGS": legs,
        "STEP": repr(float(plant.model.opt.timestep)),
        "SLOTS": slots.size,
        "FIXED": images[0].block.size,
        "MOVING": images[1].block.size,
        "FIXED_POINTERS": len(images[0].pointers),
        "NEUTRAL": images[0].at["neutral"],
    }
    numbers |= {name.upper(): shift + images[1].at[name] for name in Moving._fields[1:]}
    places = f"static const int cmf_pointers[] = {{{', '.join(map(str, pointers))}}};\n"
    code = machine_code("cmf_push", push, numba.typeof(_Both(fixed, moving)))
    own: Files = {"cmf_cylinders.h": "\n".join([*defines("CMF", numbers), places])}
    own |= {"cmf_push.o": code, "cmf_data.o": constant_data(blocks)}
    own[written.name] = _mjcf(plant, model, spec)
    files = sources("plugin") | mujoco_files() | own
    return make(files, out, "libcmf_cylinders.so", ["cmf_cylinders.c"])


def _mjcf(plant: Plant, model: Path, equipment: mujoco.MjSpec) -> str:
    """The model's file with step, stops and plugin; MuJoCo's own writer keeps six digits only."""
    root, before = ElementTree.parse(model).getroot(), mujoco.MjSpec.from_file(str(model))
    name = f"cmf.cylinders.{plant.name}"
    extension = SubElement(root, "extension")
    SubElement(SubElement(extension, "plugin", plugin=name), "instance", name="cylinders")
    SubElement(root, "option", timestep=repr(float(plant.model.opt.timestep)))
    actuators = SubElement(root, "actuator")
    for cylinder in plant.actuators:
        kind = "joint" if before.joint(cylinder) else "tendon"
        how = {kind: cylinder, "plugin": name, "instance": "cylinders"}
        SubElement(actuators, "plugin", name=cylinder, **how)
        new, old = (getattr(spec, kind)(cylinder) for spec in (equipment, before))
        if np.array_equal(new.range, old.range):
            continue
        stops = {"range": new.range, "solreflimit": new.solref_limit}
        element = next(e for e in root.iter() if e.get("name") == cylinder and e.tag != "plugin")
        element.set("limited", "true")
        for attribute, values in stops.items():
            element.set(attribute, " ".join(map(repr, values.tolist())))
    return ElementTree.tostring(root, encoding="unicode")
