"""Closed loops in MuJoCo over their whole runs: energy, gap, error of a point, CPU time.

The errors are the library's: of A02, A03 and A04 the largest change of the mechanical energy less
the motor's work, of A05 the largest error of the slider. The gap is the largest distance of two
pinned points. The hexapod, on legs of `STIFFNESS` without hydraulics, is dropped from neutral.

`python tests/crosscheck --loops` writes both tables.
"""

import math
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from cmf_mj import Hexapod
from cmf_mj.core.result import Table
from cmf_mj.show.look import save_files
from crosscheck import mechanisms
from crosscheck.mechanisms import Array, Mechanism

STIFFNESS = 4e5
"""Of a leg of the hexapod [N/m]: it sinks by some centimetres."""
DEFAULT = ((0.02, 1.0), (0.9, 0.95, 1e-3, 0.5, 2.0))
"""`solref` and `solimp` of MuJoCo where a model gives none."""
HOLD = (0.9999, 0.9999, 1e-3, 0.5, 2.0)
"""`solimp` of the hexapod's pins."""
INTEGRATORS = {
    "Euler": mujoco.mjtIntegrator.mjINT_EULER,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    "discrete": mujoco.mjtIntegrator.mjINT_DISCRETE,
    "RK4": mujoco.mjtIntegrator.mjINT_RK4,
}
SOLVERS = {
    "Newton": mujoco.mjtSolver.mjSOL_NEWTON,
    "CG": mujoco.mjtSolver.mjSOL_CG,
    "PGS": mujoco.mjtSolver.mjSOL_PGS,
}


class Settings(NamedTuple):
    """How a model is solved and integrated."""

    integrator: str = "Euler"
    pins: str = "hexapod"  #: "hexapod": solref of two steps, `HOLD`; "default".
    parts: int = 1  #: Steps in the mechanism's step.
    solver: str = "Newton"

    def __str__(self) -> str:
        solver = "" if self.solver == "Newton" else f", {self.solver}"
        return f"{self.integrator}, {self.pins} pins{solver}"


TRIED = (
    Settings("Euler", "default"),
    Settings("Euler"),
    Settings("implicitfast"),
    Settings("discrete"),
    Settings("RK4"),
    Settings("RK4", "default"),
    Settings("Euler", parts=4),
    Settings("Euler", solver="CG"),
    Settings("Euler", solver="PGS"),
)


class Outcome(NamedTuple):
    """A run of a mechanism, or a published one; NaN where nothing is said."""

    mechanism: str
    engine: str
    settings: str
    step: float  #: [s]
    energy: float  #: Largest error of the energy [J].
    drift: float  #: Its error at the end [J].
    gap: float  #: [m]
    point: float  #: Largest error of B0, P3 or the slider, of A03 of F at 0.03 s [m].
    cpu_time: float  #: [s]


def model_of(mechanism: Mechanism, settings: Settings) -> mujoco.MjModel:
    """The model with settings; `warmstart` and `island` off, as in the hexapod's."""
    head = '<mujoco><compiler angle="radian"/><default><default class="pin"/></default>'
    options = f'<option gravity="{mechanism.gravity}"/>'
    model = mujoco.MjModel.from_xml_string(f"{head}{options}{mechanism.bodies}</mujoco>")
    return with_settings(model, settings, mechanism.step)


def with_settings(model: mujoco.MjModel, settings: Settings, step: float) -> mujoco.MjModel:
    """The same model, solved and integrated in another way."""
    step /= settings.parts
    model.opt.timestep, model.opt.integrator = step, INTEGRATORS[settings.integrator]
    model.opt.solver = SOLVERS[settings.solver]
    flags = mujoco.mjtDisableBit
    for flag in (flags.mjDSBL_CONTACT, flags.mjDSBL_WARMSTART, flags.mjDSBL_ISLAND):
        model.opt.disableflags |= flag
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    given = DEFAULT if settings.pins == "default" else ((2.0 * step, 1.0), HOLD)
    model.eq_solref[:], model.eq_solimp[:] = given
    return model


