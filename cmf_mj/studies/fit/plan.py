"""Campaigns: recordings that tell the numbers of a motion base, planned within its limits and made.

A plan is a folder. `campaign.toml` says what each recording is, `scenarios/NAME.toml` runs it here,
`host/NAME.csv` are the poses that the host of a real machine sends. Each begins at rest at neutral:

    hold          five poses, at rest: mass, centre of mass, null biases
    ramp          slow, out and back in heave, roll and surge: friction
    axes_small    a multisine in one degree of freedom after the other: leg speeds, lags, inertia
    axes_large    the same four times as large: what is not linear
    all_legs      multisines in all of them at once, off neutral: everything, together
    steps         pulses in one degree of freedom after the other: leakage, oil
    other_pose    as all_legs elsewhere, held back to test the fit
    other_law     as all_legs at neutral under another law, held back

Sizes are the largest whose demand uses, of the data sheet's machine, at most a share of the working
stroke, of the limits of leg speed and leg acceleration, and of the force the cylinders have left:

    max_t (|l| / stroke, |dl/dt| / speed, |d2l/dt2| / acceleration, |F - F_0| / left) = share

with F the static load where the demand is plus M_leg d2l/dt2, F_0 the one at neutral.
"""

import copy
import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomlkit
from numpy.typing import NDArray
from scipy import signal

from cmf_mj.control.law import Gains, Law, load_law
from cmf_mj.core.errors import InputError, within
from cmf_mj.core.files import write_text
from cmf_mj.core.settings import read_toml
from cmf_mj.core.threads import on_threads
from cmf_mj.facility.host.stream import from_command, write_stream
from cmf_mj.facility.run import Run
from cmf_mj.facility.scenario import load_scenario
from cmf_mj.facility.signal import LayeredDemand, added
from cmf_mj.facility.unknowns import load_unknowns
from cmf_mj.machine.cab import Cab
from cmf_mj.machine.geometry import DOFS, dof_index
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.machine.machine import Machine, load_machine
from cmf_mj.machine.models import CMF
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters import HydraulicParameters
from cmf_mj.plant.plant import Plant
from cmf_mj.record.columns import load_columns, write_facility_csv
from cmf_mj.record.record import Record
from cmf_mj.signals.signal import Command, plain
from cmf_mj.studies.asymptotes import stall_forces
from cmf_mj.studies.case import RECORDER
from cmf_mj.studies.fit.campaign import FILE
from cmf_mj.studies.tuning.search import save_law

Array = NDArray[np.float64]
Source = str | Path

SCENARIOS = "scenarios"  #: Folder of them in a campaign's.
LEAD = 1.0  #: Rest at neutral before each demand [s].
HOST_RATE = 128.0  #: Poses a second of the host files [Hz].
SAMPLES = 256  #: Samples a second of a record, of a facility's CSV half as many [Hz].
STEP_CORNER = 3.0  #: Of the critically damped low-pass at which a step's speed is judged [Hz].
BAND = (10.0, 25.0)  #: Least and most of the highest frequency of multisines [Hz].
SLOWER = 0.7  #: Gains of the law that is held back by default, over those of the law.
POSES = (
    {"heave": -1.0},
    {"heave": 0.6, "roll": 0.5},
    {"surge": 0.8, "pitch": -0.5},
    {"sway": -0.8, "roll": -0.4, "heave": -0.4},
    {"pitch": 0.7, "yaw": 0.5, "surge": -0.3},
)
"""Poses of `hold`, each degree of freedom in parts of what it reaches alone."""
_WHERE = ("machine", "cab")  #: Whose files are named by the way from the campaign's.
AWAY, ELSEWHERE = POSES[1] | {"surge": 0.4}, POSES[4] | {"heave": -0.4}


class Planned(NamedTuple):
    """One recording of a plan."""

    kind: str
    pose: str  #: Where, in words.
    changes: Callable[[float], list[dict[str, Any]]]  #: Of a scenario, by their size.
    part: float = 1.0  #: Of the largest size.
    held_back: bool = False
    other_law: bool = False


