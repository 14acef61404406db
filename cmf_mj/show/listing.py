"""Tables of laws, of sets of hydraulics and sensors, and of a machine; replays."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib.image
import mujoco
import numpy as np
from matplotlib.figure import Figure

from cmf_mj.control.law import Law, load_law
from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.core.files import whole_file
from cmf_mj.core.result import Field, Result, Table
from cmf_mj.electronics.sensors.channel import CHANNELS, SensorSettings
from cmf_mj.facility.replay import Replay
from cmf_mj.machine.cab import load_cab
from cmf_mj.machine.geometry import DOFS, by_kind
from cmf_mj.machine.machine import Machine
from cmf_mj.plant.hexapod import hexapod_model
from cmf_mj.plant.parameters import HydraulicParameters
from cmf_mj.show.film.stage import FilmStage
from cmf_mj.show.look import BLUE, ORANGE, save_figure, stack
from cmf_mj.studies.machine_check import MachineCheck


def law_table(laws: Sequence[Law]) -> Result[Law]:
    """Laws with their sources."""
    return Result(laws, [*map(Field, ("name", "title", "source"))], "control laws")


def parameter_table(parameters: HydraulicParameters) -> Table:
    """A hydraulic set: value, unit, status and source of every number."""
    rows = [
        (name, quantity.value, quantity.unit, quantity.status, quantity.source)
        for name, quantity in parameters.quantities().items()
    ]
    columns = ("parameter", ("value", "g"), "unit", "status", "source")
    return Table(f"hydraulics: {parameters.name}", columns, rows)


def sensor_table(settings: SensorSettings) -> Table:
    """A sensor set with the unit, status and source of every number."""
    rows: list[tuple[str | float, ...]] = []
    for channel in CHANNELS:
        numbers = settings.channel(channel).quantities()
        if not numbers:
            rows.append((channel, "ideal", "", "", "", ""))
        rows += [
            (channel, name, each.value, each.unit, each.status, each.source)
            for name, each in numbers.items()
        ]
    gravity = "on" if settings.gravity else "off"
    columns = ("channel", "number", ("value", "g"), "unit", "status", "source")
    return Table(f"sensors: {settings.name}, gravity {gravity}", columns, rows)


def replay_figure(replayed: Replay) -> Figure:
    """Recorded and replayed compensator output of all legs, and their difference."""
    output, recorded = 100.0 * replayed.output, replayed.recorded
    names = [f"leg {leg + 1} [%]" for leg in range(output.shape[1])]
    figure, (*legs, apart) = stack(9.0, 8.0, *names, "largest\ndifference [%]")
    if recorded is not None:
        for axis, values in zip(legs, 100.0 * recorded.T, strict=True):
            axis.plot(replayed.time, values, color="#bbbbbb", linewidth=3.0)
        difference = np.abs(output - 100.0 * recorded).max(axis=1)
        apart.plot(replayed.time, difference, color=ORANGE, linewidth=0.8)
    for axis, values in zip(legs, output.T, strict=True):
        axis.plot(replayed.time, values, color=BLUE, linewidth=0.8)
    legs[0].set_title(f"compensator output: recorded (grey) and {replayed.law} replayed (blue)")
    return figure


def save_replay(replayed: Replay, path: Path) -> Path:
    """Write `replay_figure` as a PNG file; folders are made."""
    return save_figure(replay_figure(replayed), path)


def replay_summary(replayed: Replay) -> str:
    """The largest difference in one sentence."""
    if replayed.recorded is None:
        return f"{replayed.law}: nothing to compare with; the record has no compensator output"
    if replayed.identical:
        return f"{replayed.law}: identical, bit for bit, over {replayed.time.size} frames"
    note = ", interpolated to 2048 Hz" if replayed.interpolated else ""
    return f"{replayed.law}: largest difference {100.0 * replayed.difference:.3g} %{note}"


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
