"""Whether a recording is what its map says of a machine: what `cmf recording check` reports.

missing     channels and legs that were not recorded, and what cannot be known without them
gaps        samples without a number
range       leg positions beyond the stroke, pressures beyond the supply
clipping    a sensor that stays at its largest or smallest value, or anywhere, while others go on
legs        positions against the demand's, which are those of its pose by the kinematics (Eq C.6)
velocity    against the slope of the positions: signs, units, time base
valves      commands against velocities: positive extends
force       Ac p_cap - Ar p_rod against J^-T (weight) and inertia
clock       delay of the motion behind its demand; no machine moves before it is asked to
law         response of the first half against that of the second, where both drive the same
"""

from collections.abc import Iterator, Mapping
from typing import Annotated, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.errors import InputError
from cmf_mj.core.result import Field
from cmf_mj.machine.cab import load_cab
from cmf_mj.machine.kinematics import leg_jacobian, legs_to_pose, pose_to_legs
from cmf_mj.machine.machine import Machine
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.record.columns import POSES
from cmf_mj.record.record import Record
from cmf_mj.record.sources import bridged, runs
from cmf_mj.studies import recording_pairs as pairs

Array = NDArray[np.float64]
Status = Literal["fault", "loss", "fine", "unseen"]

PRESSURES = ("cap_pressure", "rod_pressure")
MEASURED = ("leg_position", "leg_velocity", "leg_acceleration", *PRESSURES)

_COMPARED = ("leg_position", "leg_velocity", *PRESSURES, "valve_command")
_ASKED_FOR = ("leg_reference", *POSES)
_LEGS = ("legs", "range", "velocity")  #: Checks of what the legs say of themselves.
_SLOWEST = 0.4  #: Delay of a loop [s] beyond which clocks are apart.
_CHANGED = 0.1  #: Change of the response from half to half that is another law's.
_FOLLOWS = 0.7  #: Share not explained from which on nothing is said of a gain or delay.


class Finding(NamedTuple):
    """What one check found."""

    name: str
    status: Status  #: fault: wrong; loss: usable, less known; unseen: these data cannot show it.
    channel: str
    value: Annotated[float, Field(form=".3g")]  #: Its figure, NaN where it has none.
    unit: str
    said: Annotated[str, Field(title="")]  #: In words.


class _Subject:
    """A recording on its machine."""

    def __init__(self, record: Record, machine: Machine, plant: Hexapod) -> None:
        """Take what moves below 10 Hz, gaps bridged, NaN for what was not recorded."""
        self.record, self.machine, self.plant = record, machine, plant
        self.supply = float(plant.hydraulics.supply.pressure)
        every = max(1, int(record.rate / 50.0))
        self.rate = record.rate / every
        low = {n: pairs.smooth(self.whole(n), record.rate, 10.0) for n in (*_COMPARED, *_ASKED_FOR)}
        self.slow = {name: values[::every] for name, values in low.items()}
        self.slope = np.full_like(self.slow["leg_position"], np.nan)
        if record.time.size >= 30 and len(self.slope) > 1:
            self.slope = np.gradient(self.slow["leg_position"], 1.0 / self.rate, axis=0)

    def whole(self, channel: str) -> Array:
        """A channel with its gaps bridged, (N, 6)."""
        if channel not in self.record.channels:
            return np.full((self.record.time.size, 6), np.nan)
        return np.column_stack([bridged(one)[0] for one in self.record[channel].T])

    def known(self, names: tuple[str, ...]) -> Iterator[tuple[str, Array, str]]:
        """Of these, channels that have numbers, and their units."""
        for name in names:
            if name in self.record.channels and np.isfinite(self.record[name]).any():
                yield name, self.record[name], self.record.units[name]