def plan_campaign(
    machine: Source,
    cab: Source | None,
    hydraulics: Source | None,
    law: Source | None,
    folder: Source,
    *,
    seconds: float = 20.0,
    share: float = 0.4,
    other_law: Source | None = None,
) -> Path:
    """Write a plan for a machine as its data sheet has it; its `campaign.toml` comes back.

    Machine, cab, hydraulics and laws are names or TOML files, by default the machine's; `seconds`
    is the length of each of the eight recordings. The law that is held back is by default the other
    at `SLOWER` of its gains, since a law made for another machine may ring. Files of laws and
    hydraulics are copied into the folder; those of machine and cab, which name others, stay where
    they are. A folder that holds a campaign is refused.
    """
    target = Path(folder)
    if (target / FILE).exists():
        raise InputError(f"folder: {target} holds a campaign, which is kept; allowed: another one")
    for field, value, low, high in (("seconds", seconds, 10, 600), ("share", share, 0.05, 0.9)):
        if not low <= value <= high:
            raise InputError(f"{field}: {value:g} is refused; allowed: {low} to {high}")
    sheet = {"machine": machine, "cab": cab, "hydraulics": hydraulics, "law": law}
    named = {name: str(one) for name, one in sheet.items() if one is not None}
    space = Workspace(Hexapod(cab, hydraulics, machine=machine), share)
    if named.get("law") == space.machine.law:
        del named["law"]
    held = _kept("other_law", other_law, target) if other_law is not None else ""
    named |= {name: _kept(name, one, target) for name, one in named.items() if name not in _WHERE}
    every = max(round(space.machine.rate / (RECORDER if space.machine.name == CMF else SAMPLES)), 1)
    usual = {"duration": seconds, "electronics": "noisy", "record_every": every}
    held = held or str(_slower(load_law(law or space.machine.law), target / "other_law.toml"))
    tables = {}
    for name, one in _planned(space, seconds - LEAD).items():
        law_ = {"law": held} if one.other_law else {}
        run = space.fitted(one, named | usual | law_ | {"title": f"{name}: {one.pose}"})
        scenario = run.table() | {"law": None} | named_beside(named | law_, target / SCENARIOS)
        text = tomlkit.dumps({key: value for key, value in scenario.items() if value is not None})
        source = write_text(target / SCENARIOS / f"{name}.toml", text).relative_to(target)
        command = Command.from_pose(demand(run), run.rate)
        write_host(command, target / f"host/{name}.csv", held=one.kind == "step")
        said = {"kind": one.kind, "held_back": one.held_back, "pose": one.pose}
        tables[name] = said | named_beside(law_, target) | {"source": source.as_posix()}
    head = named_beside(named, target) | {"recordings": tables}
    return write_text(target / FILE, tomlkit.dumps(head))


def write_host(command: Command, path: Path, *, held: bool) -> None:
    """Write a command as a host's frames; between those of steps the demand is `held`."""
    how = "zero" if held else "spline"
    write_stream(from_command(command, min(HOST_RATE, command.rate), derivatives=how), path)


def _kept(name: str, source: Source, folder: Path) -> str:
    """A name as it is; of a file a copy in the folder, so that the campaign can be sent."""
    file, ending, one = str(source).rpartition(".toml")
    if not ending:
        return str(source)
    text = Path(file + ending).read_text(encoding="utf-8")
    return f"{write_text(folder / f'{name}.toml', text)}{one}"


def _slower(law: Law, file: Path) -> Path:
    """A file of the law with its whole feedback at `SLOWER`."""
    gains = {name: (SLOWER * np.asarray(gain)).tolist() for name, gain in law.direct_gain}
    changes: dict[str, Any] = {"name": f"{law.name}_slower", "title": f"{law.title}, slower"}
    changes |= {"direct_gain": Gains(**gains), "output_gain": SLOWER * law.output_gain}
    return save_law(law.model_copy(update=changes), file, "For a recording that is held back.")


def named_beside(named: Mapping[str, str], folder: Path) -> dict[str, str]:
    """Names as they are, and files as they are named in a folder."""
    files = {key: os.path.relpath(one, folder) for key, one in named.items() if ".toml" in one}
    return {**named} | files


def _on_rows(time: float) -> float:
    """The nearest time that a row of every recording has."""
    return round(time * RECORDER) / RECORDER


def demand(run: Run) -> Array:
    """Poses of all frames of a run of signals (N, 6) [m, rad], z down."""
    layered = LayeredDemand(added(run.signal, run.seed, run.rate))
    for change in run.change:
        motion = added(change.signal or (), run.seed, run.rate)
        layered.change(change.when(run.rate), motion, round(change.fade * run.rate))
    return layered.poses(0, run.frames or 0)


