"""Tables and figures of capacity studies."""

from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from rich.box import SIMPLE_HEAD
from rich.table import Table

from cmf_mj.core import units
from cmf_mj.core.files import write_text
from cmf_mj.machine.dof import dof_unit
from cmf_mj.machine.kinematics import DOFS
from cmf_mj.plant.parameters.hydraulics import HydraulicParameters
from cmf_mj.studies.capacity.asymptotes import Asymptotes
from cmf_mj.studies.capacity.envelope import Envelope, EnvelopePoint
from cmf_mj.studies.capacity.verdict import CapacityResult, relief_flow

_GALLON, _GPM, _PSI = units.GALLON, units.GALLON_PER_MINUTE, units.PSI

_BINDING = {
    "displacement": ("operational displacement", "s", "#0072b2"),
    "leg_stroke": ("leg stroke", "D", "#56b4e9"),
    "valve_command": ("valve command", "^", "#d55e00"),
    "supply_pressure": ("supply pressure", "v", "#cc79a7"),
    "pump_flow": ("pump flow", "o", "#009e73"),
    "physical_bounds": ("model left its bounds", "x", "#000000"),
}
"""Title, marker and colour of every limit."""

_CLOSED: dict[str, tuple[str, Literal["-", ":", "--", "-."] | tuple[float, list[float]], str]] = {
    "displacement": ("operational displacement", "-", "#0072b2"),
    "leg_stroke": ("leg stroke", ":", "#56b4e9"),
    "valve_command": ("leg speed behind the lags", "--", "#d55e00"),
    "pump_flow": ("sustained pump flow", "-.", "#009e73"),
    "stall_force": (
        "stall force over reflected mass",
        (0.0, [5.0, 1.0, 1.0, 1.0, 1.0, 1.0]),
        "#999933",
    ),
}
"""Title, line and colour of every closed form."""


def _number(value: float, digits: int = 3) -> str:
    return "-" if np.isnan(value) else f"{value:.{digits}g}"


def _psi(value: float) -> str:
    return "-" if np.isnan(value) else f"{value / _PSI:.0f} psi"


def _gpm(value: float) -> str:
    return "-" if np.isnan(value) else f"{value / _GPM:.0f} gpm"


def _gallons(value: float) -> str:
    return "-" if np.isnan(value) else f"{value / _GALLON:.1f} gal"


def capacity_rows(result: CapacityResult) -> list[tuple[str, str, str]]:
    """Every measure of a manoeuvre: name, value with unit, definition."""
    worst = int(result.peak_command.argmax())
    allowed = _psi(result.allowed_pressure)
    return [
        ("supply holds", "yes" if result.holds else "NO", f"manifold never below {allowed}"),
        (
            "least manifold pressure",
            _psi(result.least_pressure),
            f"at {result.least_pressure_time:.2f} s",
        ),
        (
            "least oil in accumulators",
            _gallons(result.least_oil),
            f"of {_gallons(result.charged_oil)} charged",
        ),
        ("least gas pressure", _psi(result.least_gas_pressure), "of the accumulators"),
        ("accumulators empty", f"{_number(result.empty_time)} s", "in all"),
        (
            "mean pump flow",
            _gpm(result.mean_pump_flow),
            f"over the run; limit {_gpm(result.pump_flow_limit)}",
        ),
        ("peak pump flow", _gpm(result.peak_pump_flow), ""),
        ("mean relief flow", _gpm(result.mean_relief_flow), "over the run"),
        ("peak relief flow", _gpm(result.peak_relief_flow), ""),
        (
            "valve saturation",
            f"{100.0 * result.saturation.max():.2f} %",
            "of the run, worst leg",
        ),
        (
            "peak valve demand",
            f"{100.0 * result.peak_command[worst]:.0f} %",
            f"leg {worst + 1}, before the clamp at 100 %",
        ),
        (
            "least pressure margin",
            _psi(result.least_margin),
            f"manifold over stall, leg {result.least_margin_leg + 1} "
            f"at {result.least_margin_time:.2f} s",
        ),
    ]


def capacity_table(result: CapacityResult) -> Table:
    """A manoeuvre as a terminal table."""
    about = result.record.metadata
    words = [about["law"], about["cab"], f"{about['hydraulics']} hydraulics"]
    table = Table(
        "measure", "value", "", title=f"capacity: {', '.join(filter(None, words))}", box=SIMPLE_HEAD
    )
    for row in capacity_rows(result):
        table.add_row(*row)
    return table


