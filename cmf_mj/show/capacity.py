"""Tables and figures of capacity studies."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator
from numpy.typing import NDArray

from cmf_mj.core import units
from cmf_mj.core.files import write_text
from cmf_mj.machine.dof import by_kind, dof_unit
from cmf_mj.plant.parameters.hydraulics import HydraulicParameters
from cmf_mj.show.look import (
    AMBER,
    BLUE,
    DARK,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    grid,
    legend,
    new_figure,
    save_figure,
)
from cmf_mj.show.overview import plot_motion
from cmf_mj.show.table import Table, number
from cmf_mj.studies.capacity.asymptotes import Asymptotes
from cmf_mj.studies.capacity.envelope import Envelope, EnvelopePoint
from cmf_mj.studies.capacity.verdict import CapacityResult, relief_flow

_GALLON, _GPM, _PSI = units.GALLON, units.GALLON_PER_MINUTE, units.PSI

_BINDING = {
    "displacement": ("operational displacement", "s", BLUE),
    "leg_stroke": ("leg stroke", "D", SKY),
    "valve_command": ("valve command", "^", ORANGE),
    "supply_pressure": ("supply pressure", "v", PURPLE),
    "pump_flow": ("pump flow", "o", GREEN),
    "physical_bounds": ("model left its bounds", "x", "#000000"),
}
"""Title, marker and colour of every limit."""

_CLOSED: dict[str, tuple[str, Any, str]] = {
    "displacement": ("operational displacement", "-", BLUE),
    "leg_stroke": ("leg stroke", ":", SKY),
    "valve_command": ("leg speed behind the lags", "--", ORANGE),
    "pump_flow": ("sustained pump flow", "-.", GREEN),
    "stall_force": ("stall force over reflected mass", (0.0, [5, 1, 1, 1, 1, 1]), "#999933"),
}
"""Title, line and colour of every closed form."""


def _psi(value: float) -> str:
    return number(value / _PSI, ".0f psi")


def _gpm(value: float) -> str:
    return number(value / _GPM, ".0f gpm")


def _gallons(value: float) -> str:
    return number(value / _GALLON, ".1f gal")


def capacity_table(result: CapacityResult) -> Table:
    """Every measure of a manoeuvre: name, value with unit, definition."""
    worst = int(result.peak_command.argmax())
    lowest, oil = f"at {result.least_pressure.time:.2f} s", _gallons(result.charged_oil)
    margin = f"leg {result.least_margin.leg} at {result.least_margin.time:.2f} s"
    rows = [
        (
            *("supply holds", "yes" if result.holds else "NO"),
            f"manifold never below {_psi(result.allowed_pressure)}",
        ),
        ("least manifold pressure", _psi(result.least_pressure.value), lowest),
        ("least oil in accumulators", _gallons(result.least_oil), f"of {oil} charged"),
        ("least gas pressure", _psi(result.least_gas_pressure), "of the accumulators"),
        ("accumulators empty", f"{number(result.empty_time, '.3g')} s", "in all"),
        (
            *("mean pump flow", _gpm(result.pump_flow.mean)),
            f"over the run; limit {_gpm(result.pump_flow_limit)}",
        ),
        ("peak pump flow", _gpm(result.pump_flow.peak), ""),
        ("mean relief flow", _gpm(result.relief_flow.mean), "over the run"),
        ("peak relief flow", _gpm(result.relief_flow.peak), ""),
        (
            *("valve saturation", f"{100.0 * result.saturation.max():.2f} %"),
            "of the run, worst leg",
        ),
        (
            *("peak valve demand", f"{100.0 * result.peak_command[worst]:.0f} %"),
            f"leg {worst + 1}, before the clamp at 100 %",
        ),
        (
            "least pressure margin",
            _psi(result.least_margin.value),
            f"manifold over stall, {margin}",
        ),
    ]
    about = result.record.metadata
    words = [about["law"], about["cab"], f"{about['hydraulics']} hydraulics"]
    title = f"capacity: {', '.join(filter(None, words))}"
    return Table(title, ("measure", "value", ""), rows)


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
    record = result.record
    time = record.time
    network = parameters.supply == "network"
    count = 5 if network else 3
    figure = new_figure(8.5, 1.9 * count)
    motion, pressure, *between, valve = figure.subplots(count, 1, sharex=True)
    verdict = "holds" if result.holds else "does NOT hold"
    motion.set_title(
        f"the supply {verdict}: least manifold pressure {_psi(result.least_pressure.value)}, "
        f"{_psi(result.allowed_pressure)} needed"
    )
    plot_motion(motion, record)
    pressure.plot(time, record["supply_pressure"] / _PSI, color=BLUE, label="supply manifold")
    pressure.axhline(result.allowed_pressure / _PSI, color=ORANGE, label="least allowed")
    pressure.set_ylabel("pressure [psi]")
    largest = 100.0 * np.abs(record["valve_command"]).max(axis=1)
    valve.plot(time, largest, color=DARK, label="largest valve command")
    valve.axhline(100.0, color=GREY, linestyle=":")
    valve.set(ylabel="valve command\nof the busiest leg [%]", ylim=(0.0, 110.0), xlabel="time [s]")
    if network:
        flow, oil = between
        _network(pressure, flow, oil, result, parameters)
    for axis in (motion, pressure, *between[:1]):
        legend(axis, loc="upper right", ncols=4, framealpha=0.9)
        low, high = axis.get_ylim()
        axis.set_ylim(low, high + 0.3 * (high - low))
    grid(motion, pressure, *between, valve)
    motion.set_xlim(time[0], time[-1])
    return figure


def _network(
    pressure: Axes, flow: Axes, oil: Axes, result: CapacityResult, parameters: HydraulicParameters
) -> None:
    """Pump, accumulators and relief over time."""
    record, time = result.record, result.record.time
    gas = record["accumulator_pressure"] / _PSI
    pressure.plot(time, gas, "--", color=AMBER, label="accumulator gas")
    precharge = parameters.precharge_pressure.si / _PSI
    pressure.axhline(precharge, color=GREY, linestyle=":", label="precharge")
    flow.plot(time, record["pump_flow"] / _GPM, color=GREEN, label="pump")
    bank = parameters.accumulator_count.si * record["accumulator_oil"]
    drawn = -np.gradient(bank, time) / _GPM
    flow.plot(time, drawn, color=AMBER, linewidth=0.9, label="accumulators")
    flow.axhline(parameters.pump_flow.si / _GPM, color=GREY, linestyle=":", label="pump's limit")
    if result.relief_flow.peak > 0.0:
        relief = relief_flow(parameters, record) / _GPM
        flow.plot(time, relief, color=PURPLE, label="relief")
    flow.set_ylabel("flow [gpm]")
    oil.plot(time, bank / _GALLON, color=AMBER)
    oil.set(ylabel="oil in accumulators\n[gal]", ylim=(0.0, 1.1 * float(bank.max()) / _GALLON))


def envelope_figure(envelope: Envelope) -> Figure:
    """Velocity over frequency, log-log, with diagonals of displacement and acceleration."""
    count = len(envelope.asymptotes)
    columns = min(count, 3)
    rows = -(-count // columns)
    figure = new_figure(4.6 * columns + 0.4, 4.4 * rows + 1.0)
    for place, closed in enumerate(envelope.asymptotes, start=1):
        axis = figure.add_subplot(rows, columns, place)
        _envelope_panel(axis, envelope.of(closed.dof), closed)
    bindings = {point.binding for point in envelope.points}
    handles = [Line2D([], [], color="0.15", linewidth=1.8, label="largest sine that holds")]
    handles += [
        Line2D([], [], color=colour, marker=marker, linestyle="", label=f"bound by {title}")
        for name, (title, marker, colour) in _BINDING.items()
        if name in bindings
    ]
    handles += [
        Line2D([], [], color=colour, linestyle=line, linewidth=1.0, label=f"closed form: {title}")
        for title, line, colour in _CLOSED.values()
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, fontsize=8)
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
    least = np.array([closed.velocity(float(f)) for f in frequency]) / length
    speeds = [point.velocity / length for point in reached] or list(least)
    bottom = 0.4 * min(*speeds, least.min())
    top = 3.0 * max(*speeds, least.max())
    axis.set(xscale="log", yscale="log", xlim=(lowest / 1.1, highest * 1.1), ylim=(bottom, top))
    _diagonals(axis, unit, length, turn)
    for name, (_, line, colour) in _CLOSED.items():
        values = np.array([curve[name] for curve in curves]) / length
        if np.isfinite(values).all():
            axis.plot(frequency, values, linestyle=line, color=colour, linewidth=1.0)
    axis.plot(
        [point.frequency for point in reached], speeds[: len(reached)], color="0.15", linewidth=1.8
    )
    for point in reached:
        _, marker, colour = _BINDING[point.binding]
        axis.plot(
            point.frequency, point.velocity / length, marker, color=colour, markersize=6, zorder=4
        )
    axis.set(xlabel="frequency [Hz]", ylabel=f"velocity amplitude [{unit}/s]", title=closed.dof)
    for ticks in (axis.xaxis, axis.yaxis):
        ticks.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ticks.set_major_formatter("{x:g}")
    axis.minorticks_off()


def _diagonals(axis: Axes, unit: str, length: float, turn: float) -> None:
    """Grid of constant displacement (rising) and acceleration (falling), labelled at the edges."""
    (left, right), (bottom, top) = axis.get_xlim(), axis.get_ylim()
    axis.grid(True, color="0.93", linewidth=0.6)
    ends = np.array([left, right])
    per = "g" if unit == "in" else "deg/s²"
    for exponent in range(-6, 7):
        size = 10.0**exponent
        rising = 2.0 * np.pi * ends * size
        falling = size * turn / length / (2.0 * np.pi * ends)
        for values, label, above in (
            (rising, f"{size:g} {unit}", True),
            (falling, f"{size:g} {per}", False),
        ):
            if values.max() < bottom or values.min() > top:
                continue
            axis.plot(ends, values, color="0.82", linewidth=0.7, zorder=0)
            _label(axis, values, label, rising=above)


def _label(axis: Axes, values: NDArray[np.float64], label: str, *, rising: bool) -> None:
    """Write along a diagonal near its upper end: right for a rising one, left for a falling."""
    left, right = np.log(axis.get_xlim())
    bottom, top = np.log(axis.get_ylim())
    slope = 1.0 if rising else -1.0
    start = np.log(values[0]) - slope * left  # log v = start + slope log f
    if rising:
        x = min(right, top - start) - 0.14 * (right - left)
    else:
        x = max(left, start - top) + 0.12 * (right - left)
    y = start + slope * x
    if not (left < x < right and bottom < y < top):
        return
    axis.text(
        float(np.exp(x)),
        float(np.exp(y)),
        label,
        fontsize=6.5,
        color="0.45",
        rotation=float(np.degrees(np.arctan2(slope * np.exp(y), np.exp(x)))),
        rotation_mode="anchor",
        transform_rotates_text=True,
        ha="center",
        va="center",
        zorder=1,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.5, "alpha": 0.8},
    )


def save_capacity(
    result: CapacityResult, parameters: HydraulicParameters, folder: Path
) -> list[Path]:
    """Write `capacity.csv` (measures in the field's units), `supply.png` and `capacity.parquet`."""
    lines = [",".join(f'"{cell}"' for cell in row) for row in capacity_table(result).cells]
    text = "\n".join(["measure,value,definition", *lines, ""])
    return [
        write_text(folder / "capacity.csv", text),
        save_figure(supply_figure(result, parameters), folder / "supply.png"),
        result.record.save(folder / "capacity.parquet"),
    ]


def save_envelope(envelope: Envelope, folder: Path) -> list[Path]:
    """Write `envelope.csv` (SI) and `envelope.png`."""
    folder.mkdir(parents=True, exist_ok=True)
    return [
        envelope.save_csv(folder / "envelope.csv"),
        save_figure(envelope_figure(envelope), folder / "envelope.png"),
    ]
