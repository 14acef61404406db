"""Whether the numbers of a machine fit together: what `cmf machine check` reports.

closure        largest gap of a gimbal over poses of the envelope, the model put together there
envelope       single-axis excursions at which the first leg has used up its working stroke, and
its half stroke; operational and mechanical limits must lie within them
conditioning   condition number of J, its turning columns per mean radius of the upper gimbals,
at neutral and at worst over the envelope; a change of sign of det J between
neutral and a pose says that the legs pass a singular pose on the way
static loads   leg forces at rest, over the stall force of each cylinder, A_cap Ps - A_rod Pt
pushing and A_rod Ps - A_cap Pt pulling; raised by 1 + a/g, a the limit of heave
acceleration, they must stay below it
leg speed      with valves fully open under the static load, against the limit of leg
speed, and the heave speed amplitude whose mean flow is the pump's
clearance      least distance of two leg axes over the envelope, against the diameter of a rod
proportions    length of a leg over its stroke, and the upper gimbals' centroid from the origin
modes          hydraulic modes at neutral
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.analysis.modes import bound, envelope_poses
from cmf_mj.control.law import load_law
from cmf_mj.core import units
from cmf_mj.core.arrays import whole
from cmf_mj.core.errors import within
from cmf_mj.core.result import Field, Result, Table
from cmf_mj.machine.cab import load_cab
from cmf_mj.machine.geometry import DOFS, by_kind
from cmf_mj.machine.kinematics import excursion_envelope, leg_jacobian, rotation
from cmf_mj.machine.limits import MotionLimits
from cmf_mj.machine.machine import Machine
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.studies.asymptotes import asymptotes, full_speed, stall_forces

POSES, MOST_POSES = 200, 100_000  #: Poses of the envelope that are looked at, and at most.
POOR_CONDITION = 100.0  #: Condition number above which a pose is reported as nearly singular.
LONGEST_LEG = 15.0
"""Neutral length of a leg over its stroke above which a unit is wrong: a leg has at least 1.5
strokes, and the least slip, feet for inches, makes 18 of them."""
LARGEST_OFFSET = 0.01  #: Of the upper gimbals' centroid from the origin, over their radius.

_ROUNDING = 1e-6  #: Share of a reach by which a limit may be beyond it, for its digits.
_STATUS_TEXTS = {"recalled": "recalled from general knowledge, not checked"}  #: In the report.

Array = NDArray[np.float64]


class CabCheck(NamedTuple):
    """A machine with one of its cabs, at neutral."""

    cab: str
    mass: float  #: Of platform and cab [kg].
    load: Array  #: Static leg forces [N], (6,).
    share: float  #: Largest static leg force over the stall force of its cylinder in its direction.
    speed: Array  #: Leg speeds, valves fully open [m/s], (6, 2): out, in.
    sustained: float  #: Heave speed amplitude that the pump sustains [m/s].
    modes: Array  #: Hydraulic modes [Hz], (6,).


class MachineCheck(NamedTuple):
    """What is known of a machine, and what does not fit."""

    machine: Machine
    limits: MotionLimits
    envelope: Array  #: Single-axis excursions [m, rad], (6, 2).
    gap: float  #: Largest gap of a gimbal over the envelope [m].
    neutral_condition: float  #: Condition number at neutral.
    worst_condition: float  #: Largest condition number over the envelope.
    stall: Array  #: Least stall force of all cylinders, pushing and pulling [N], (2,).
    cabs: tuple[CabCheck, ...]
    statuses: dict[str, list[str]]  #: Fields of the file by status.
    faults: tuple[str, ...]  #: What does not fit, each with its reason.


CAB_FIELDS = (
    Field("cab"),
    Field("mass", "platform,\ncab [kg]", ".0f"),
    Field("load", "static\nload [kN]", ".2f", "kN", of=lambda row: float(np.abs(row.load).max())),
    Field("share", "of a leg's\nforce", ".0f %", "%"),
    Field("speed", "leg speed\n[m/s]", ".3f", of=lambda row: float(row.speed.min())),
    Field("sustained", "heave sus-\ntained [m/s]", ".3f"),
    Field("modes", "modes [Hz]", lambda modes: " ".join(f"{mode:.1f}" for mode in modes)),
)


def report_parts(check: MachineCheck) -> list[Table | Result[CabCheck] | str]:
    """The report: limits of each degree of freedom, each cab on its legs, and the rest in lines."""
    rows = []
    for dof, reach, limits in zip(DOFS, check.envelope, check.limits.axes, strict=True):
        unit = by_kind(dof, "m", "deg")
        ends = (units.from_si(unit, end) for end in (*reach, *limits.operational.si))
        speed = units.from_si(unit, limits.velocity.si)
        rows.append((dof, *ends, limits.operational.status, speed, f"{unit}, {unit}/s"))
    end_columns = ((name, ".3f") for name in ("legs reach from", "to", "limit from", "to "))
    columns = ("dof", *end_columns, "status", ("largest rate", ".3g"), "units")
    push, pull = 1e-3 * check.stall
    neutral = check.machine.geometry.neutral
    return [
        Table(f"{check.machine.name}: envelope", columns, rows),
        Result(
            check.cabs, CAB_FIELDS, f"cabs: cylinders stall at {push:.1f} kN out, {pull:.1f} kN in"
        ),
        f"neutral legs {neutral.min():.4f} to {neutral.max():.4f} m from gimbal to gimbal",
        f"gimbals closed within {1e9 * check.gap:.3g} nm over the envelope",
        f"condition number {check.neutral_condition:.2f} at neutral, "
        f"{check.worst_condition:.2f} at worst over the envelope",
        *(
            f"{_STATUS_TEXTS.get(status, status)}: {', '.join(names)}"
            for status, names in check.statuses.items()
        ),
        *(f"does not fit: {fault}" for fault in check.faults),
        f"verdict: {check.machine.name} "
        + (f"has {len(check.faults)} faults" if check.faults else "fits together"),
    ]


def check_machine(machine: Machine, *, poses: int = POSES) -> MachineCheck:
    """Look at a machine with all its cabs.

    Raises `InputError` for one that cannot be built, or with a cab that cannot be held at neutral.
    """
    whole("poses", poses, 1, MOST_POSES)
    plants = [Hexapod(load_cab(name, machine)) for name in machine.cabs]
    plant, *_ = plants
    bound(load_law(machine.law), plant.law_key)
    limits = load_motion_limits(None, machine)
    cabs = tuple(map(_check_cab, plants))
    radius = float(np.linalg.norm(machine.geometry.upper[:, :2], axis=1).mean())
    envelope = envelope_poses(plant, poses)
    conditions, gap, singular_pose = _check_envelope(plant, envelope, radius)
    faults = [fault for cab in cabs for fault in _cab_faults(cab, limits)]
    if singular_pose is not None:
        faults.append(
            f"legs.working_stroke: reaches across a singular pose, at {_pose_text(singular_pose)}; "
            "allowed: a stroke that keeps det J of the sign it has at neutral"
        )
    worst = int(np.argmax(conditions))
    if conditions[worst] > POOR_CONDITION and not faults:
        faults.append(
            f"legs.working_stroke: condition number {conditions[worst]:.3g} at "
            f"{_pose_text(envelope[worst])}; allowed: below {POOR_CONDITION:g}"
        )
    faults += _proportion_faults(machine, radius)
    faults += _displacement_faults(machine, limits)
    rod = plant.parameters.rod_diameter.si
    clearance, (first, second), closest = _clearance(machine, envelope)
    if clearance < rod:
        faults.append(
            f"gimbals: the axes of legs {first} and {second} come within {clearance:.3g} m of each "
            f"other at {_pose_text(closest)}; allowed: at least a rod's diameter, {rod:.3g} m"
        )
    return MachineCheck(
        machine=machine,
        limits=limits,
        envelope=excursion_envelope(None, machine),
        gap=gap,
        neutral_condition=conditions[0],
        worst_condition=conditions[worst],
        stall=stall_forces(plant.hydraulics).min(axis=0),
        cabs=cabs,
        statuses=_names_by_status(machine),
        faults=tuple(faults),
    )


def _check_envelope(
    plant: Hexapod, poses: Array, radius: float
) -> tuple[list[float], float, Array | None]:
    """Condition numbers, largest gap of a gimbal [m], and the first pose past a singular one."""
    conditions, gaps, neutral_sign = list[float](), list[float](), 0.0
    for pose in poses:
        jacobian = leg_jacobian(pose, plant.machine)
        jacobian[:, 3:] /= radius
        conditions.append(float(np.linalg.cond(jacobian)))
        sign = float(np.sign(np.linalg.det(jacobian)))
        neutral_sign = neutral_sign or sign
        if sign != neutral_sign:
            return conditions, max(gaps), pose
        plant.place(pose)
        sites = plant.data.site_xpos[plant.gimbal_sites]
        gaps.append(float(np.linalg.norm(sites[:, 0] - sites[:, 1], axis=1).max()))
    return conditions, max(gaps), None


def _check_cab(plant: Hexapod) -> CabCheck:
    with within(f"cabs.{plant.cab}"):
        plant.start()
    assert plant.cab_parameters is not None
    load, supply = plant.static_load(), plant.hydraulics.supply
    push, pull = stall_forces(plant.hydraulics).T
    return CabCheck(
        cab=plant.cab,
        mass=plant.cab_parameters.payload.mass,
        load=load,
        share=float(np.maximum(load / push, -load / pull).max()),
        speed=full_speed(plant.hydraulics, load, supply.pressure, supply.return_pressure),
        sustained=asymptotes(plant, "heave").pump_flow,
        modes=plant.hydraulic_modes().frequency_hz,
    )


def _cab_faults(cab: CabCheck, limits: MotionLimits) -> Iterator[str]:
    heave = limits.axes[DOFS.index("heave")].acceleration.si
    largest_share = 1.0 / (1.0 + heave / units.STANDARD_GRAVITY)
    if cab.share > largest_share:
        yield (
            f"cabs.{cab.cab}: its static load is {cab.share:.0%} of a leg's force at the supply's "
            f"pressure; allowed: up to {largest_share:.0%}, which leaves what "
            "limits.heave.acceleration asks for"
        )
    leg_speed = limits.leg.velocity.si
    if cab.speed.min() < leg_speed:
        yield (
            f"cabs.{cab.cab}: valves fully open give a leg {cab.speed.min():.4g} m/s under its "
            f"static load; limits.leg.velocity asks for {leg_speed:.4g} m/s; allowed: at most what "
            "the valves give"
        )


def _proportion_faults(machine: Machine, radius: float) -> Iterator[str]:
    """Proportions of gimbals and strokes that only a slip of units or of the origin makes."""
    length, stroke = float(machine.geometry.neutral.max()), 2.0 * machine.half_stroke
    if length > LONGEST_LEG * stroke:
        yield (
            f"legs.half_stroke: legs of {length:.4g} m for a stroke of {stroke:.4g} m; allowed: "
            f"up to {LONGEST_LEG:g} times the stroke"
        )
    offset = float(np.linalg.norm(machine.geometry.upper.mean(axis=0)))
    if offset > LARGEST_OFFSET * radius:
        yield (
            f"gimbals: the upper gimbals' centroid is {offset:.3g} m from the origin "
            f"of all coordinates; allowed: up to {LARGEST_OFFSET * radius:.3g} m, for it is the "
            "origin"
        )


def _displacement_faults(machine: Machine, limits: MotionLimits) -> Iterator[str]:
    """Limits of displacement that the legs do not reach from neutral, one axis at a time."""
    for kind, field in (("operational", "working_stroke"), ("mechanical", "half_stroke")):
        envelope = excursion_envelope(getattr(machine, field), machine)
        for dof, ends, reach in zip(DOFS, getattr(limits, kind), envelope, strict=True):
            unit = by_kind(dof, "m", "deg")
            low, high = (units.from_si(unit, end) for end in ends)
            lowest, highest = (units.from_si(unit, end) for end in reach)
            if low < lowest - _ROUNDING * abs(lowest) or high > highest + _ROUNDING * highest:
                yield (
                    f"limits.{dof}.{kind}: {low:.4g} to {high:.4g} {unit}; allowed: within "
                    f"{lowest:.4g} to {highest:.4g} {unit}, where legs.{field} ends"
                )


def _clearance(machine: Machine, poses: Array) -> tuple[float, tuple[int, int], Array]:
    """Least distance of two leg axes [m] over poses (N, 6), which legs, from 1, and the pose.

    Legs are segments, see C. Ericson, Real-Time Collision Detection, 2005, section 5.1.9.
    """
    upper, lower = machine.geometry.upper, machine.geometry.lower
    offsets = np.array([rotation(*pose[3:]) @ upper.T for pose in poses]).transpose(0, 2, 1)
    legs = poses[:, None, :3] + offsets - lower  # from the lower gimbal up, (N, 6, 3)
    i, j = np.triu_indices(6, 1)
    first, second, between = legs[:, i], legs[:, j], lower[i] - lower[j]
    a, b = (first * first).sum(axis=-1), (first * second).sum(axis=-1)
    c, e = (first * between).sum(axis=-1), (second * second).sum(axis=-1)
    f = (second * between).sum(axis=-1)
    s = np.clip((b * f - c * e) / np.maximum(a * e - b * b, 1e-12 * a * e), 0.0, 1.0)
    t = np.clip((b * s + f) / e, 0.0, 1.0)
    s = np.clip((b * t - c) / a, 0.0, 1.0)
    distance = np.linalg.norm(between + s[..., None] * first - t[..., None] * second, axis=-1)
    row, pair = np.unravel_index(int(distance.argmin()), distance.shape)
    return float(distance[row, pair]), (int(i[pair]) + 1, int(j[pair]) + 1), poses[row]


def _pose_text(pose: Array) -> str:
    position, angles = pose[:3], np.degrees(pose[3:])
    texts = (" ".join(f"{value:.3g}" for value in values) for values in (position, angles))
    return "{} m, {} deg".format(*texts)


def _names_by_status(machine: Machine) -> dict[str, list[str]]:
    """Fields of a machine's own table by status, in order."""
    fields: dict[str, list[str]] = {}

    def walk(table: dict[str, Any], path: tuple[str, ...]) -> None:
        if "status" in table:
            fields.setdefault(str(table["status"]), []).append(".".join(path))
            return
        for name, entry in table.items():
            if isinstance(entry, dict):
                walk(entry, (*path, name))

    walk(machine.model_dump(mode="json", exclude_none=True), ())
    return fields
