"""Whether a recording is what its map says of a machine: what `cmf recording check` reports.

missing     channels and legs that were not recorded, and what cannot be known without them
gaps        samples without a number
range       leg positions beyond the stroke, pressures beyond the supply
clipping    a sensor that stays at its largest or smallest value, or anywhere, while others go on
legs        positions against the demand's, which are those of its pose by the kinematics (Eq C.6)
velocity    against the slope of the positions: signs, units, time base
valves      commands against velocities: positive extends
force       Ac p_cap - Ar p_rod against J^-T (weight, of any mass and centre), friction, inertia
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
from cmf_mj.machine.kinematics import leg_jacobian, legs_to_pose, pose_to_legs, rotation
from cmf_mj.machine.machine import Machine
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.record.columns import POSES
from cmf_mj.record.record import Record
from cmf_mj.record.sources import bridged, runs
from cmf_mj.studies import recording_pairs as pairs

Array = NDArray[np.float64]
_Sizes = Mapping[str, float]
Status = Literal["fault", "loss", "fine", "unseen"]

PRESSURES = ("cap_pressure", "rod_pressure")
MEASURED = ("leg_position", "leg_velocity", "leg_acceleration", *PRESSURES)

_COMPARED = ("leg_position", "leg_velocity", *PRESSURES, "valve_command")
_ASKED_FOR = ("leg_reference", *POSES)
_LEGS = ("legs", "range", "velocity")  #: Checks of what the legs say of themselves.
_LEAD = 0.012  #: By which a law that feeds speed forward may answer early [s].
_FAST = 2.5  #: Speed, in that of the valves as open as they are, that no load explains.
_SLOWEST = 0.4  #: Delay of a loop [s] beyond which clocks are apart.
_CHANGED = 0.1  #: Change of the response from half to half that is another law's.
_BORNE = 4.0  #: Frequency up to which what the pressures bear is looked at [Hz].
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
        self.posed = any(True for _ in self.known(POSES))
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
            why = "" if channel in PRESSURES else _misread(subject, channel, values)
            why = why or "are unit and offset right?"
            said = f"up to {largest:.4g} {unit}, beyond {most:.4g}: {why}"
        elif channel in PRESSURES and lowest < -2e5:
            largest, said = lowest, "below a vacuum"
        elif channel in PRESSURES and largest < 1e-3 * supply:
            said = f"at most {largest:.3g} Pa of a supply of {supply:.3g}: is its unit bar or psi?"
        if said:
            yield Finding("range", "fault", channel, float(largest), unit, said)


def _misread(subject: _Subject, channel: str, values: Array) -> str:
    """Why lengths [m] are beyond the stroke: from gimbal to gimbal, or in units that fit a leg."""
    machine, half = subject.machine, subject.machine.half_stroke
    least, most = float(np.nanmin(values)), float(np.nanmax(values))
    longest = float(machine.geometry.neutral.max()) + half
    stated = subject.record.metadata.get("recording", {}).get("units", {}).get(channel, "m")

    def between(factor: float, slack: float = 1.02) -> bool:
        return machine.retracted < slack * factor * least and factor * most < slack * longest

    def along(factor: float) -> bool:
        return 0.02 < factor * max(most, -least) / half < 1.02

    if between(1.0, 1.5):
        return (
            "from gimbal to gimbal? State `offset`, what the file shows at neutral: its first row "
            f"has {np.nanmean(values[0]):.5g} m, the data sheet {longest - half:.5g} m"
        )
    if units := pairs.mistaken(pairs.LENGTHS, between, stated):
        return f"{units}, from gimbal to gimbal: state `offset` too"
    return pairs.mistaken(pairs.LENGTHS, along, stated)


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
    if not subject.posed:
        room = subject.machine.half_stroke / max(float(np.nanmax(np.abs(position))), 1e-12)
        what = "pose" if demands else "demand and no pose"
        said = f"no {what} was recorded: a unit that is wrong in all lengths alike does not show"
        said += f"; {room:.3g} times as long they fit the stroke too" * (room > 1.0)
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
        if fits is not None and not fits.slip:
            yield from _timing(subject, channel, expected, demand, fits)


def _judged(
    name: str, channel: str, against: str, found: pairs.Agreement | None, sizes: _Sizes
) -> Iterator[Finding]:
    if found is None:
        return
    follows = found.left < _FOLLOWS
    scale = pairs.slipped(found.gain, sizes) if follows or found.slip else ""
    wrong = "; ".join(text for text in (found.slip, scale) if text)
    status: Status = "fine" if follows else "loss"
    said = f"differs from what {against} would give" if follows else f"does not follow {against}"
    if wrong:
        status, said = "fault", f"against {against}: {wrong}"
    yield Finding(name, status, channel, 100.0 * found.left, "%", said)


def _timing(
    subject: _Subject, channel: str, expected: Array, demand: str, found: pairs.Agreement
) -> Iterator[Finding]:
    if np.isfinite(found.delay) and found.left < _FOLLOWS:
        early = found.delay < -_LEAD - found.doubt and demand != "platform_pose"
        wrong = early or demand != "platform_pose" and found.delay > _SLOWEST + found.doubt
        said = f"behind {demand}, to {1e3 * found.doubt:.2g} ms"
        said += ": the clocks of the two are apart" * wrong
        said += ", as nothing moves before it is asked to" * early
        status: Status = "fault" if wrong else "fine"
        yield Finding("clock", status, channel, 1e3 * found.delay, "ms", said)
    if demand == "platform_pose" or channel != "leg_position":
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
    against = "the slope of positions" + ", or these the other way round" * (not subject.posed)
    yield from _judged("velocity", "leg_velocity", against, fits, pairs.LENGTHS)
    fits = pairs.agree(slope, valves, rate, 2e-3, pairs.swaps(slope, valves), rates=True)
    if fits is not None and (fits.left < 0.8 or fits.slip):
        sign = fits._replace(gain=min(fits.gain, 0.0) or np.nan)
        yield from _judged("valves", "valve_command", "velocities", sign, {})
        fast = 1.0 / (fits.gain * subject.plant.parameters.leg_speed.si)
        if fast > _FAST and fits.left < _FOLLOWS and not subject.posed:
            scale = pairs.slipped(fast, pairs.LENGTHS)
            said = f"velocity by the valves {scale}, or the scale of valve_command"
            yield Finding("valves", "fault", "leg_position", fast, "1", said)


def _force(subject: _Subject) -> Iterator[Finding]:
    every, plant = max(1, int(subject.rate / (2.5 * _BORNE))), subject.plant
    slope = np.nan_to_num(subject.slope)
    changes = np.gradient(slope, 1.0 / subject.rate, axis=0) if len(slope) > 1 else slope
    slow = (*(subject.slow[name] for name in (*PRESSURES, "leg_position")), changes)
    cap, rod, place, acceleration, way = (
        pairs.smooth(one, subject.rate, _BORNE)[::every] for one in (*slow, pairs.last_way(slope))
    )
    areas = np.array([plant.hydraulics.cylinder.cap_area, plant.hydraulics.cylinder.rod_area])
    force = areas[0] * cap - areas[1] * rod
    if not pairs.there(force).any() or not pairs.there(place).all():
        return
    try:
        poses, mean = (legs_to_pose(one, subject.machine) for one in (place, place.mean(axis=0)))
        inertia = acceleration @ plant.reflected_mass(mean)  # which places the plant
    except InputError:
        said = "leg_position has no pose of this machine: the weight on the pressures is not known"
        yield Finding("force", "loss", "pressures", np.nan, "", said)
        return
    if pairs.there(force).all():
        forces = np.stack([force.mean(axis=0), plant.static_load()])
        lifted = float(np.divide(*(forces @ leg_jacobian(mean, subject.machine))[:, 2]))
        slip = pairs.slipped(lifted, pairs.PRESSURES_IN)
        said = "of the data sheet's weight is carried by the pressures" + f": {slip}" * bool(slip)
        status: Status = "fault" if slip else "fine"
        yield Finding("force", status, "pressures", 100.0 * lifted, "%", said)
    borne = np.dstack([_weights(poses, subject.machine), way, inertia])
    fits, alike = pairs.borne(borne, force, pairs.pressure_slips(cap, rod, areas))
    yield from _judged("force", "pressures", "weight, friction and inertia", fits, {})
    if alike and not fits.slip:
        more = f" and {len(alike) - 3} more" * (len(alike) > 3)
        said = f"whether {' or '.join(alike[:3])}{more} does not show: these carry alike"
        yield Finding("force", "unseen", "pressures", float(len(alike)), "slips", said)


def _weights(poses: Array, machine: Machine) -> Array:
    """Forces of the legs in poses (N, 6) for 1 N of weight and 1 N m of each moment, (N, 6, 4).

    J^T f = (0, 0, m g, T s x (0, 0, g)), s the first moments of the mass in platform axes.
    """
    wrenches = np.zeros((len(poses), 6, 4))
    wrenches[:, 2, 0] = 1.0
    for wrench, pose in zip(wrenches, poses, strict=True):
        wrench[3:, 1:] = np.cross(rotation(*pose[3:]).T, [0.0, 0.0, 1.0]).T
    jacobians = np.array([leg_jacobian(pose, machine).T for pose in poses])
    return np.asarray(np.linalg.solve(jacobians, wrenches))