def check_recording(record: Record, machine: Machine, cab: str | None = None) -> list[Finding]:
    """Everything that can be said of a recording with a machine's data sheet.

    Args:
        record: as `read_mapped` or `Record.from_arrays` gives it; channels are optional but for
            `leg_position`.
        machine: whose it is; its kinematics, areas, supply and masses are taken as stated.
        cab: that it carried, by name or file; default the machine's first.

    >>> from cmf_mj.studies.recordings import check_recording, verdict
    >>> machine = cmf_mj.load_machine("lab")
    >>> plant = cmf_mj.Hexapod(machine=machine)
    >>> command = cmf_mj.signals.sine("heave", 0.01, frequency=1.0, cycles=4)
    >>> record = cmf_mj.simulate(plant, machine.law, command)
    >>> verdict(check_recording(record, machine))
    'the recording fits the machine'
    """
    subject = _Subject(record, machine, Hexapod(load_cab(cab, machine)))
    checks = (_missing, _gaps, _range, _clipping, _motion, _slopes)
    found = [one for check in checks for one in check(subject)]
    wrong = (one for one in found if one.status == "fault" and one.name in _LEGS)
    if any(one.channel.startswith("leg") for one in wrong):
        return found  # forces by legs that are not what they say would only repeat it
    return [*found, *_force(subject)]


def verdict(findings: list[Finding]) -> str:
    """The faults in words, or that there are none and what is lost."""
    faults, losses = (
        "; ".join(f"{f.channel}: {f.said}" for f in findings if f.status == status)
        for status in ("fault", "loss")
    )
    return faults or "the recording fits the machine" + f"; lost: {losses}" * bool(losses)


def _named(legs: NDArray[np.bool_]) -> str:
    numbers = [str(k + 1) for k in np.flatnonzero(legs)]
    return f"leg{'s' * (len(numbers) > 1)} {' '.join(numbers)}"


def _missing(subject: _Subject) -> Iterator[Finding]:
    record = subject.record
    for channel in (name for name in MEASURED if name in record.channels):
        absent = ~pairs.there(record[channel])
        dead = (np.ptp(np.nan_to_num(record[channel]), axis=0) == 0.0) & ~absent
        if absent.any():
            said = f"{_named(absent)} not recorded"
            yield Finding("missing", "loss", channel, float(absent.sum()), "legs", said)
        if dead.any() and record.time.size > 100 and not (dead | absent).all():
            said = f"{_named(dead)} constant: not connected?"
            yield Finding("missing", "fault", channel, float(dead.sum()), "legs", said)
    if gone := [name for name in PRESSURES if name not in record.channels]:
        said = "not recorded: mass, centre of mass and friction are known by the data sheet alone"
        yield Finding("missing", "loss", " and ".join(gone), 6.0 * len(gone), "columns", said)


def _gaps(subject: _Subject) -> Iterator[Finding]:
    record = subject.record
    for channel, values in record.channels.items():
        for k, column in enumerate(np.atleast_2d(values.T)):
            empty = np.isnan(column)
            if not empty.any() or empty.all():
                continue
            spans = runs(empty)
            first, end = max(spans, key=lambda span: span[1] - span[0])
            said = (
                f"{f'leg {k + 1}, ' * (values.ndim > 1)}{int(empty.sum())} samples without a "
                f"number in {len(spans)} gaps, the longest from {record.time[first]:.4g} to "
                f"{record.time[end - 1]:.4g} s; `bridge` in the map fills short ones"
            )
            yield Finding("gaps", "fault", channel, (end - first) / record.rate, "s", said)
    filled = record.metadata.get("recording", {}).get("bridged", {})
    if filled:
        most = max(filled, key=filled.__getitem__)
        said = f"straight lines fill up to {filled[most]} samples a column"
        yield Finding("gaps", "loss", most.split("/")[0], filled[most] / record.rate, "s", said)


def _range(subject: _Subject) -> Iterator[Finding]:
    machine, supply = subject.machine, subject.supply
    proof = max(2.0 * supply, subject.plant.hydraulics.proof_pressure)
    for channel, values, unit in subject.known(("leg_position", "leg_reference", *PRESSURES)):
        most = proof if channel in PRESSURES else machine.half_stroke
        lowest, largest, said = np.nanmin(values), np.nanmax(np.abs(values)), ""
        if largest > 1.02 * most:
            said = f"up to {largest:.4g} {unit}, beyond {most:.4g}: are unit and offset right?"
            if channel not in PRESSURES and lowest > 0.5 * machine.retracted:
                said = (
                    f"{lowest:.4g} to {largest:.4g} m: from gimbal to gimbal? State `offset`, what "
                    f"the file shows at neutral: its first row has {np.nanmean(values[0]):.5g} m, "
                    f"the data sheet {machine.geometry.neutral.mean():.5g} m"
                )
        elif channel in PRESSURES and lowest < -2e5:
            largest, said = lowest, "below a vacuum"
        elif channel in PRESSURES and largest < 1e-3 * supply:
            said = f"at most {largest:.3g} Pa of a supply of {supply:.3g}: is its unit bar or psi?"
        if said:
            yield Finding("range", "fault", channel, float(largest), unit, said)


