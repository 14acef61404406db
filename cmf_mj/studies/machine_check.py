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
reach          leg speed with valves fully open under the static load, against the limit of leg
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

POOR = 100.0  #: Condition number above which a pose is reported as nearly singular.


LONG = 15.0
"""Neutral length of a leg over its stroke above which a unit is wrong: a leg has at least 1.5
strokes, and the least slip, feet for inches, makes 18 of them."""

APART = 0.01
"""Distance of the upper gimbals' centroid from the origin, over their radius, that is none."""


_ROUND = 1e-6  #: Share of a reach by which a limit may be beyond it, for its digits.

_MEANT = {"recalled": "recalled from general knowledge, not checked"}
"""Statuses that need a word more, see `core.quantity`."""


class CabCheck(NamedTuple):
    """A machine with one of its cabs, at neutral."""

    cab: str
    mass: float  #: Of platform and cab [kg].
    load: NDArray[np.float64]  #: Static leg forces [N], (6,).
    share: float  #: Largest of them over the force of its cylinder that way.
    speed: NDArray[np.float64]  #: Leg speeds, valves fully open [m/s], (6, 2): out, in.
    sustained: float  #: Heave speed amplitude that the pump sustains [m/s].
    modes: NDArray[np.float64]  #: Hydraulic modes [Hz], (6,).


class MachineCheck(NamedTuple):
    """What is known of a machine, and what does not fit."""

    machine: Machine
    limits: MotionLimits
    envelope: NDArray[np.float64]  #: Single-axis excursions [m, rad], (6, 2).
    gap: float  #: Largest gap of a gimbal over the envelope [m].
    conditioning: tuple[float, float]  #: At neutral, at worst over the envelope.
    stall: NDArray[np.float64]  #: Least force of all cylinders pushing and pulling [N], (2,).
    cabs: tuple[CabCheck, ...]
    statuses: dict[str, list[str]]  #: Fields of the file by status.
    faults: tuple[str, ...]  #: What does not fit, each with its reason.


CABS = (
    Field("cab"),
    Field("mass", "platform,\ncab [kg]", ".0f"),
    Field("load", "static\nload [kN]", ".2f", "kN", of=lambda one: float(np.abs(one.load).max())),
    Field("share", "of a leg's\nforce", ".0f %", "%"),
    Field("speed", "leg speed\n[m/s]", ".3f", of=lambda one: float(one.speed.min())),
    Field("sustained", "heave sus-\ntained [m/s]", ".3f"),
    Field("modes", "modes [Hz]", lambda modes: " ".join(f"{mode:.1f}" for mode in modes)),
)