def envelope_table(envelope: Envelope) -> Table:
    """The envelope, a line per point."""
    table = Table(
        title=f"largest sustained sine: {envelope.law}, {envelope.cab}, "
        f"{envelope.hydraulics} hydraulics, manifold above {_psi(envelope.allowed_pressure)}",
        caption="Displacement, velocity, acceleration: amplitudes of the response's fundamental; "
        "in, in/s, g or deg, deg/s, deg/s^2. Closed form: smallest of the velocity limits.",
        caption_justify="left",
        box=SIMPLE_HEAD,
    )
    names = ("dof", "Hz", "demand", "displ.", "velocity", "accel.", "closed\nform")
    for name in (*names, "manifold\npsi", "drawn\ngpm", "distort.\n%"):
        table.add_column(name, justify="left" if name == "dof" else "right", no_wrap=True)
    table.add_column("bound by", no_wrap=True)
    beside = {own.dof: own for own in envelope.asymptotes}
    dof = ""
    for point in envelope.points:
        if dof and point.dof != dof:
            table.add_section()
        length, turn = _scales(point.dof)
        cells = (
            point.frequency,
            point.command / length,
            point.displacement / length,
            point.velocity / length,
            point.acceleration / turn,
            beside[point.dof].velocity(point.frequency) / length,
        )
        table.add_row(
            "" if point.dof == dof else point.dof,
            *(_number(value) for value in cells),
            *(
                "-" if np.isnan(value) else f"{value:.0f}"
                for value in (point.least_pressure / _PSI, point.drawn_flow / _GPM)
            ),
            _number(100.0 * point.distortion, 2),
            _BINDING[point.binding][0],
        )
        dof = point.dof
    return table


def _scales(dof: str) -> tuple[float, float]:
    """The field's unit of displacement, and of acceleration, in SI."""
    if dof_unit(dof) == "in":
        return units.INCH, units.STANDARD_GRAVITY
    return units.DEGREE, units.DEGREE


def supply_figure(result: CapacityResult, parameters: HydraulicParameters) -> Figure:
    """A manoeuvre over time: motion, pressures, flows, oil in the accumulators, valves."""
    record = result.record
    time = record.time
    network = parameters.supply == "network"
    count = 5 if network else 3
    figure = Figure(figsize=(8.5, 1.9 * count), layout="constrained")
    motion, pressure, *between, valve = figure.subplots(count, 1, sharex=True)
    verdict = "holds" if result.holds else "does NOT hold"
    motion.set_title(
        f"the supply {verdict}: least manifold pressure {_psi(result.least_pressure)}, "
        f"{_psi(result.allowed_pressure)} needed"
    )
    _motion(motion, result)
    pressure.plot(time, record["supply_pressure"] / _PSI, color="#0072b2", label="supply manifold")
    pressure.axhline(result.allowed_pressure / _PSI, color="#d55e00", label="least allowed")
    pressure.set_ylabel("pressure [psi]")
    largest = 100.0 * np.abs(record["valve_command"]).max(axis=1)
    valve.plot(time, largest, color="0.2", label="largest valve command")
    valve.axhline(100.0, color="0.6", linestyle=":")
    valve.set(ylabel="valve command\nof the busiest leg [%]", ylim=(0.0, 110.0), xlabel="time [s]")
    legends, others = [motion, pressure], [valve]
    if network:
        flow, oil = between
        _network(pressure, flow, oil, result, parameters)
        legends.append(flow)
        others.append(oil)
    for axis in legends:
        axis.legend(fontsize=8, loc="upper right", ncols=4, framealpha=0.9)
        low, high = axis.get_ylim()
        axis.set_ylim(low, high + 0.3 * (high - low))
    for axis in [*legends, *others]:
        axis.grid(True, color="0.9", linewidth=0.6)
    motion.set_xlim(time[0], time[-1])
    return figure


def _network(
    pressure: Axes, flow: Axes, oil: Axes, result: CapacityResult, parameters: HydraulicParameters
) -> None:
    """Pump, accumulators and relief over time."""
    record, time = result.record, result.record.time
    gas = record["accumulator_pressure"] / _PSI
    pressure.plot(time, gas, "--", color="#e69f00", label="accumulator gas")
    precharge = parameters.precharge_pressure.si / _PSI
    pressure.axhline(precharge, color="0.6", linestyle=":", label="precharge")
    flow.plot(time, record["pump_flow"] / _GPM, color="#009e73", label="pump")
    bank = parameters.accumulator_count.si * record["accumulator_oil"]
    given = -np.gradient(bank, time) / _GPM
    flow.plot(time, given, color="#e69f00", linewidth=0.9, label="accumulators")
    flow.axhline(parameters.pump_flow.si / _GPM, color="0.6", linestyle=":", label="pump's limit")
    if result.peak_relief_flow > 0.0:
        relief = relief_flow(parameters, record) / _GPM
        flow.plot(time, relief, color="#cc79a7", label="relief")
    flow.set_ylabel("flow [gpm]")
    oil.plot(time, bank / _GALLON, color="#e69f00")
    oil.set(ylabel="oil in accumulators\n[gal]", ylim=(0.0, 1.1 * float(bank.max()) / _GALLON))


