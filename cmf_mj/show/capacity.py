"""Figures and files of capacity studies and of the envelope, the largest sustained sine."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cmf_mj.core import units
from cmf_mj.core.result import Result
from cmf_mj.machine.geometry import by_kind, dof_unit
from cmf_mj.plant.parameters import HydraulicParameters
from cmf_mj.plant.plant import Plant
from cmf_mj.show import look
from cmf_mj.show.operation import plot_motion
from cmf_mj.studies.asymptotes import FREQUENCIES, Asymptotes, asymptotes, envelope
from cmf_mj.studies.capacity import CAPACITY, CapacityResult, relief_flow

_GPM, _PSI = units.GALLON_PER_MINUTE, units.PSI

_CLOSED: dict[str, tuple[str, Any, str]] = {
    "displacement": ("operational displacement", "-", look.BLUE),
    "leg_stroke": ("leg stroke", ":", look.SKY),
    "valve_command": ("leg speed behind the lags", "--", look.ORANGE),
    "pump_flow": ("sustained pump flow", "-.", look.GREEN),
    "stall_force": ("stall force over reflected mass", (0.0, [5, 1, 1, 1, 1, 1]), "#999933"),
}
"""Title, line and colour of every closed form."""


def _psi(value: float) -> str:
    return f"{value / _PSI:.0f} psi"


def capacity_result(result: CapacityResult) -> Result[CapacityResult]:
    """What a manoeuvre took out of the supply, as a row."""
    about = result.record.metadata
    words = [about["law"], about["cab"], f"{about['hydraulics']} hydraulics"]
    return Result([result], CAPACITY, f"capacity: {', '.join(filter(None, words))}")


def supply_figure(result: CapacityResult, parameters: HydraulicParameters) -> Figure:
    """A manoeuvre over time: motion, pressures, flows, oil in the accumulators, valves."""
    record, time = result.record, result.record.time
    network = ("flow [gpm]", "oil in accumulators\n[gal]") if parameters.supply == "network" else ()
    labels = ("", "pressure [psi]", *network, "largest valve\ncommand [%]")
    figure, axes = look.stack(8.5, 1.9 * len(labels), *labels)
    motion, pressure, *between, valve = axes
    verdict = "holds" if result.holds else "does NOT hold"
    motion.set_title(
        f"the supply {verdict}: least manifold pressure {_psi(result.least_pressure.value)}, "
        f"{_psi(result.allowed_pressure)} needed"
    )
    plot_motion(motion, record)
    pressure.plot(time, record["supply_pressure"] / _PSI, color=look.BLUE, label="supply manifold")
    pressure.axhline(result.allowed_pressure / _PSI, color=look.ORANGE, label="least allowed")
    valve.plot(time, 100.0 * np.abs(record["valve_command"]).max(axis=1), color=look.DARK)
    valve.axhline(100.0, color=look.GREY, linestyle=":")
    valve.set_ylim(0.0, 110.0)
    if network:
        _network((pressure, *between), result, parameters)
    look.legend(motion, pressure, *between[:1])
    motion.set_xlim(time[0], time[-1])
    return figure


def _network(axes: Sequence[Axes], result: CapacityResult, parameters: HydraulicParameters) -> None:
    """Pump, accumulators and relief over time."""
    pressure, flow, oil = axes
    record, time = result.record, result.record.time
    gas = record["accumulator_pressure"] / _PSI
    pressure.plot(time, gas, "--", color=look.AMBER, label="accumulator gas")
    precharge = parameters.precharge_pressure.si / _PSI
    pressure.axhline(precharge, color=look.GREY, linestyle=":", label="precharge")
    flow.plot(time, record["pump_flow"] / _GPM, color=look.GREEN, label="pump")
    bank = parameters.accumulator_count.si * record["accumulator_oil"]
    drawn = -np.gradient(bank, time) / _GPM
    flow.plot(time, drawn, color=look.AMBER, linewidth=0.9, label="accumulators")
    flow.axhline(
        parameters.pump_flow.si / _GPM, color=look.GREY, linestyle=":", label="pump's limit"
    )
    if result.relief_flow.peak > 0.0:
        relief = relief_flow(parameters, record) / _GPM
        flow.plot(time, relief, color=look.PURPLE, label="relief")
    oil.plot(time, bank / units.GALLON, color=look.AMBER)
    oil.set_ylim(0.0, 1.1 * float(bank.max()) / units.GALLON)


def envelope_figure(plant: Plant, dofs: Sequence[str]) -> Figure:
    """Velocity over frequency, log-log, with diagonals of displacement and acceleration."""
    columns = min(len(dofs), 3)
    rows = -(-len(dofs) // columns)
    figure = look.new_figure(4.6 * columns + 0.4, 4.4 * rows + 1.0)
    for place, dof in enumerate(dofs, start=1):
        _envelope_panel(figure.add_subplot(rows, columns, place), asymptotes(plant, dof))
    look.legend(figure)
    name = " ".join(filter(None, (plant.cab.upper(), plant.parameters.name)))
    figure.suptitle(f"{name}: largest sustained sine, closed forms of its limits")
    return figure


def _envelope_panel(axis: Axes, closed: Asymptotes) -> None:
    unit = dof_unit(closed.dof)
    length, turn = units.factor(unit), by_kind(closed.dof, units.STANDARD_GRAVITY, units.DEGREE)
    frequency = np.geomspace(FREQUENCIES[0], FREQUENCIES[-1], 200)
    curves = [closed.velocities(float(f)) for f in frequency]
    least = np.array([min(curve.values()) for curve in curves]) / length
    across, up = (0.9 * frequency[0], 1.1 * frequency[-1]), (0.4 * least.min(), 3.0 * least.max())
    axis.set(xscale="log", yscale="log", xlim=across, ylim=up)
    # Of constant displacement (rising) and of constant acceleration (falling).
    f, v = np.meshgrid(np.geomspace(*across, 60), np.geomspace(*up, 60))
    rate, levels = 2.0 * np.pi * f, 10.0 ** np.arange(-6, 7)
    per = by_kind(closed.dof, "g", "deg/s²")
    for size, label in ((v / rate, unit), (v * rate * length / turn, per)):
        lines = axis.contour(f, v, size, levels, colors="0.82", linewidths=0.7, zorder=0)
        axis.clabel(lines, fmt=f"%g {label}", fontsize=6.5, colors="0.45")
    axis.plot(frequency, least, color=look.DARK, linewidth=1.8, label="largest sine")
    for name, (title, line, colour) in _CLOSED.items():
        values = np.array([curve[name] for curve in curves]) / length
        if np.isfinite(values).all():
            style: dict[str, Any] = {"color": colour, "linestyle": line, "label": title}
            axis.plot(frequency, values, linewidth=1.0, **style)
    for ticks in (axis.yaxis, axis.xaxis):
        look.frequency_axis(ticks)
    axis.set(ylabel=f"velocity amplitude [{unit}/s]", title=closed.dof)


def save_capacity(
    result: CapacityResult, parameters: HydraulicParameters, folder: Path
) -> list[Path]:
    """Write `capacity.csv` (SI), `supply.png` and the record as `capacity.parquet`."""
    files = {
        "capacity.csv": capacity_result(result),
        "supply.png": supply_figure(result, parameters),
    }
    return look.save_files(files | {"capacity.parquet": result.record}, folder)


def save_envelope(plant: Plant, dofs: Sequence[str], folder: Path) -> list[Path]:
    """Write `envelope.csv` (SI), `envelope.md` and `envelope.png`."""
    result = envelope(plant, dofs)
    files = {"envelope.csv": result, "envelope.md": result}
    return look.save_files(files | {"envelope.png": envelope_figure(plant, dofs)}, folder)
