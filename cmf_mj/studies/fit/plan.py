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
from cmf_mj.signals.signal import Command, as_plain
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
TOP_RANGE = (10.0, 25.0)  #: Least and most of the highest frequency of multisines [Hz].
SLOWER_GAINS = 0.7  #: Gains of the other law, over those of the law.
POSES = (
    {"heave": -1.0},
    {"heave": 0.6, "roll": 0.5},
    {"surge": 0.8, "pitch": -0.5},
    {"sway": -0.8, "roll": -0.4, "heave": -0.4},
    {"pitch": 0.7, "yaw": 0.5, "surge": -0.3},
)
"""Poses of `hold`, each degree of freedom in parts of what it reaches alone."""
OFF_NEUTRAL = {"heave": 0.6, "roll": 0.5, "surge": 0.4}  #: Pose of `all_legs`, in the same parts.
OTHER_POSE = {"pitch": 0.7, "yaw": 0.5, "surge": -0.3, "heave": -0.4}  #: Pose of `other_pose`.
_UNCOPIED = ("machine", "cab")  #: Their files are not copied.


class PlannedRecording(NamedTuple):
    """One recording of a plan."""

    kind: str
    pose: str  #: In words.
    changes: Callable[[float], list[dict[str, Any]]]  #: Of a scenario, by the size of its motion.
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
    """Write a plan for a machine as its data sheet has it; returns the path of `campaign.toml`.

    Machine, cab, hydraulics and laws are names or TOML files, by default the machine's; `seconds`
    is the length of each of the eight recordings. The law that is held back is by default the other
    at `SLOWER_GAINS` of its gains, since a law made for another machine may ring. Files of laws and
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
    sources = {name: str(source) for name, source in sheet.items() if source is not None}
    workspace = Workspace(Hexapod(cab, hydraulics, machine=machine), share)
    if sources.get("law") == workspace.machine.law:
        del sources["law"]
    other = _copy_file("other_law", other_law, target) if other_law is not None else ""
    copied = [name for name in sources if name not in _UNCOPIED]
    sources |= {name: _copy_file(name, sources[name], target) for name in copied}
    rate = RECORDER if workspace.machine.name == CMF else SAMPLES
    record_every = max(round(workspace.machine.rate / rate), 1)
    settings = {"duration": seconds, "electronics": "noisy", "record_every": record_every}
    if not other:
        own_law = load_law(law or workspace.machine.law)
        other = str(_save_slower_law(own_law, target / "other_law.toml"))
    tables = {}
    for name, planned in _planned_recordings(workspace, seconds - LEAD).items():
        law_entry = {"law": other} if planned.other_law else {}
        own_settings = law_entry | {"title": f"{name}: {planned.pose}"}
        run = workspace.run_of(planned, sources | settings | own_settings)
        scenario = run.table() | {"law": None} | paths_from(target / SCENARIOS, sources | law_entry)
        text = tomlkit.dumps({key: value for key, value in scenario.items() if value is not None})
        source = write_text(target / SCENARIOS / f"{name}.toml", text).relative_to(target)
        command = Command.from_pose(demand(run), run.rate)
        write_host(command, target / f"host/{name}.csv", is_held=planned.kind == "step")
        table = {"kind": planned.kind, "held_back": planned.held_back, "pose": planned.pose}
        tables[name] = table | paths_from(target, law_entry) | {"source": source.as_posix()}
    head = paths_from(target, sources) | {"recordings": tables}
    return write_text(target / FILE, tomlkit.dumps(head))


def write_host(command: Command, path: Path, *, is_held: bool) -> None:
    """Write a command as a host's frames, between which the demand of steps `is_held`."""
    derivatives = "zero" if is_held else "spline"
    frames = from_command(command, min(HOST_RATE, command.rate), derivatives=derivatives)
    write_stream(frames, path)


def _copy_file(name: str, source: Source, folder: Path) -> str:
    """Copy a file into the folder, so that the campaign can be sent; a name stays as it is."""
    stem, ending, entry = str(source).rpartition(".toml")
    if not ending:
        return str(source)
    text = Path(stem + ending).read_text(encoding="utf-8")
    return f"{write_text(folder / f'{name}.toml', text)}{entry}"


def _save_slower_law(law: Law, file: Path) -> Path:
    """A file of the law with its whole feedback at `SLOWER_GAINS`."""
    gains = {name: (SLOWER_GAINS * np.asarray(gain)).tolist() for name, gain in law.direct_gain}
    changes: dict[str, Any] = {"name": f"{law.name}_slower", "title": f"{law.title}, slower"}
    changes |= {"direct_gain": Gains(**gains), "output_gain": SLOWER_GAINS * law.output_gain}
    return save_law(law.model_copy(update=changes), file, "For a recording that is held back.")