class Workspace:
    """What a machine leaves to a demand, and signals that take their share of it."""

    def __init__(self, plant: Hexapod, share: float) -> None:
        """Take strokes, limits, masses and forces of the data sheet's machine."""
        self.machine, self._plant, self.share = plant.machine, plant, share
        self._mass, self._load = plant.reflected_mass(np.zeros(6)), plant.static_load()
        push, pull = stall_forces(plant.hydraulics).T
        self._left = np.minimum(push - self._load, self._load + pull)
        limits = load_motion_limits(None, self.machine)
        self._limits, self.reach = limits.leg, np.abs(limits.operational).min(axis=1)
        highest = 1.2 * plant.hydraulic_modes().frequency_hz.max()
        self.top = _rounded(np.clip(highest, *BAND))  #: Highest frequency of multisines [Hz].

    def use(self, poses: Array, corner: float | None = None) -> float:
        """Largest share that poses (N, 6) use, behind a low-pass with this `corner` [Hz]."""
        rate = self.machine.rate
        if corner is not None:
            pole = np.exp(-2.0 * np.pi * corner / rate)
            poses = signal.lfilter([(1.0 - pole) ** 2], [1.0, -2.0 * pole, pole**2], poses, axis=0)
        legs = pose_to_legs(poses, self.machine)
        stroke = float(np.abs(legs).max() / self.machine.working_stroke)
        if stroke > 1.0:  # where no static load is known
            return stroke
        speed = np.diff(legs, axis=0) * rate
        acceleration = np.diff(speed, axis=0) * rate
        still = []
        for pose in poses[:: max(len(poses) // 20, 1)]:
            self._plant.place(pose)
            still.append(np.abs(self._plant.static_load() - self._load).max(axis=0))
        force = np.abs(acceleration @ self._mass.T) + np.max(still)
        shares = (
            np.abs(speed) / self._limits.velocity.si,
            np.abs(acceleration) / self._limits.acceleration.si,
            force / self._left,
        )
        return max(stroke, *(float(share.max()) for share in shares))

    def fitted(self, one: Planned, how: Mapping[str, Any]) -> Run:
        """The recording at its part of the largest size, as a run."""

        def run(size: float) -> Run:
            return Run(**how, change=plain(one.changes(size)))

        corner = STEP_CORNER if one.kind == "step" else None
        size = self.largest(lambda size: demand(run(size)), self.share, corner)
        return run(one.part * size)

    def largest(
        self, made: Callable[[float], Array], share: float, corner: float | None = None
    ) -> float:
        """Size with which the poses that are made of it use a share, or up to 3 % less."""
        size = share
        for _ in range(12):
            used = self.use(made(size), corner)
            if 0.97 * share < used <= share:
                break
            size *= 0.99 * share / used
        return size

    def pose(self, direction: Mapping[str, float], part: float) -> Array:
        """A pose in this direction where the first leg has used a part of its working stroke."""
        unit = np.array([direction.get(dof, 0.0) for dof in DOFS]) * self.reach
        pose = 0.5 * part * unit
        for _ in range(20):
            used = np.abs(pose_to_legs(pose, self.machine)).max() / self.machine.working_stroke
            pose = pose * (part / used)
        return pose

    def multisine(self, dof: str, size: float, span: float, seed: int) -> dict[str, Any]:
        """Two periods in one degree of freedom that take `span` [s] with their fades."""
        rate, fade = self.machine.rate, min(0.15 * span, 2.0)
        period = float(np.floor(0.5 * (span - fade) * rate) / rate)
        lines = {"stop": self.top, "period": period, "periods": 2, "fade": fade, "seed": seed}
        how = {"amplitude": _rounded(size * self.reach[dof_index(dof)]), "spectrum": "acceleration"}
        return {"kind": "multisine", "dof": dof} | how | lines


def _rounded(value: Any) -> Any:
    return (np.round(value, 6) + 0.0).tolist()


def _path(times: Sequence[float], poses: Sequence[Array]) -> dict[str, Any]:
    """Poses at rest, joined by paths of least jerk."""
    return {"kind": "waypoints", "times": _rounded(times), "poses": _rounded(poses)}


def _planned(space: Workspace, span: float) -> dict[str, Planned]:
    """The recordings, of so many seconds after the rest at neutral."""
    neutral, slot = np.zeros(6), span / len(DOFS)

    def once(*signals: dict[str, Any]) -> list[dict[str, Any]]:
        return [{"at": LEAD, "fade": 0.0, "signal": list(signals)}]

    def hold(size: float) -> list[dict[str, Any]]:
        poses = np.repeat([neutral, *(space.pose(one, size) for one in POSES)], 2, axis=0)
        moves = [0.5 * (i + 1) * slot for i in range(2 * len(POSES))]
        return once(_path([0.0, *moves, span], list(poses)))

    def ramp(size: float) -> list[dict[str, Any]]:
        out = [space.pose({dof: 1.0}, size) for dof in ("heave", "roll", "surge")]
        poses = [neutral, *(sign * pose for pose in out for sign in (1.0, -1.0)), neutral]
        return once(_path(np.linspace(0.0, span, len(poses)).tolist(), poses))

    def axes(size: float) -> list[dict[str, Any]]:
        return [
            {"at": LEAD + i * slot, "fade": 0.0, "signal": [space.multisine(dof, size, slot, i)]}
            for i, dof in enumerate(DOFS)
        ]

    def steps(size: float) -> list[dict[str, Any]]:
        one = {"kind": "pulse", "width": _on_rows(0.4 * slot)}
        sizes = enumerate(_rounded(size * space.reach))
        pulses = (
            {"dof": DOFS[i], "amplitude": a, "at": _on_rows((i + 0.2) * slot)} for i, a in sizes
        )
        return once(*(one | pulse for pulse in pulses))

    def everything(first: int, where: Mapping[str, float] | None, size: float) -> Any:
        moved = []
        if where is not None:
            pose = space.pose(where, 0.5 * space.share)
            moved = [_path([0.0, 2.0, span - 2.0, span], [neutral, pose, pose, neutral])]
        seeded = enumerate(DOFS, first)
        return once(*moved, *(space.multisine(dof, size, span, seed) for seed, dof in seeded))

    multisine = partial(Planned, "multisine")
    return {
        "hold": Planned("hold", "five poses", hold),
        "ramp": Planned("ramp", "about neutral", ramp, 0.25),
        "axes_small": multisine("neutral", axes, 0.25),
        "axes_large": multisine("neutral", axes),
        "all_legs": multisine("up, rolled and ahead", partial(everything, 10, AWAY)),
        "steps": Planned("step", "neutral", steps),
        "other_pose": multisine("pitched and yawed", partial(everything, 20, ELSEWHERE), 1.0, True),
        "other_law": multisine("neutral", partial(everything, 30, None), 1.0, True, True),
    }


def record_campaign(
    folder: Source,
    *,
    machine: Source | Machine | None = None,
    cab: Source | Cab | None = None,
    hydraulics: Source | HydraulicParameters | None = None,
    seed: int = 0,
    jobs: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Record a plan on a simulated machine, and name its files in `campaign.toml`.

    Machine, cab and hydraulics are names, TOML files or loaded, by default those of the data sheet.
    Actuators that are all alike get unequal valves, `valve_gains` by the seed, which is also that
    of the noise. Files are the facility's CSV for the CMF, else the project's own records; they
    hold the channels of that CSV, the demand and the data sheet, and no number of the machine.
    `progress` is called with (recordings done, in all).
    """
    place = Path(folder) / FILE
    names = list(read_toml(place).get("recordings", ()))
    if not names:
        raise InputError(f"{place}: recordings: are missing; allowed: at least one")
    table = tomlkit.parse(place.read_text(encoding="utf-8"))
    said = table["recordings"]
    runs = {name: load_scenario(place.parent / said[name]["source"]) for name in names}
    sheet, kept = runs[names[0]], ("demand_pose", *load_columns().channels)
    about = load_machine(sheet.machine).known()
    if machine is None:
        machine, cab = sheet.machine, cab or sheet.cab
        hydraulics = hydraulics or sheet.hydraulics
    plant: Plant = Hexapod(cab, hydraulics, machine=machine)
    if not plant.parameters.actuators:
        gains = load_unknowns("valve_gains")
        plant = gains.apply(gains.draw("random", 1, seed)[0], plant)

    def made(name: str) -> str:
        noise = np.random.SeedSequence(seed, spawn_key=(names.index(name),)).generate_state(1)
        with within(name):
            run = runs[name].but(plant=copy.deepcopy(plant), seed=int(noise[0])).record()
        known = {key: run.metadata[key] for key in ("sample_rate", "law")} | about
        channels = {key: run[key] for key in kept if key in run.channels}
        units = {key: run.units[key] for key in channels}
        record = Record(run.time, channels, units, known | {"command": {"kind": "scenario"}})
        if plant.machine.name == CMF:
            return write_facility_csv(record, place.parent / f"{name}.csv").name
        return record.save(place.parent / f"{name}.parquet").name

    for name, file in zip(names, on_threads(made, names, jobs, progress), strict=True):
        said[name]["file"] = file
    return write_text(place, tomlkit.dumps(table))
