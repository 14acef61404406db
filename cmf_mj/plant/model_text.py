"""The MJCF of a machine in its hall with one of its cabs: drawn models, or generated ones.

A machine or cab without a drawn model has the shipped hexapod's in other sizes: joints, pins,
stops, sensors, solver and names are those of `models/cmf_hexapod.xml`; gimbals, neutral lengths,
stroke and masses are the machine's. What is drawn then is plain, in proportion to the legs.
"""

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from cmf_mj.machine import models
from cmf_mj.machine.cab import Cab
from cmf_mj.machine.geometry import FLIP
from cmf_mj.machine.machine import Machine, load_machine
from cmf_mj.machine.models import RigidBody, element_of, numbers_of

Element = ElementTree.Element

MACHINE_FILE, _CAB_FILE, _NO_CAB = "cmf_hexapod.xml", "cabs/gfd.xml", "cabs/none.xml"
"""Files that the scene includes."""
_DRAWING_TAGS = ("geom", "frame", "replicate")  #: What only draws.

_CAB = """
<mujoco model="cab">
  <compiler angle="radian" autolimits="true"/>
  <worldbody>
    <body name="cab">
      <inertial {inertial}/>
      <site name="crew" pos="{station}" group="4"/>
      <geom type="box" group="2" contype="0" conaffinity="0" mass="0" rgba="0.9 0.91 0.92 1"
        pos="{middle}" size="{size}"/>
    </body>
  </worldbody>
  <sensor><accelerometer name="crew_accelerometer" site="crew"/></sensor>
</mujoco>
"""


def model_texts(cab: Cab) -> tuple[str, dict[str, bytes]]:
    """The scene of a machine with one of its own cabs, z up, and the files that it includes."""
    machine, cab_file = cab.machine, cab.machine.cabs[cab.name].mjcf
    files = {
        MACHINE_FILE: Path(machine.mjcf).read_bytes() if machine.mjcf else _write_machine(cab),
        _CAB_FILE: Path(cab_file).read_bytes() if cab_file else _write_cab(cab),
        _NO_CAB: models.model_path(_NO_CAB).read_bytes(),
    }
    return _write_scene(machine), files


def with_floor(text: bytes) -> bytes:
    """The file of a machine with its legs on a body `floor` that slides in x, y and z."""
    root = ElementTree.fromstring(text)
    world = next(root.iter("worldbody"))
    floor = Element("body", name="floor")
    for name, axis in (("x", "1 0 0"), ("y", "0 1 0"), ("z", "0 0 1")):
        ElementTree.SubElement(floor, "joint", name=f"floor_{name}", type="slide", axis=axis)
    for leg in range(1, 7):
        cylinder = element_of(root, "body", f"cylinder_{leg}")
        world.remove(cylinder)
        floor.append(cylinder)
    world.append(floor)
    return ElementTree.tostring(root)


def _scale(machine: Machine) -> float:
    """Size of a machine, that of the CMF 1."""
    return float(machine.geometry.neutral.mean() / load_machine().geometry.neutral.mean())


def _write_scene(machine: Machine) -> str:
    """The hall, of a generated machine with floor, cameras and lights at its size."""
    text = models.model_path("scene.xml").read_text("utf-8")
    if machine.mjcf:
        return text
    root, scale = ElementTree.fromstring(text), _scale(machine)
    root.set("model", f"{machine.name} scene")
    for world in root.iter("worldbody"):
        for geom in world.findall("geom"):
            if geom.get("name") != "floor":
                world.remove(geom)
    for tag, name in (("camera", "pos"), ("light", "pos"), ("statistic", "center")):
        for element in root.iter(tag):
            _set(element, **{name: scale * np.array(numbers_of(element, name))})
    for statistic in root.iter("statistic"):
        _set(statistic, extent=scale * np.array(numbers_of(statistic, "extent")))
    _set(element_of(root, "geom", "floor"), pos=[0.0, 0.0, machine.floor_height])
    for key in root.iter("key"):
        key.attrib.pop("ctrl")
    return ElementTree.tostring(root, encoding="unicode")


def _write_machine(cab: Cab) -> bytes:
    """The shipped hexapod with geometry, masses and drawing of the machine of a cab."""
    machine, scale = cab.machine, _scale(cab.machine)
    root = ElementTree.parse(models.model_path(MACHINE_FILE)).getroot()
    root.set("model", machine.name)
    for parent in list(root.iter()):
        for child in list(parent):
            if parent.tag in ("worldbody", "body") and child.tag in _DRAWING_TAGS:
                parent.remove(child)
    half = machine.half_stroke
    for joint in root.iter("joint"):
        if joint.get("type") == "slide":
            _set(joint, range=[-half, half])
    upper, lower = machine.geometry.upper * FLIP, machine.geometry.lower * FLIP
    for leg in range(6):
        _set(element_of(root, "site", f"upper_{leg + 1}"), pos=upper[leg])
        _make_leg(root, machine, leg, scale)
    platform = element_of(root, "body", "platform")
    for start, end in zip(upper, np.roll(upper, -1, axis=0), strict=True):
        _add_geom(platform, "tube", size=[0.07 * scale], fromto=[*start, *end])
        _add_geom(platform, "tube", size=[0.05 * scale], fromto=[*start, 0.0, 0.0, 0.1 * scale])
    world = next(root.iter("worldbody"))
    for leg in range(6):
        foot = lower[leg] * [1.0, 1.0, 0.0] + [0.0, 0.0, machine.floor_height]
        _add_geom(world, "base", type="capsule", size=[0.16 * scale], fromto=[*foot, *lower[leg]])
    inertial = platform.find("inertial")
    assert inertial is not None
    inertial.attrib.clear()
    _set_inertia(inertial, cab.platform)
    return ElementTree.tostring(root)