def _motion(axis: Axes, result: CapacityResult) -> None:
    """Demand and response of the degrees of freedom that are asked to move."""
    record = result.record
    demand = record["demand_pose"]
    colours = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
    moved = [i for i in range(6) if np.ptp(demand[:, i]) > 0.0]
    names = [dof_unit(DOFS[i]) for i in moved]
    for i, unit in zip(moved, names, strict=True):
        dof = DOFS[i]
        asked = units.from_si(unit, demand[:, i])
        axis.plot(record.time, asked, color="0.6", linewidth=0.9, label=f"{dof} demanded")
        if "platform_pose" in record.channels:
            reached = units.from_si(unit, record["platform_pose"][:, i])
            axis.plot(record.time, reached, color=colours[i], label=dof)
    axis.set_ylabel(f"motion [{', '.join(dict.fromkeys(names)) or 'in'}]")


def envelope_figure(envelope: Envelope) -> Figure:
    """Velocity over frequency, log-log, with diagonals of displacement and acceleration."""
    count = len(envelope.asymptotes)
    columns = min(count, 3)
    rows = -(-count // columns)
    figure = Figure(figsize=(4.6 * columns + 0.4, 4.4 * rows + 1.0), layout="constrained")
    axes = np.atleast_1d(figure.subplots(rows, columns, squeeze=False)).ravel()
    for axis, own in zip(axes, envelope.asymptotes, strict=False):
        _envelope_panel(axis, envelope.of(own.dof), own)
    for axis in axes[count:]:
        axis.remove()
    found = {point.binding for point in envelope.points}
    handles = [Line2D([], [], color="0.15", linewidth=1.8, label="largest sine that holds")]
    handles += [
        Line2D([], [], color=colour, marker=marker, linestyle="", label=f"bound by {title}")
        for name, (title, marker, colour) in _BINDING.items()
        if name in found
    ]
    closed = [
        Line2D([], [], color=colour, linestyle=line, linewidth=1.0, label=f"closed form: {title}")
        for title, line, colour in _CLOSED.values()
    ]
    figure.legend(
        handles=[*handles, *closed], loc="outside lower center", ncols=columns, fontsize=8
    )
    figure.suptitle(
        f"{envelope.law}, {envelope.cab.upper()}, {envelope.hydraulics} hydraulics: "
        f"largest sustained sine with the manifold above {_psi(envelope.allowed_pressure)}"
    )
    return figure


def _envelope_panel(axis: Axes, points: list[EnvelopePoint], own: Asymptotes) -> None:
    length, turn = _scales(own.dof)
    unit = dof_unit(own.dof)
    held = [point for point in points if np.isfinite(point.velocity)]
    lowest = min(point.frequency for point in points)
    highest = max(max(point.frequency for point in points), 2.0 * lowest)
    frequency = np.geomspace(lowest, highest, 200)
    curves = [own.velocities(float(f)) for f in frequency]
    least = np.array([own.velocity(float(f)) for f in frequency]) / length
    speeds = [point.velocity / length for point in held] or list(least)
    bottom = 0.4 * min(*speeds, least.min())
    top = 3.0 * max(*speeds, least.max())
    axis.set(xscale="log", yscale="log", xlim=(lowest / 1.1, highest * 1.1), ylim=(bottom, top))
    _diagonals(axis, unit, length, turn)
    for name, (_, line, colour) in _CLOSED.items():
        values = np.array([curve[name] for curve in curves]) / length
        if np.isfinite(values).all():
            axis.plot(frequency, values, linestyle=line, color=colour, linewidth=1.0)
    axis.plot([point.frequency for point in held], speeds[: len(held)], color="0.15", linewidth=1.8)
    for point in held:
        _, marker, colour = _BINDING[point.binding]
        axis.plot(
            point.frequency, point.velocity / length, marker, color=colour, markersize=6, zorder=4
        )
    axis.set(xlabel="frequency [Hz]", ylabel=f"velocity amplitude [{unit}/s]", title=own.dof)
    axis.set_xticks(*_ticks(lowest / 1.1, 1.1 * highest))
    axis.set_yticks(*_ticks(bottom, top))
    axis.minorticks_off()


def _ticks(low: float, high: float) -> tuple[list[float], list[str]]:
    """Numbers 1, 2, 5 of every decade between two bounds, and how they are written."""
    every = [digit * 10.0**decade for decade in range(-6, 7) for digit in (1, 2, 5)]
    chosen = [value for value in every if low <= value <= high]
    return chosen, [f"{value:g}" for value in chosen]


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


def _label(axis: Axes, values: np.ndarray, label: str, *, rising: bool) -> None:
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
    folder.mkdir(parents=True, exist_ok=True)
    table, picture = folder / "capacity.csv", folder / "supply.png"
    lines = ["measure,value,definition\n"]
    lines += [",".join(f'"{cell}"' for cell in row) + "\n" for row in capacity_rows(result)]
    write_text(table, "".join(lines))
    supply_figure(result, parameters).savefig(picture, dpi=110)
    return [table, picture, result.record.save(folder / "capacity.parquet")]


def save_envelope(envelope: Envelope, folder: Path) -> list[Path]:
    """Write `envelope.csv` (SI) and `envelope.png`."""
    folder.mkdir(parents=True, exist_ok=True)
    picture = folder / "envelope.png"
    envelope_figure(envelope).savefig(picture, dpi=110)
    return [envelope.save_csv(folder / "envelope.csv"), picture]