def _clipping(subject: _Subject) -> Iterator[Finding]:
    for channel, values, unit in subject.known((*MEASURED, "valve_command")):
        for k, column in enumerate(subject.whole(channel).T):
            stuck = pairs.stuck(values, k, subject.record.rate)
            if stuck and channel.startswith("leg_"):  # valves and pressures have limits
                at, end = subject.record.time[[stuck[0], stuck[1] - 1]]
                said = f"leg {k + 1} stands still from {at:.4g} to {end:.4g} s, others move: frozen"
                yield Finding("clipping", "fault", channel, end - at, "s", said)
            moved = np.abs(np.diff(column))
            moved = moved[moved > 1e-12 * np.abs(column).max()]
            if moved.size and (clip := pairs.clipped(column, float(moved.min()))):
                said = f"leg {k + 1} stays at {clip[0]:.4g} {unit} for {clip[1]} samples: clipped"
                empty = channel in PRESSURES and clip[0] < 1e-3 * subject.supply
                usable = empty or channel == "valve_command"  # which a law may bound
                status: Status = "loss" if usable else "fault"
                yield Finding("clipping", status, channel, clip[0], unit, said)


def _motion(subject: _Subject) -> Iterator[Finding]:
    """Positions and references against what is demanded: legs, clock, law."""
    position, nan = subject.slow["leg_position"], float("nan")
    if not pairs.there(position).any():
        yield Finding("legs", "fault", "leg_position", nan, "", "not recorded; it is needed")
        return
    demands = [name for name, *_ in subject.known(_ASKED_FOR)]
    if not demands:
        said = "no demand and no pose to compare with"
        yield Finding("legs", "unseen", "leg_position", nan, "", said)
    elif not {*POSES} & {*demands}:
        said = "no pose was recorded: a unit that is wrong in all lengths alike would not show"
        yield Finding("legs", "unseen", "leg_position", nan, "", said)
    floor = 2e-3 * subject.machine.half_stroke
    compared = [("leg_position", name) for name in demands] + [("leg_reference", "demand_pose")]
    for channel, demand in (pair for pair in compared if pair[1] in demands):
        own, expected = subject.slow[channel], subject.slow[demand]
        slips = [*pairs.swaps(expected, own)]
        if demand in POSES:
            slips = [*pairs.pose_slips(expected, own, subject.machine)]
            expected = pose_to_legs(expected, subject.machine)
            slips += pairs.swaps(expected, own)
        fits = pairs.agree(expected, own, subject.rate, floor, slips)
        yield from _judged("legs", channel, demand, fits, pairs.LENGTHS)
        if channel == "leg_position" and fits is not None and not fits.slip:
            yield from _timing(subject, expected, demand, fits)


def _judged(
    name: str,
    channel: str,
    against: str,
    found: pairs.Agreement | None,
    sizes: Mapping[str, float],
    *,
    loose: bool = False,
) -> Iterator[Finding]:
    if found is None:
        return
    follows = found.left < _FOLLOWS
    scale = pairs.slipped(found.gain, sizes, loose=loose) if follows or found.slip else ""
    wrong = "; ".join(text for text in (found.slip, scale) if text)
    status: Status = "fine" if follows else "loss"
    said = f"differs from what {against} would give" if follows else f"does not follow {against}"
    if wrong:
        status, said = "fault", f"against {against}: {wrong}"
    yield Finding(name, status, channel, 100.0 * found.left, "%", said)


def _timing(
    subject: _Subject, expected: Array, demand: str, found: pairs.Agreement
) -> Iterator[Finding]:
    if np.isfinite(found.delay) and found.left < _FOLLOWS:
        early = -0.5 / subject.rate - 2e-3
        wrong = demand != "platform_pose" and not early <= found.delay <= _SLOWEST
        said = f"behind {demand}" + ": the clocks of the two are apart" * wrong
        status: Status = "fault" if wrong else "fine"
        yield Finding("clock", status, "leg_position", 1e3 * found.delay, "ms", said)
    if demand == "platform_pose":
        return
    found_in = pairs.halves(expected, subject.slow["leg_position"], subject.rate)
    if found_in is None:
        said = f"the halves do not drive the same lines of {demand}"
        yield Finding("law", "unseen", "leg_position", np.nan, "", said)
        return
    change, error = found_in
    other = change > max(_CHANGED, 3.0 * error)
    said = "change of the response from the first half to the second"
    said += ": another law, pose or supply" * other
    status = "fault" if other else "fine"
    yield Finding("law", status, "leg_position", 100.0 * change, "%", said)