def check_parts(check: MachineCheck) -> list[Table | Result[CabCheck] | str]:
    """The report: limits of each degree of freedom, each cab on its legs, and the rest in lines."""
    rows = []
    for dof, reach, axis in zip(DOFS, check.envelope, check.limits.axes, strict=True):
        unit = by_kind(dof, "m", "deg")
        ends = (units.from_si(unit, end) for end in (*reach, *axis.operational.si))
        speed = units.from_si(unit, axis.velocity.si)
        rows.append((dof, *ends, axis.operational.status, speed, f"{unit}, {unit}/s"))
    ends_of = ((name, ".3f") for name in ("legs reach from", "to", "limit from", "to "))
    columns = ("dof", *ends_of, "status", ("largest rate", ".3g"), "units")
    push, pull = (1e-3 * force for force in check.stall)
    stalled = f"cabs: cylinders stall at {push:.1f} kN out, {pull:.1f} kN in"
    neutral = check.machine.geometry.neutral
    return [
        Table(f"{check.machine.name}: envelope", columns, rows),
        Result(check.cabs, CABS, stalled),
        f"neutral legs {neutral.min():.4f} to {neutral.max():.4f} m from gimbal to gimbal",
        f"gimbals closed within {1e9 * check.gap:.3g} nm over the envelope",
        f"condition number {check.conditioning[0]:.2f} at neutral, {check.conditioning[1]:.2f} at "
        "worst over the envelope",
        *(
            f"{_MEANT.get(status, status)}: {', '.join(names)}"
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
    bound(load_law(machine.law), plants[0].law_key)
    limits = load_motion_limits(None, machine)
    faults: list[str] = []
    cabs = tuple(_cab(plant, limits, faults) for plant in plants)
    plant = plants[0]
    radius = float(np.linalg.norm(machine.geometry.upper[:, :2], axis=1).mean())
    looked_at = envelope_poses(plant, poses)
    conditions, gaps, sense = [], [], 0.0
    for pose in looked_at:
        jacobian = leg_jacobian(pose, machine)
        jacobian[:, 3:] /= radius
        conditions.append(float(np.linalg.cond(jacobian)))
        sign = float(np.sign(np.linalg.det(jacobian)))
        sense = sense or sign
        if sign != sense:
            faults.append(
                f"legs.working_stroke: reaches across a singular pose, at {_pose(pose)}; allowed: "
                "a stroke that keeps det J of the sign it has at neutral"
            )
            break
        plant.place(pose)
        sites = plant.data.site_xpos[plant.gimbal_sites]
        gaps.append(float(np.linalg.norm(sites[:, 0] - sites[:, 1], axis=1).max()))
    worst = int(np.argmax(conditions))
    if conditions[worst] > POOR and not faults:
        faults.append(
            f"legs.working_stroke: condition number {conditions[worst]:.3g} at "
            f"{_pose(looked_at[worst])}; allowed: below {POOR:g}"
        )
    faults += _proportions(machine, radius)
    faults += _beyond_reach(machine, limits)
    rod = plant.parameters.rod_diameter.si
    clear, first, last, where = _clearance(machine, looked_at)
    if clear < rod:
        faults.append(
            f"gimbals: the axes of legs {first} and {last} come within {clear:.3g} m of each other "
            f"at {_pose(where)}; allowed: at least a rod's diameter, {rod:.3g} m"
        )
    return MachineCheck(
        *(machine, limits, excursion_envelope(None, machine), max(gaps)),
        (conditions[0], conditions[worst]),
        stall_forces(plant.hydraulics).min(axis=0),
        cabs,
        _by_status(machine),
        tuple(faults),
    )


def _proportions(machine: Machine, radius: float) -> Iterator[str]:
    """What a slip of units or of the origin makes of gimbals and strokes."""
    length, stroke = float(machine.geometry.neutral.max()), 2.0 * machine.half_stroke
    if length > LONG * stroke:
        yield (
            f"legs.half_stroke: legs of {length:.4g} m for a stroke of {stroke:.4g} m; allowed: "
            f"up to {LONG:g} times the stroke"
        )
    off = machine.geometry.upper.mean(axis=0)
    if np.linalg.norm(off) > APART * radius:
        yield (
            f"gimbals: the upper gimbals' centroid is {np.linalg.norm(off):.3g} m from the origin "
            f"of all coordinates; allowed: up to {APART * radius:.3g} m, for it is the origin"
        )


def _beyond_reach(machine: Machine, limits: MotionLimits) -> Iterator[str]:
    """Displacements that are stated and that the legs do not reach, alone from neutral."""
    for kind, field in (("operational", "working_stroke"), ("mechanical", "half_stroke")):
        reach = excursion_envelope(getattr(machine, field), machine)
        for dof, ends, reached in zip(DOFS, getattr(limits, kind), reach, strict=True):
            unit = by_kind(dof, "m", "deg")
            low, high, least, most = (units.from_si(unit, x) for x in (*ends, *reached))
            if low < least - _ROUND * abs(least) or high > most + _ROUND * most:
                yield (
                    f"limits.{dof}.{kind}: {low:.4g} to {high:.4g} {unit}; allowed: within "
                    f"{least:.4g} to {most:.4g} {unit}, where legs.{field} ends"
                )


def _clearance(
    machine: Machine, poses: NDArray[np.float64]
) -> tuple[float, int, int, NDArray[np.float64]]:
    """Least distance of two leg axes [m] over poses (N, 6), which legs, from 1, and the pose."""
    upper, lower, _ = machine.geometry
    turned = np.array([rotation(*pose[3:]) @ upper.T for pose in poses]).transpose(0, 2, 1)
    legs = poses[:, None, :3] + turned - lower  # from the lower gimbal up, (N, 6, 3)
    i, j = np.triu_indices(6, 1)
    one, other, between = legs[:, i], legs[:, j], lower[i] - lower[j]
    a, b, e = ((u * v).sum(axis=-1) for u, v in ((one, one), (one, other), (other, other)))
    c, f = ((u * between).sum(axis=-1) for u in (one, other))
    s = np.clip((b * f - c * e) / np.maximum(a * e - b * b, 1e-12 * a * e), 0.0, 1.0)
    t = np.clip((b * s + f) / e, 0.0, 1.0)
    s = np.clip((b * t - c) / a, 0.0, 1.0)
    apart = np.linalg.norm(between + s[..., None] * one - t[..., None] * other, axis=-1)
    row, pair = np.unravel_index(int(apart.argmin()), apart.shape)
    return float(apart[row, pair]), int(i[pair]) + 1, int(j[pair]) + 1, poses[row]


def _cab(plant: Hexapod, limits: MotionLimits, faults: list[str]) -> CabCheck:
    """One cab; what does not fit is added to `faults`."""
    where = f"cabs.{plant.cab}"
    with within(where):
        plant.start()
    supply = plant.hydraulics.supply
    load, (push, pull) = plant.static_load(), stall_forces(plant.hydraulics).T
    share = float(np.maximum(load / push, -load / pull).max())
    most = 1.0 / (1.0 + limits.axes[2].acceleration.si / units.STANDARD_GRAVITY)
    if share > most:
        faults.append(
            f"{where}: its static load is {share:.0%} of a leg's force at the supply's pressure; "
            f"allowed: up to {most:.0%}, which leaves what limits.heave.acceleration asks for"
        )
    speed = full_speed(plant.hydraulics, load, supply.pressure, supply.return_pressure)
    asked = limits.leg.velocity.si
    if speed.min() < asked:
        faults.append(
            f"{where}: valves fully open give a leg {speed.min():.4g} m/s under its static load; "
            f"limits.leg.velocity asks for {asked:.4g} m/s; allowed: at most what the valves give"
        )
    assert plant.cab_parameters is not None
    mass, modes = plant.cab_parameters.payload.mass, plant.hydraulic_modes().frequency_hz
    sustained = asymptotes(plant, "heave").pump_flow
    return CabCheck(plant.cab, mass, load, share, speed, sustained, modes)


def _pose(pose: NDArray[np.float64]) -> str:
    length = " ".join(f"{value:.3g}" for value in pose[:3])
    return f"{length} m, {' '.join(f'{value:.3g}' for value in np.degrees(pose[3:]))} deg"


def _by_status(machine: Machine) -> dict[str, list[str]]:
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
