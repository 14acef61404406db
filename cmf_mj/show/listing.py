"""Tables of laws, hydraulic and sensor sets; replays."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from cmf_mj.control.law import Law
from cmf_mj.core.result import Field, Result
from cmf_mj.core.table import Table
from cmf_mj.electronics.sensors.settings import CHANNELS, SensorSettings
from cmf_mj.facility.replay import Replay
from cmf_mj.plant.parameters.hydraulics import HydraulicParameters
from cmf_mj.show.look import BLUE, ORANGE, save_figure, stack


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
