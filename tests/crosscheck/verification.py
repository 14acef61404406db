"""MuJoCo and Exudyn on the same valve commands: how far apart, and at what cost.

Every run is compared with one reference, the Exudyn runs with the two smallest steps h and h/2
extrapolated by Richardson's rule for order 2,

    y = y(h/2) + (y(h/2) - y(h)) / 3,

whose uncertainty is its distance from the same formed one step coarser. So an error of MuJoCo
is against another engine and another formulation, an error of Exudyn is its step error.
"""

import time as clock
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.units import RATE
from cmf_mj.facility.simulate import drive
from cmf_mj.machine.cab import Cab, load_cab
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters import HydraulicParameters, load_hydraulics
from crosscheck.machine import Machine, Trajectory

FREQUENCY, AMPLITUDE = (0.7, 1.1, 1.6, 2.1, 2.7, 3.3), (0.20, 0.15, 0.12, 0.10, 0.08, 0.06)
"""Of the valve sines, leg by leg [Hz], fractions."""

ENGINES = ("mujoco", "exudyn")


class Run(NamedTuple):
    """One run of one engine against the reference."""

    engine: str  #: One of `ENGINES`.
    step: float  #: [s].
    extension_error: float  #: Largest error of a leg extension at any frame [m].
    pressure_error: float  #: Largest error of a chamber pressure at any frame [Pa].
    cpu_time: float  #: [s].


class Verification(NamedTuple):
    """The runs of both engines and the reference they are compared with."""

    cab: str  #: Its name.
    seconds: float  #: Simulated time.
    runs: list[Run]  #: MuJoCo first, largest step first.
    travel: float  #: Largest extension [m].
    extension_uncertainty: float  #: Of the reference [m].
    pressure_uncertainty: float  #: Of the reference [Pa].


def valve_sines(seconds: float) -> NDArray[np.float64]:
    """Six different sines as valve commands, fractions, (N, 6) at 2048 Hz."""
    time = np.arange(round(seconds * RATE))[:, None] / RATE
    return np.array(AMPLITUDE) * np.sin(2.0 * np.pi * np.array(FREQUENCY) * time + np.arange(6.0))


def in_mujoco(
    valves: NDArray[np.float64], step: float, cab: Cab, hydraulics: HydraulicParameters
) -> Trajectory:
    """The shipped plant on valve commands, as a trajectory of N rows."""
    plant = Hexapod(cab, hydraulics, timestep=step)
    drive(plant, valves[:2])  # compiles, where the cache is empty
    begin = clock.process_time()
    record = drive(plant, valves)
    cpu_time = clock.process_time() - begin
    pressure = np.stack([record["cap_pressure"], record["rod_pressure"]], axis=-1)
    return Trajectory(step, record.time, record["leg_extension"], pressure, cpu_time)


def extrapolated(coarse: Trajectory, fine: Trajectory) -> Trajectory:
    """Richardson's extrapolation, order 2, of two runs of which one has half the step."""
    return fine._replace(
        extension=fine.extension + (fine.extension - coarse.extension) / 3.0,
        pressure=fine.pressure + (fine.pressure - coarse.pressure) / 3.0,
    )


def distance(first: Trajectory, second: Trajectory) -> tuple[float, float]:
    """Largest difference in extension [m] and in pressure [Pa] over the frames both have."""
    rows = min(len(first.time), len(second.time))
    return (
        float(np.abs(first.extension[:rows] - second.extension[:rows]).max()),
        float(np.abs(first.pressure[:rows] - second.pressure[:rows]).max()),
    )


def verify(
    cab: str | Path | Cab = "gfd",
    hydraulics: str | HydraulicParameters = "report",
    *,
    seconds: float = 4.0,
    parts: Sequence[int] = (1, 2, 4, 8),
    progress: Callable[[int, int], None] | None = None,
) -> Verification:
    """Drive both engines with `valve_sines` over several step sizes.

    The hydraulic set must have a constant supply and no losses. `parts` are mechanical steps to a
    control frame, at least three, each twice the one before; `progress` is called with (runs done,
    runs in all). Raises `MissingExtraError` without exudyn.
    """
    chosen, parameters = load_cab(cab), load_hydraulics(hydraulics)
    valves = valve_sines(seconds)
    machine = Machine(Hexapod(chosen, parameters))
    report = progress or (lambda done, total: None)
    trajectories: dict[str, list[Trajectory]] = {engine: [] for engine in ENGINES}
    total = 2 * len(parts)
    for done, count in enumerate(parts):
        step = 1.0 / (RATE * count)
        report(2 * done, total)
        trajectories["mujoco"].append(in_mujoco(valves, step, chosen, parameters))
        report(2 * done + 1, total)
        trajectories["exudyn"].append(machine.run(valves, step))
    report(total, total)
    coarse, middle, fine = trajectories["exudyn"][-3:]
    reference = extrapolated(middle, fine)
    runs = [
        Run(engine, one.step, *distance(one, reference), one.cpu_time)
        for engine in ENGINES
        for one in trajectories[engine]
    ]
    uncertainty = distance(extrapolated(coarse, middle), reference)
    travel = float(np.abs(reference.extension).max())
    return Verification(chosen.name, seconds, runs, travel, *uncertainty)
