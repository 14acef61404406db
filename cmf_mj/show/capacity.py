"""Tables and figures of capacity studies."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from cmf_mj.core import units
from cmf_mj.core.result import Result, Table
from cmf_mj.machine.geometry import by_kind, dof_unit
from cmf_mj.plant.parameters import HydraulicParameters
from cmf_mj.show import look
from cmf_mj.show.operation import plot_motion
from cmf_mj.studies.asymptotes import Asymptotes
from cmf_mj.studies.capacity import CAPACITY, CapacityResult, relief_flow
from cmf_mj.studies.envelope import Envelope, EnvelopePoint

_GPM, _PSI = units.GALLON_PER_MINUTE, units.PSI

_BINDING = {
    "displacement": ("operational displacement", "s", look.BLUE),
    "leg_stroke": ("leg stroke", "D", look.SKY),
    "valve_command": ("valve command", "^", look.ORANGE),
    "supply_pressure": ("supply pressure", "v", look.PURPLE),
    "pump_flow": ("pump flow", "o", look.GREEN),
    "physical_bounds": ("model left its bounds", "x", "#000000"),
}
"""Title, marker and colour of every limit."""

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


def envelope_table(envelope: Envelope) -> Table:
    """The envelope, a row per point."""
    closed = {each.dof: each for each in envelope.asymptotes}
    rows = []
    for point in envelope.points:
        length, turn = _scales(point.dof)
        rows.append(
            (
                *(point.dof, point.frequency, point.command / length),
                *(point.displacement / length, point.velocity / length, point.acceleration / turn),
                closed[point.dof].velocity(point.frequency) / length,
                *(point.least_pressure / _PSI, point.drawn_flow / _GPM, 100.0 * point.distortion),
                _BINDING[point.binding][0],
            )
        )
    names = ("Hz", "demand", "displ.", "velocity", "accel.", "closed\nform")
    return Table(
        f"largest sustained sine: {envelope.law}, {envelope.cab}, "
        f"{envelope.hydraulics} hydraulics, manifold above {_psi(envelope.allowed_pressure)}",
        (
            *("dof", *((name, ".3g") for name in names)),
            *(("manifold\npsi", ".0f"), ("drawn\ngpm", ".0f"), ("distort.\n%", ".2g"), "bound by"),
        ),
        rows,
        "Displacement, velocity, acceleration: amplitudes of the response's fundamental; "
        "in, in/s, g or deg, deg/s, deg/s^2. Closed form: smallest of the velocity limits.",
        grouped=True,
    )


def _scales(dof: str) -> tuple[float, float]:
    """The field's unit of displacement, and of acceleration, in SI."""
    return units.factor(dof_unit(dof)), by_kind(dof, units.STANDARD_GRAVITY, units.DEGREE)


def supply_figure(result: CapacityResult, parameters: HydraulicParameters) -> Figure:
    """A manoeuvre over time: motion, pressures, flows, oil in the accumulators, valves."""
    record, time = result.record, result.record.time
    network = ("flow [gpm]", "oil in accumulators\n[gal]") if parameters.supply == "network" else ()
    labels = ("", "pressure [psi]", *network, "valve command\nof the busiest leg [%]")
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
    for axis in (motion, pressure, *between[:1]):
        axis.margins(y=0.2)
        look.legend(axis, loc="upper right", ncols=4, framealpha=0.9)
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


def envelope_figure(envelope: Envelope) -> Figure:
    """Velocity over frequency, log-log, with diagonals of displacement and acceleration."""
    columns = min(len(envelope.asymptotes), 3)
    rows = -(-len(envelope.asymptotes) // columns)
    figure = look.new_figure(4.6 * columns + 0.4, 4.4 * rows + 1.0)
    for place, closed in enumerate(envelope.asymptotes, start=1):
        axis = figure.add_subplot(rows, columns, place)
        _envelope_panel(axis, envelope.of(closed.dof), closed)
    look.legend(figure, ncols=columns)
    figure.suptitle(
        f"{envelope.law}, {envelope.cab.upper()}, {envelope.hydraulics} hydraulics: "
        f"largest sustained sine with the manifold above {_psi(envelope.allowed_pressure)}"
    )
    return figure


def _envelope_panel(axis: Axes, points: list[EnvelopePoint], closed: Asymptotes) -> None:
    length, turn = _scales(closed.dof)
    unit = dof_unit(closed.dof)
    reached = [point for point in points if np.isfinite(point.velocity)]
    lowest = min(point.frequency for point in points)
    highest = max(max(point.frequency for point in points), 2.0 * lowest)
    frequency = np.geomspace(lowest, highest, 200)
    curves = [closed.velocities(float(f)) for f in frequency]
    least = np.array([min(curve.values()) for curve in curves]) / length
    speeds = [point.velocity / length for point in reached]
    across = (lowest / 1.1, highest * 1.1)
    both = [*speeds, *least]
    up = (0.4 * min(both), 3.0 * max(both))
    axis.set(xscale="log", yscale="log", xlim=across, ylim=up)
    # Of constant displacement (rising) and of constant acceleration (falling).
    f, v = np.meshgrid(np.geomspace(*across, 60), np.geomspace(*up, 60))
    rate, levels = 2.0 * np.pi * f, 10.0 ** np.arange(-6, 7)
    per = by_kind(closed.dof, "g", "deg/s²")
    for size, label in ((v / rate, unit), (v * rate * length / turn, per)):
        lines = axis.contour(f, v, size, levels, colors="0.82", linewidths=0.7, zorder=0)
        axis.clabel(lines, fmt=f"%g {label}", fontsize=6.5, colors="0.45")
    style: dict[str, Any] = {"color": look.DARK, "label": "largest sine that holds"}
    axis.plot([point.frequency for point in reached], speeds, linewidth=1.8, **style)
    for point, speed in zip(reached, speeds, strict=True):
        title, marker, colour = _BINDING[point.binding]
        style = {"color": colour, "linestyle": "", "label": f"bound by {title}"}
        axis.plot(point.frequency, speed, marker=marker, markersize=6, zorder=4, **style)
    for name, (title, line, colour) in _CLOSED.items():
        values = np.array([curve[name] for curve in curves]) / length
        if np.isfinite(values).all():
            style = {"color": colour, "linestyle": line, "label": f"closed form: {title}"}
            axis.plot(frequency, values, linewidth=1.0, **style)
    axis.set(xlabel="frequency [Hz]", ylabel=f"velocity amplitude [{unit}/s]", title=closed.dof)
    for ticks in (axis.xaxis, axis.yaxis):
        ticks.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ticks.set_major_formatter("{x:g}")
    axis.minorticks_off()


def save_capacity(
    result: CapacityResult, parameters: HydraulicParameters, folder: Path
) -> list[Path]:
    """Write `capacity.csv` (SI), `supply.png` and the record as `capacity.parquet`."""
    files = {
        "capacity.csv": capacity_result(result),
        "supply.png": supply_figure(result, parameters),
    }
    return look.save_files(files | {"capacity.parquet": result.record}, folder)


def save_envelope(envelope: Envelope, folder: Path) -> list[Path]:
    """Write `envelope.md`, the table, and `envelope.png`."""
    table, figure = envelope_table(envelope), envelope_figure(envelope)
    return look.save_files({"envelope.md": table, "envelope.png": figure}, folder)
