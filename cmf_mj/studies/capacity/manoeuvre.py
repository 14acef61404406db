"""Manoeuvres by name or from a file of poses, in the field's units at this edge.

A file has a column `time` [s] and one for each degree of freedom that moves, `surge`, `sway`,
`heave` [in], `roll`, `pitch`, `yaw` [deg], z down. Rows are joined by a monotone cubic (PCHIP),
which neither overshoots nor jumps in velocity, and sampled at 2048 Hz.
"""

from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

from cmf_mj import signals
from cmf_mj.core import units
from cmf_mj.core.errors import InputError, unknown_name
from cmf_mj.core.files import read_column, read_table
from cmf_mj.core.rates import RATE
from cmf_mj.machine.dof import dof_index, dof_unit
from cmf_mj.machine.geometry import DOFS
from cmf_mj.signals.signal import Command, Other

SIGNALS = ("sine", "step", "chirp", "noise", "multisine")
"""Manoeuvres with a name."""

_SIZES = {"sine": 15.0, "step": 10.0, "chirp": 1.0, "noise": 3.0, "multisine": 3.0}
"""Default amplitudes [in or deg]."""

_FREQUENCIES = {"sine": 0.25, "chirp": 2.0, "noise": 1.0, "multisine": 1.0}
"""Default frequency of the sine, and default highest frequency of the others [Hz]."""

_CYCLES, _SECONDS = 5.0, 20.0
"""A sine lasts so many cycles, and so long, at least."""


def manoeuvre(
    name: str | Path, dof: str, amplitude: float | None = None, frequency: float | None = None
) -> Command:
    """A manoeuvre by name or file.

    `name` is one of `SIGNALS`, or a CSV or Parquet file of poses. `amplitude` [m or rad] and
    `frequency` [Hz], the highest of a chirp, of noise and of a multisine, are for named signals.
    """
    kind = str(name)
    if kind not in SIGNALS:
        for field, value in (("amplitude", amplitude), ("frequency", frequency)):
            if value is not None:
                raise InputError(f"{field}: {value:g} is not allowed; a file of poses has its own")
        return read_poses(name)
    size = units.to_si(dof_unit(dof), _SIZES[kind]) if amplitude is None else amplitude
    if kind == "step":
        if frequency is not None:
            raise InputError(f"frequency: {frequency:g} Hz is not allowed; a step has none")
        return signals.step(dof, size)
    rate = _FREQUENCIES[kind] if frequency is None else frequency
    options: dict[str, Any] = {"stop": rate}
    if kind == "sine":
        signals.check_positive(frequency=rate)
        cycles = max(_CYCLES, np.ceil(_SECONDS * rate))
        options = {"frequency": rate, "cycles": cycles, "fade": 1.0 / rate}
    elif kind != "noise":
        options["fade"] = 1.0 if kind == "chirp" else 2.0
    command: Command = getattr(signals, kind)(dof, size, **options)
    return command


def read_poses(path: str | Path) -> Command:
    """Read a command from a CSV or Parquet file of poses."""
    source = Path(path)
    if source.suffix not in (".csv", ".parquet"):
        raise unknown_name("signal", str(path), SIGNALS, " nor a .csv or .parquet file")
    table = read_table(source)
    moved = [name for name in DOFS if name in table.column_names]
    if "time" not in table.column_names or not moved:
        raise InputError(
            f"{source}: has the columns {', '.join(table.column_names)}; needed: time and at "
            f"least one of {', '.join(DOFS)}"
        )
    columns = {name: read_column(source, table, name) for name in ("time", *moved)}
    for name, values in columns.items():
        for row in np.flatnonzero(~np.isfinite(values)):
            raise InputError(f"{source}: {name}: row {row + 1} is not a finite number")
    time = columns["time"]
    if time.size < 2:
        raise InputError(f"{source}: has {time.size} rows; at least 2 are needed")
    for row in np.flatnonzero(np.diff(time) <= 0.0):
        raise InputError(
            f"{source}: time: {time[row + 1]:g} s in row {row + 2} does not exceed "
            f"{time[row]:g} s before it"
        )
    frames = time[0] + np.arange(int(np.floor((time[-1] - time[0]) * RATE + 1e-6)) + 1) / RATE
    pose = np.zeros((frames.size, 6))
    for name in moved:
        history = units.to_si(dof_unit(name), columns[name])
        pose[:, dof_index(name)] = PchipInterpolator(time, history)(np.minimum(frames, time[-1]))
    return Command(pose, Other(kind="file", file=source.name, moved=moved))
