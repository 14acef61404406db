"""A machine on paper: its numbers, the report of its check, and a picture."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib.image
import mujoco
import numpy as np

from cmf_mj.control.law import load_law
from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.core.files import whole_file
from cmf_mj.core.table import Table
from cmf_mj.machine.cab import load_cab
from cmf_mj.machine.dof import by_kind
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.machine import Machine
from cmf_mj.plant.hexapod import hexapod_model
from cmf_mj.show.film.stage import FilmStage
from cmf_mj.studies.machine_check import MachineCheck


def machine_table(machines: Sequence[Machine]) -> Table:
    """Machines with their cabs."""
    rows = [(m.name, m.title, ", ".join(m.cab_names), load_law(m.law).name) for m in machines]
    return Table("machines", ("name", "title", "cabs", "law"), rows)


def envelope_table(check: MachineCheck) -> Table:
    """Limits of each degree of freedom alone, and how they are known."""
    rows = []
    for index, (dof, axis) in enumerate(zip(DOFS, check.limits.axes, strict=True)):
        unit = by_kind(dof, "m", "deg")
        reach = units.from_si(unit, check.envelope[index])
        low, high = (units.from_si(unit, end) for end in axis.operational.si)
        speed = units.from_si(unit, axis.velocity.si)
        rows.append((dof, *reach, low, high, axis.operational.status, speed, f"{unit}, {unit}/s"))
    columns = (
        *("dof", ("legs reach from", ".3f"), ("to", ".3f"), ("limit from", ".3f"), ("to ", ".3f")),
        *("status", ("largest rate", ".3g"), "units"),
    )
    return Table(f"{check.machine.name}: envelope", columns, rows)


def cab_table(check: MachineCheck) -> Table:
    """Each cab on its legs."""
    rows = [
        (
            *(cab.cab, cab.mass, 1e-3 * float(np.abs(cab.load).max()), float(cab.speed.min())),
            *(cab.sustained, " ".join(f"{mode:.1f}" for mode in cab.modes)),
        )
        for cab in check.cabs
    ]
    columns = (
        *("cab", ("mass [kg]", ".0f"), ("static load [kN]", ".2f"), ("leg speed [m/s]", ".3f")),
        *(("heave sustained [m/s]", ".3f"), "modes [Hz]"),
    )
    push, pull = (1e-3 * force for force in check.stall)
    return Table(f"cabs: cylinders stall at {push:.1f} kN out, {pull:.1f} kN in", columns, rows)


def check_text(check: MachineCheck) -> list[str]:
    """The rest of the report, line by line."""
    neutral = check.machine.geometry.neutral
    lines = [
        f"neutral legs {neutral.min():.4f} to {neutral.max():.4f} m from gimbal to gimbal",
        f"gimbals closed within {1e9 * check.gap:.3g} nm over the envelope",
        f"condition number {check.conditioning[0]:.2f} at neutral, {check.conditioning[1]:.2f} at "
        "worst over the envelope",
    ]
    lines += [f"{status}: {', '.join(names)}" for status, names in check.statuses.items()]
    return lines + [f"does not fit: {fault}" for fault in check.faults]


def save_picture(machine: Machine, cab: str | None, path: Path, size: tuple[int, int]) -> Path:
    """Draw a machine with a cab at neutral, width and height in pixels."""
    if path.suffix != ".png":
        raise InputError(f"file: {path} must end in .png")
    model = hexapod_model(load_cab(cab, machine))
    with FilmStage(model, *size, "overview") as stage:
        pixels = stage.picture(mujoco.MjData(model).qpos)
    with whole_file(path) as part:
        matplotlib.image.imsave(part, pixels, format="png")
    return path