def _make_leg(root: Element, machine: Machine, leg: int, scale: float) -> None:
    """Place, weigh and draw a cylinder and its rod."""
    geometry, design, retracted = machine.geometry, machine.legs, machine.retracted
    neutral = float(geometry.neutral[leg])
    lower, axis = geometry.lower[leg] * FLIP, (geometry.upper - geometry.lower)[leg] * FLIP
    cylinder = element_of(root, "body", f"cylinder_{leg + 1}")
    rod = element_of(root, "body", f"rod_{leg + 1}")
    _set(cylinder, pos=lower, zaxis=axis)
    centres = [
        0.5 * retracted if design.cylinder_centre is None else design.cylinder_centre.si,
        neutral - (0.5 * retracted if design.rod_centre is None else design.rod_centre.si),
    ]
    radius = retracted / 40.0
    for body, centre, mass in zip(
        (cylinder, rod), centres, (design.cylinder_mass.si, design.rod_mass.si), strict=True
    ):
        transverse = mass * (3.0 * radius**2 + retracted**2) / 12.0
        inertial = body.find("inertial")
        assert inertial is not None
        moments = [transverse, transverse, 0.5 * mass * radius**2]
        _set(inertial, pos=[0.0, 0.0, centre], mass=[mass], diaginertia=moments)
    _set(element_of(rod, "site", f"rod_end_{leg + 1}"), pos=[0.0, 0.0, neutral])
    accelerometer = neutral - machine.accelerometer_distance
    _set(element_of(rod, "site", f"rod_accelerometer_{leg + 1}"), pos=[0.0, 0.0, accelerometer])
    barrel, bar_radius = 0.105 * scale, 0.05 * scale
    top = neutral - machine.half_stroke - 0.1 * scale
    _add_geom(cylinder, "barrel", size=[barrel], fromto=[0, 0, 0, 0, 0, top])
    _add_geom(cylinder, "barrel", size=[1.3 * barrel], fromto=[0, 0, top - 0.1 * scale, 0, 0, top])
    _add_geom(rod, "rod", size=[bar_radius], fromto=[0, 0, 0.4 * neutral, 0, 0, neutral])
    _add_geom(rod, "visual", type="sphere", size=[2.0 * bar_radius], pos=[0, 0, neutral])


def _write_cab(cab: Cab) -> bytes:
    """A cab drawn as the homogeneous box of its inertia, cut to platform and upper gimbals."""
    moments = np.diag(cab.tensor)
    square = 6.0 * (moments.sum() - 2.0 * moments) / cab.mass.si
    half = 0.5 * np.sqrt(np.maximum(square, 1e-4))
    half[:2] = np.minimum(half[:2], np.abs(cab.machine.geometry.upper).max())
    if cab.centre_of_mass.si[2] > 0.0:
        half[2] = min(half[2], cab.centre_of_mass.si[2])
    inertial = Element("inertial")
    _set_inertia(inertial, cab)
    text = _CAB.format(
        inertial=" ".join(f'{name}="{value}"' for name, value in inertial.attrib.items()),
        station=_text(cab.station * FLIP),
        middle=_text(cab.centre_of_mass.si),
        size=_text(half),
    )
    return text.encode()


def _set_inertia(inertial: Element, part: RigidBody) -> None:
    tensor = part.tensor
    moments = np.diag(tensor)
    products = tensor[[0, 0, 1], [1, 2, 2]]
    _set(inertial, pos=part.centre_of_mass.si, mass=[part.mass.si])
    if products.any():
        _set(inertial, fullinertia=[*moments, *products])
    else:
        _set(inertial, diaginertia=moments)


def _add_geom(
    parent: Element, looks: str, type: str | None = None, **values: Iterable[float]
) -> None:  # noqa: A002
    """Add a geom of a class of the shipped model."""
    geom = ElementTree.SubElement(parent, "geom", {"class": looks})
    if type is not None:
        geom.set("type", type)
    _set(geom, **values)


def _set(element: Element, **values: ArrayLike | Iterable[float]) -> None:
    for name, numbers in values.items():
        element.set(name, _text(numbers))


def _text(numbers: ArrayLike | Iterable[float]) -> str:
    return " ".join(repr(float(number)) for number in np.atleast_1d(np.asarray(numbers)))