class Run(NamedTuple):
    """States at the begin of every step and at the end, and what was measured there."""

    positions: Array  #: (K, nq).
    points: Array  #: Positions of all sites, (K, sites, 3).
    energy: Array  #: (K,).
    gap: float
    cpu_time: float


def simulate(
    model: mujoco.MjModel, steps: int, begin: Callable[[Any], None] = lambda _: None
) -> Run:
    """`steps` steps from the start; the time is that of a second run, without looking."""
    data, again = mujoco.MjData(model), mujoco.MjData(model)
    begin(data)
    begin(again)
    positions, points = np.empty((steps + 1, model.nq)), np.empty((steps + 1, model.nsite, 3))
    energy, gap = np.empty(steps + 1), 0.0
    for index in range(steps + 1):
        mujoco.mj_forward(model, data)
        positions[index], points[index] = data.qpos, data.site_xpos
        energy[index], apart = data.energy.sum(), data.efc_pos[: data.ne].reshape(-1, 3)
        gap = max(gap, float(np.linalg.norm(apart, axis=1).max(initial=0.0)))
        mujoco.mj_step(model, data)
    begun = time.process_time()
    mujoco.mj_step(model, again, nstep=steps)
    return Run(positions, points, energy, gap, time.process_time() - begun)


def run(mechanism: Mechanism, settings: Settings) -> tuple[Run, Array]:
    """A mechanism's whole run, and its times."""
    model = model_of(mechanism, settings)

    def begin(data: Any) -> None:
        data.qpos[:] = mechanism.start or 0.0
        data.qvel[:] = mechanism.speed or 0.0
        data.qfrc_applied[0] = mechanism.torque

    steps = round(mechanism.seconds / model.opt.timestep)
    return simulate(model, steps, begin), np.arange(steps + 1) * model.opt.timestep


def outcome(mechanism: Mechanism, settings: Settings) -> Outcome:
    """A mechanism with settings, by the errors of the library."""
    found, times = run(mechanism, settings)
    turned = found.positions[:, 0] - found.positions[0, 0]
    change = found.energy - found.energy[0] - mechanism.torque * turned
    energy, drift = float(np.abs(change).max()), float(change[-1])
    if mechanism.name.startswith("A05"):  # dampers take energy
        energy = drift = float("nan")
    point = point_error(mechanism.name, found, times)
    return _outcome(mechanism.name, settings, times[1], energy, drift, found, point)


def _outcome(name: str, settings: Settings, step: float, *rest: Any) -> Outcome:
    energy, drift, found, point = rest
    engine = f"MuJoCo {mujoco.__version__}"
    measured = energy, drift, found.gap, point, found.cpu_time
    return Outcome(name, engine, str(settings), float(step), *measured)


@cache
def _reference(name: str, count: int, step: float) -> Array:
    """B0, P3 or the slider's height, (count, 3), (count, 2) or (count, 1)."""
    times: Array = np.arange(count, dtype=np.float64) * step
    if name.startswith("A02"):
        return mechanisms.four_bars_reference(times)
    if name.startswith("A04"):
        return mechanisms.bricard_reference(times)
    return mechanisms.flyballs_reference(times)[:, None]


def point_error(name: str, found: Run, times: Array) -> float:
    """Largest distance from the reference, 1024 times a second; of A03 that of F at 0.03 s."""
    if name.startswith("A03"):
        at = round(mechanisms.TESTSET_TIME / times[1])
        there, true = found.positions[at, 0], mechanisms.TESTSET[0]
        return float(mechanisms.CRANK * abs(np.exp(1j * there) - np.exp(1j * true)))
    every = slice(None, None, max(1, round(1.0 / 1024.0 / times[1])))
    at = times[every]
    if name.startswith("A02"):
        angle = found.positions[every, 0]  # counts the other way round
        there = np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    elif name.startswith("A04"):
        there = mechanisms.bricard_points(found.positions[every])
    else:
        there = found.positions[every, 1:2]
    error = there - _reference(name, len(at), float(at[1]))
    return float(np.linalg.norm(error, axis=1).max())