def _slopes(subject: _Subject) -> Iterator[Finding]:
    """Velocities and valve commands against the slope of the positions."""
    speed, valves = subject.slow["leg_velocity"], subject.slow["valve_command"]
    slope, rate = subject.slope, subject.rate
    fits = pairs.agree(slope, speed, rate, 1e-3, pairs.swaps(slope, speed), rates=True)
    against = "the slope of positions"
    yield from _judged("velocity", "leg_velocity", against, fits, pairs.LENGTHS)
    fits = pairs.agree(slope, valves, rate, 2e-3, pairs.swaps(slope, valves), rates=True)
    if fits is not None and (fits.left < 0.8 or fits.slip):
        yield from _judged("valves", "valve_command", "velocities", fits, {}, loose=True)


def _force(subject: _Subject) -> Iterator[Finding]:
    cap, rod, place = (subject.slow[name] for name in (*PRESSURES, "leg_position"))
    hydraulics = subject.plant.hydraulics
    areas = np.array([hydraulics.cylinder.cap_area, hydraulics.cylinder.rod_area])
    force = areas[0] * cap - areas[1] * rod
    if not pairs.there(force).any() or not pairs.there(place).all():
        return
    try:
        needs = _needs(subject, place)
    except InputError:
        said = "leg_position has no pose of this machine: the weight on the pressures is not known"
        yield Finding("force", "loss", "pressures", np.nan, "", said)
        return
    if pairs.there(force).all():
        lifted = float((needs.jacobian.T @ force.mean(axis=0))[2] / needs.wrench[2])
        slip = pairs.slipped(lifted, pairs.PRESSURES_IN)
        said = "of the data sheet's weight is carried by the pressures" + f": {slip}" * bool(slip)
        status: Status = "fault" if slip else "fine"
        yield Finding("force", status, "pressures", 100.0 * lifted, "%", said)
    floor = float(hydraulics.friction.coulomb_friction.max() + 0.01 * np.abs(needs.load).mean())
    slips = pairs.pressure_slips(needs.forces, cap, rod, areas)
    fits = pairs.agree(needs.forces, force, subject.rate, floor, slips, rates=True)
    if fits is not None and np.isfinite(fits.gain):
        yield from _judged("force", "pressures", "weight and inertia", fits, {})
    else:
        said = "inertia does not show, so that legs exchanged in all pressures would not either"
        yield Finding("force", "unseen", "pressures", np.nan, "", said)


class _Needs(NamedTuple):
    """What legs need by the data sheet."""

    forces: Array  #: For weight in the pose, and inertia [N], (N, 6).
    load: Array  #: Of the weight in the mean pose [N], (6,).
    wrench: Array  #: Its wrench on the platform.
    jacobian: Array  #: Of the mean pose.


def _needs(subject: _Subject, positions: Array) -> _Needs:
    """Place the machine in the mean pose of its positions [m], (N, 6)."""
    machine, every = subject.machine, max(1, positions.shape[0] // 200)
    pose = legs_to_pose(positions.mean(axis=0), machine)
    inertia = subject.plant.reflected_mass(pose)
    load, jacobian = subject.plant.static_load(), leg_jacobian(pose, machine)
    wrench = jacobian.T @ load
    poses = legs_to_pose(pairs.smooth(positions, subject.rate, 1.0)[::every], machine)
    some = [np.linalg.solve(leg_jacobian(one, machine).T, wrench) for one in poses]
    at = np.arange(positions.shape[0]) / every
    static = [np.interp(at, np.arange(len(some)), one) for one in np.transpose(some)]
    acceleration = np.gradient(subject.slope, 1.0 / subject.rate, axis=0)
    return _Needs(np.transpose(static) + acceleration @ inertia, load, wrench, jacobian)