def paths_from(folder: Path, sources: Mapping[str, str]) -> dict[str, str]:
    """Names as they are, and files by their paths from a folder."""
    files = {k: os.path.relpath(file, folder) for k, file in sources.items() if ".toml" in file}
    return {**sources} | files


def _row_time(time: float) -> float:
    """The nearest time that a row of every recording has."""
    return round(time * RECORDER) / RECORDER


def demand(run: Run) -> Array:
    """Poses of all frames of a run of signals (N, 6) [m, rad], z down."""
    layered = LayeredDemand(added(run.signal, run.seed, run.rate))
    for change in run.change:
        motion = added(change.signal or (), run.seed, run.rate)
        layered.change(change.at_frame(run.rate), motion, round(change.fade * run.rate))
    return layered.poses(0, run.frames or 0)


class Workspace:
    """What a machine allows of motion, and signals that use a share of it."""

    def __init__(self, plant: Hexapod, share: float) -> None:
        """Take strokes, limits, masses and forces of the data sheet's machine."""
        self.machine, self._plant, self.share = plant.machine, plant, share
        self._mass = plant.reflected_mass(np.zeros(6))  # which places the plant at neutral
        self._load = plant.static_load()
        push, pull = stall_forces(plant.hydraulics).T
        self._spare_force = np.minimum(push - self._load, self._load + pull)
        limits = load_motion_limits(None, self.machine)
        self._limits, self.reach = limits.leg, np.abs(limits.operational).min(axis=1)
        highest = 1.2 * plant.hydraulic_modes().frequency_hz.max()
        self.top = _rounded(np.clip(highest, *TOP_RANGE))  #: Highest frequency of multisines [Hz].

    def used_share(self, poses: Array, corner: float | None = None) -> float:
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
        load_changes = []
        for pose in poses[:: max(len(poses) // 20, 1)]:
            self._plant.place(pose)
            load_changes.append(np.abs(self._plant.static_load() - self._load).max(axis=0))
        force = np.abs(acceleration @ self._mass.T) + np.max(load_changes)
        shares = (
            np.abs(speed) / self._limits.velocity.si,
            np.abs(acceleration) / self._limits.acceleration.si,
            force / self._spare_force,
        )
        return max(stroke, *(float(share.max()) for share in shares))

    def run_of(self, planned: PlannedRecording, settings: Mapping[str, Any]) -> Run:
        """The recording at its part of the largest size, as a run with other `settings`."""

        def run(size: float) -> Run:
            return Run(**settings, change=as_plain(planned.changes(size)))

        corner = STEP_CORNER if planned.kind == "step" else None
        size = self.largest_size(lambda size: demand(run(size)), self.share, corner)
        return run(planned.part * size)

    def largest_size(
        self, poses_of: Callable[[float], Array], share: float, corner: float | None = None
    ) -> float:
        """Size whose poses, by `poses_of`, use a share, or up to 3 % less."""
        size = share
        for _ in range(12):
            used = self.used_share(poses_of(size), corner)
            if 0.97 * share < used <= share:
                break
            size *= 0.99 * share / used
        return size

    def pose(self, direction: Mapping[str, float], part: float) -> Array:
        """A pose in this direction where the first leg has used a part of its working stroke."""
        unit = np.array([direction.get(dof, 0.0) for dof in DOFS]) * self.reach
        pose = 0.5 * part * unit
        for _ in range(20):
            used_part = np.abs(pose_to_legs(pose, self.machine)).max() / self.machine.working_stroke
            pose = pose * (part / used_part)
        return pose

    def multisine(self, dof: str, size: float, span: float, seed: int) -> dict[str, Any]:
        """Two periods in one degree of freedom that take `span` [s] with their fades."""
        rate, fade = self.machine.rate, min(0.15 * span, 2.0)
        amplitude = _rounded(size * self.reach[dof_index(dof)])
        period = float(np.floor(0.5 * (span - fade) * rate) / rate)
        spectrum = {"spectrum": "acceleration", "stop": self.top, "seed": seed}
        times = {"period": period, "periods": 2, "fade": fade}
        return {"kind": "multisine", "dof": dof, "amplitude": amplitude} | spectrum | times


def _rounded(value: Any) -> Any:
    return (np.round(value, 6) + 0.0).tolist()


def _waypoints(times: Sequence[float], poses: Sequence[Array]) -> dict[str, Any]:
    """Poses at rest, joined by paths of least jerk."""
    return {"kind": "waypoints", "times": _rounded(times), "poses": _rounded(poses)}


def _planned_recordings(workspace: Workspace, span: float) -> dict[str, PlannedRecording]:
    """The recordings, of so many seconds after the rest at neutral."""
    neutral, slot = np.zeros(6), span / len(DOFS)

    def once(*signals: dict[str, Any]) -> list[dict[str, Any]]:
        return [{"at": LEAD, "fade": 0.0, "signal": list(signals)}]

    def hold(size: float) -> list[dict[str, Any]]:
        poses = [neutral, *(workspace.pose(pose, size) for pose in POSES)]
        moves = [0.5 * (i + 1) * slot for i in range(2 * len(POSES))]
        return once(_waypoints([0.0, *moves, span], list(np.repeat(poses, 2, axis=0))))

    def ramp(size: float) -> list[dict[str, Any]]:
        ends = [workspace.pose({dof: 1.0}, size) for dof in ("heave", "roll", "surge")]
        poses = [neutral, *(sign * pose for pose in ends for sign in (1.0, -1.0)), neutral]
        return once(_waypoints(np.linspace(0.0, span, len(poses)).tolist(), poses))

    def axes(size: float) -> list[dict[str, Any]]:
        signals = [workspace.multisine(dof, size, slot, i) for i, dof in enumerate(DOFS)]
        begins = [LEAD + i * slot for i in range(len(DOFS))]
        pairs = zip(begins, signals, strict=True)
        return [{"at": begin, "fade": 0.0, "signal": [motion]} for begin, motion in pairs]

    def steps(size: float) -> list[dict[str, Any]]:
        pulse = {"kind": "pulse", "width": _row_time(0.4 * slot)}
        amplitudes = _rounded(size * workspace.reach)
        pulses = [
            pulse | {"dof": dof, "amplitude": amplitudes[i], "at": _row_time((i + 0.2) * slot)}
            for i, dof in enumerate(DOFS)
        ]
        return once(*pulses)

    def all_axes(seed: int, direction: Mapping[str, float] | None, size: float) -> Any:
        signals = []
        if direction is not None:
            pose = workspace.pose(direction, 0.5 * workspace.share)
            times = [0.0, 2.0, span - 2.0, span]
            signals = [_waypoints(times, [neutral, pose, pose, neutral])]
        signals += [workspace.multisine(dof, size, span, seed + i) for i, dof in enumerate(DOFS)]
        return once(*signals)

    multisine = partial(PlannedRecording, "multisine")
    held_back = partial(multisine, held_back=True)
    return {
        "hold": PlannedRecording("hold", "five poses", hold),
        "ramp": PlannedRecording("ramp", "about neutral", ramp, 0.25),
        "axes_small": multisine("neutral", axes, 0.25),
        "axes_large": multisine("neutral", axes),
        "all_legs": multisine("up, rolled and ahead", partial(all_axes, 10, OFF_NEUTRAL)),
        "steps": PlannedRecording("step", "neutral", steps),
        "other_pose": held_back("pitched and yawed", partial(all_axes, 20, OTHER_POSE)),
        "other_law": held_back("neutral", partial(all_axes, 30, None), other_law=True),
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
    file = Path(folder) / FILE
    names = list(read_toml(file).get("recordings", ()))
    if not names:
        raise InputError(f"{file}: recordings: are missing; allowed: at least one")
    table = tomlkit.parse(file.read_text(encoding="utf-8"))
    recordings = table["recordings"]
    runs = {name: load_scenario(file.parent / recordings[name]["source"]) for name in names}
    first_run, channels = runs[names[0]], ("demand_pose", *load_columns().channels)
    sheet_metadata = load_machine(first_run.machine).metadata()
    if machine is None:
        machine, cab = first_run.machine, cab or first_run.cab
        hydraulics = hydraulics or first_run.hydraulics
    plant: Plant = Hexapod(cab, hydraulics, machine=machine)
    if not plant.parameters.actuators:
        gains = load_unknowns("valve_gains")
        plant = gains.apply(gains.draw("random", 1, seed)[0], plant)

    def record_one(name: str) -> str:
        spawn_key = (names.index(name),)
        (noise_seed,) = np.random.SeedSequence(seed, spawn_key=spawn_key).generate_state(1)
        with within(name):
            record = runs[name].changed(plant=copy.deepcopy(plant), seed=int(noise_seed)).record()
        metadata = {key: record.metadata[key] for key in ("sample_rate", "law")}
        metadata |= sheet_metadata | {"command": {"kind": "scenario"}}
        histories = {channel: record[channel] for channel in channels if channel in record.channels}
        units = {channel: record.units[channel] for channel in histories}
        recording = Record(record.time, histories, units, metadata)
        if plant.machine.name == CMF:
            return write_facility_csv(recording, file.parent / f"{name}.csv").name
        return recording.save(file.parent / f"{name}.parquet").name

    for name, written in zip(names, on_threads(record_one, names, jobs, progress), strict=True):
        recordings[name]["file"] = written
    return write_text(file, tomlkit.dumps(table))