def hexapod(settings: Settings, seconds: float = 10.0) -> Outcome:
    """The CMF with its shipped cab on springs for legs, let go at neutral."""
    plant = Hexapod()
    model = with_settings(plant.model, settings, plant.model.opt.timestep)
    slides = model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
    model.jnt_stiffness[slides], model.actuator_gainprm[:] = STIFFNESS, 0.0
    steps = round(seconds / model.opt.timestep)
    found = simulate(model, steps)
    change = found.energy - found.energy[0]
    rest = float(np.abs(change).max()), float(change[-1]), found, float("nan")
    return _outcome("CMF hexapod on springs", settings, model.opt.timestep, *rest)


NAN = math.nan
PUBLISHED = (
    Outcome("A02 N-four-bar", "OpenSim 3.2", "Padova", NAN, NAN, NAN, NAN, NAN, 0.455),
    Outcome("A02 N-four-bar", "Exudyn", "its example", 5e-4, 2.858041366e-4, NAN, NAN, NAN, NAN),
    Outcome("A03 Andrews' squeezer", "OpenSim 3.2", "Padova", NAN, NAN, NAN, NAN, NAN, 0.384),
    Outcome("A04 Bricard", "OpenSim 3.2", "Padova", NAN, NAN, NAN, NAN, NAN, 0.258),
    Outcome("A05 flyballs", "OpenSim 3.2", "Padova", NAN, NAN, NAN, NAN, NAN, 0.233),
)
"""What others print of the same runs. OpenSim's times are of an Intel i5-4570 at 3.2 GHz."""
LOOPS = (mechanisms.four_bars, mechanisms.squeezer, mechanisms.bricard)
FIRST = {make().name: make().step for make in LOOPS}
"""Steps without parts [s]."""
DAMPERS = (Settings("implicitfast"), Settings("discrete"), Settings("discrete", parts=4))


def _shown(value: float, factor: float = 1.0, form: str = ".3g") -> str:
    return "" if math.isnan(value) else f"{value * factor:{form}}"


def settings_table(outcomes: list[Outcome]) -> Table:
    """A row a setting: errors of the energy and gaps, of three mechanisms and of the hexapod."""
    names = list(dict.fromkeys(one.mechanism for one in outcomes))
    columns = (
        *("integrator and pins", "steps"),
        *(f"{name.split()[0]} energy [J]" for name in names),
        *(f"{name.split()[0]} gap [um]" for name in names),
        "CMF [us a step]",
    )
    rows = []
    for index, settings in enumerate(TRIED):
        here = outcomes[index :: len(TRIED)]
        steps = round(10.0 / here[-1].step)
        cells = [_shown(one.energy) for one in here] + [_shown(one.gap, 1e6) for one in here]
        cost = _shown(here[-1].cpu_time / steps, 1e6, ".0f")
        rows.append((str(settings), f"1/{round(1.0 / here[-1].step)} s", *cells, cost))
    return Table("", columns, rows)


def library_table(outcomes: list[Outcome]) -> Table:
    """A row a run of a mechanism, ours and those of others."""
    columns = (
        *("mechanism", "program", "settings", "step [s]", "energy error [J]"),
        *("error of a point [mm]", "CPU time [s]"),
    )
    rows = [
        (
            *(one.mechanism, one.engine, one.settings, _shown(one.step), _shown(one.energy)),
            *(_shown(one.point, 1e3), _shown(one.cpu_time, 1.0, ".2f")),
        )
        for one in sorted([*outcomes, *PUBLISHED], key=lambda one: one.mechanism)
    ]
    return Table("", columns, rows)


def save_loops(folder: Path) -> list[Path]:
    """Write `closed_loops.csv` and `closed_loops_library.csv`."""
    loops = [outcome(make(), settings) for make in LOOPS for settings in TRIED]
    shown = {str(Settings("Euler")), str(Settings("RK4"))}
    ours = [one for one in loops if one.settings in shown and one.step == FIRST[one.mechanism]]
    balls = [outcome(mechanisms.flyballs(), settings) for settings in DAMPERS]
    tables = {
        "closed_loops.csv": settings_table([*loops, *(hexapod(each) for each in TRIED)]),
        "closed_loops_library.csv": library_table([*ours, *balls]),
    }
    return save_files(tables, folder)
