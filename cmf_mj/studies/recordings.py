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
"""

from collections.abc import Iterator, Mapping
from typing import Annotated, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.errors import InputError
from cmf_mj.core.result import Field
from cmf_mj.machine.cab import load_cab
from cmf_mj.machine.geometry import dof_index
from cmf_mj.machine.kinematics import leg_jacobian, legs_to_pose, pose_to_legs, rotation
from cmf_mj.machine.machine import Machine
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.record.columns import POSES
from cmf_mj.record.record import Record
from cmf_mj.record.sources import bridge_gaps, true_runs
from cmf_mj.studies import recording_pairs as pairs
from cmf_mj.studies import recording_slips as slips

Array = NDArray[np.float64]
Status = Literal["fault", "loss", "fine", "unseen"]

PRESSURES = ("cap_pressure", "rod_pressure")
MEASURED = ("leg_position", "leg_velocity", "leg_acceleration", *PRESSURES)

_FILTERED = ("leg_position", "leg_velocity", *PRESSURES, "valve_command")
_DEMANDS = ("leg_reference", *POSES)
_LEG_CHECKS = ("legs", "range", "velocity")  #: Checks of what the legs say of themselves.
_LONGEST_LEAD = 0.012  #: By which a law that feeds speed forward may answer early [s].
_FASTEST_SHARE = 2.5  #: Speed, in that of the valves as open as they are, that no load explains.
_LONGEST_DELAY = 0.4  #: Delay of a loop [s] beyond which clocks are apart.
_FORCE_CORNER = 4.0  #: Frequency up to which forces are compared [Hz].
_CREEP_SPEED = 1e-3  #: Speed from which on a leg moves [m/s].
_MOST_UNEXPLAINED = 0.7  #: Share not explained from which on nothing is said of a gain or delay.


class Finding(NamedTuple):
    """What one check found."""

    name: str
    status: Status  #: fault: wrong; loss: usable, less known; unseen: these data cannot show it.
    channel: str
    value: Annotated[float, Field(form=".3g")]  #: Its figure, NaN where it has none.
    unit: str
    text: Annotated[str, Field(title="")]


class _Recording:
    """A recording on its machine."""

    def __init__(self, record: Record, machine: Machine, plant: Hexapod) -> None:
        """Take the motion below 10 Hz, gaps bridged, NaN for channels that were not recorded."""
        self.record, self.machine, self.plant = record, machine, plant
        self.supply = float(plant.hydraulics.supply.pressure)
        stride = max(1, int(record.rate / 50.0))
        self.low_rate = record.rate / stride
        self.filtered = {
            name: pairs.smooth(self.bridged_channel(name), record.rate, 10.0)[::stride]
            for name in (*_FILTERED, *_DEMANDS)
        }
        self.has_pose = any(True for _ in self.channels_with_numbers(POSES))
        position = self.filtered["leg_position"]
        self.leg_speed = np.full_like(position, np.nan)
        if record.time.size >= 30 and len(position) > 1:
            self.leg_speed = np.gradient(position, 1.0 / self.low_rate, axis=0)

    def bridged_channel(self, name: str) -> Array:
        """A channel with its gaps bridged, (N, 6)."""
        if name not in self.record.channels:
            return np.full((self.record.time.size, 6), np.nan)
        return np.column_stack([bridge_gaps(column)[0] for column in self.record[name].T])

    def channels_with_numbers(self, names: tuple[str, ...]) -> Iterator[tuple[str, Array, str]]:
        """Names, values and units of those of these channels that have numbers."""
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
    recording = _Recording(record, machine, Hexapod(load_cab(cab, machine)))
    checks = (_check_missing, _check_gaps, _check_range, _check_clipping, _check_legs, _check_rates)
    findings = [finding for check in checks for finding in check(recording)]
    for finding in findings:
        is_of_legs = finding.name in _LEG_CHECKS and finding.channel.startswith("leg")
        if is_of_legs and finding.status == "fault":
            return findings  # forces by legs that are not what they say would only repeat it
    return [*findings, *_check_force(recording)]


def verdict(findings: list[Finding]) -> str:
    """The faults in words, or that there are none and what is lost."""

    def texts(status: Status) -> str:
        return "; ".join(f"{row.channel}: {row.text}" for row in findings if row.status == status)

    faults, losses = texts("fault"), texts("loss")
    fits = "the recording fits the machine"
    return faults or (f"{fits}; lost: {losses}" if losses else fits)


def _legs_text(legs: NDArray[np.bool_]) -> str:
    numbers = [str(leg + 1) for leg in np.flatnonzero(legs)]
    return f"{'legs' if len(numbers) > 1 else 'leg'} {' '.join(numbers)}"


def _check_missing(recording: _Recording) -> Iterator[Finding]:
    record = recording.record
    for channel in (name for name in MEASURED if name in record.channels):
        absent = ~slips.recorded_legs(record[channel])
        constant = (np.ptp(np.nan_to_num(record[channel]), axis=0) == 0.0) & ~absent
        if absent.any():
            text = f"{_legs_text(absent)} not recorded"
            yield Finding("missing", "loss", channel, float(absent.sum()), "legs", text)
        if constant.any() and record.time.size > 100 and not (constant | absent).all():
            text = f"{_legs_text(constant)} constant: not connected?"
            yield Finding("missing", "fault", channel, float(constant.sum()), "legs", text)
    missing = [name for name in PRESSURES if name not in record.channels]
    if missing:
        text = "not recorded: mass, centre of mass and friction are known by the data sheet alone"
        channels = " and ".join(missing)
        yield Finding("missing", "loss", channels, 6.0 * len(missing), "columns", text)


def _check_gaps(recording: _Recording) -> Iterator[Finding]:
    record = recording.record
    for channel, values in record.channels.items():
        for leg, column in enumerate(np.atleast_2d(values.T)):
            empty = np.isnan(column)
            if not empty.any() or empty.all():
                continue
            spans = true_runs(empty)
            first, end = max(spans, key=lambda span: span[1] - span[0])
            column_text = f"leg {leg + 1}, " if values.ndim > 1 else ""
            longest = f"from {record.time[first]:.4g} to {record.time[end - 1]:.4g} s"
            text = (
                f"{column_text}{int(empty.sum())} samples without a number in {len(spans)} gaps, "
                f"the longest {longest}; `bridge` in the map fills short ones"
            )
            yield Finding("gaps", "fault", channel, (end - first) / record.rate, "s", text)
    filled = record.metadata.get("recording", {}).get("bridged", {})
    if filled:
        column_name = max(filled, key=filled.__getitem__)
        channel, samples = column_name.split("/")[0], filled[column_name]
        text = f"straight lines fill up to {samples} samples a column"
        yield Finding("gaps", "loss", channel, samples / record.rate, "s", text)


def _check_range(recording: _Recording) -> Iterator[Finding]:
    machine, supply = recording.machine, recording.supply
    proof = max(2.0 * supply, recording.plant.hydraulics.proof_pressure)
    channels = recording.channels_with_numbers(("leg_position", "leg_reference", *PRESSURES))
    for channel, values, unit in channels:
        is_pressure = channel in PRESSURES
        bound = proof if is_pressure else machine.half_stroke
        lowest, largest, text = np.nanmin(values), np.nanmax(np.abs(values)), ""
        if largest > 1.02 * bound:
            stated = recording.record.metadata.get("recording", {}).get("units", {})
            map_unit = stated.get(channel, "m")
            cause = "" if is_pressure else slips.length_slip_text(values, machine, map_unit)
            cause = cause or "are unit and offset right?"
            text = f"up to {largest:.4g} {unit}, beyond {bound:.4g}: {cause}"
        elif is_pressure and lowest < -2e5:
            largest, text = lowest, "below a vacuum"
        elif is_pressure and largest < 1e-3 * supply:
            text = f"at most {largest:.3g} Pa of a supply of {supply:.3g}: is its unit bar or psi?"
        if text:
            yield Finding("range", "fault", channel, float(largest), unit, text)


def _check_clipping(recording: _Recording) -> Iterator[Finding]:
    record = recording.record
    for channel, values, unit in recording.channels_with_numbers((*MEASURED, "valve_command")):
        for leg, column in enumerate(recording.bridged_channel(channel).T):
            span = slips.find_frozen_span(values, leg, record.rate)
            if span and channel.startswith("leg_"):  # valves and pressures have limits
                begin, end = record.time[span.start], record.time[span.stop - 1]
                stop = f"leg {leg + 1} stands still from {begin:.4g} to {end:.4g} s"
                text = f"{stop}, others move: frozen"
                yield Finding("clipping", "fault", channel, end - begin, "s", text)
            steps = np.abs(np.diff(column))
            steps = steps[steps > 1e-12 * np.abs(column).max()]
            clipping = slips.find_clipping(column, float(steps.min())) if steps.size else None
            if clipping is not None:
                limit, samples = clipping
                is_empty = channel in PRESSURES and limit < 1e-3 * recording.supply
                is_usable = is_empty or channel == "valve_command"  # which a law may bound
                status: Status = "loss" if is_usable else "fault"
                text = f"leg {leg + 1} stays at {limit:.4g} {unit} for {samples} samples: clipped"
                yield Finding("clipping", status, channel, limit, unit, text)


def _check_legs(recording: _Recording) -> Iterator[Finding]:
    """Positions and references against what is demanded: legs and clock."""
    position, half_stroke = recording.filtered["leg_position"], recording.machine.half_stroke
    if not slips.recorded_legs(position).any():
        yield Finding("legs", "fault", "leg_position", np.nan, "", "not recorded; it is needed")
        return
    demands = [name for name, *_ in recording.channels_with_numbers(_DEMANDS)]
    if not recording.has_pose:
        stretch = half_stroke / max(float(np.nanmax(np.abs(position))), 1e-12)
        missing = "pose" if demands else "demand and no pose"
        text = f"no {missing} was recorded: a unit that is wrong in all lengths alike does not show"
        if stretch > 1.0:
            text += f"; {stretch:.3g} times as long they fit the stroke too"
        yield Finding("legs", "unseen", "leg_position", np.nan, "", text)
    compared = [("leg_position", demand) for demand in demands]
    if "demand_pose" in demands:
        compared.append(("leg_reference", "demand_pose"))
    for channel, demand in compared:
        measured, expected = recording.filtered[channel], recording.filtered[demand]
        candidates: list[slips.Slip] = []
        if demand in POSES:
            candidates += slips.pose_slips(expected, measured, recording.machine)
            expected = pose_to_legs(expected, recording.machine)
        candidates += slips.leg_slips(expected, measured)
        floor = 2e-3 * half_stroke
        fit = pairs.compare(expected, measured, recording.low_rate, floor, candidates)
        if fit is not None:
            yield _agreement_finding("legs", channel, demand, fit, slips.LENGTH_UNITS)
            if not fit.slip and (clock := _clock_finding(channel, demand, fit)):
                yield clock


def _agreement_finding(
    check: str, channel: str, against: str, fit: pairs.Agreement, unit_factors: Mapping[str, float]
) -> Finding:
    follows = fit.unexplained < _MOST_UNEXPLAINED
    scale_text = slips.scale_slip_text(fit.gain, unit_factors) if follows or fit.slip else ""
    faults = "; ".join(text for text in (fit.slip, scale_text) if text)
    status: Status = "fine" if follows else "loss"
    text = f"differs from what {against} would give" if follows else f"does not follow {against}"
    if faults:
        status, text = "fault", f"against {against}: {faults}"
    return Finding(check, status, channel, 100.0 * fit.unexplained, "%", text)


def _clock_finding(channel: str, demand: str, fit: pairs.Agreement) -> Finding | None:
    """The delay of a motion behind its demand, where it has one."""
    if not np.isfinite(fit.delay) or fit.unexplained >= _MOST_UNEXPLAINED:
        return None
    is_early = fit.delay < -_LONGEST_LEAD - fit.delay_error
    is_late = fit.delay > _LONGEST_DELAY + fit.delay_error
    text = f"behind {demand}, to {1e3 * fit.delay_error:.2g} ms"
    status: Status = "fine"
    if demand != "platform_pose" and (is_early or is_late):
        status, text = "fault", f"{text}: the clocks of the two are apart"
        text += ", as nothing moves before it is asked to" if is_early else ""
    return Finding("clock", status, channel, 1e3 * fit.delay, "ms", text)


def _check_rates(recording: _Recording) -> Iterator[Finding]:
    """Velocities and valve commands against the slope of the positions."""
    slope, rate = recording.leg_speed, recording.low_rate
    velocity, valves = recording.filtered["leg_velocity"], recording.filtered["valve_command"]
    candidates = slips.leg_slips(slope, velocity)
    fit = pairs.compare(slope, velocity, rate, 1e-3, candidates, are_rates=True)
    if fit is not None:
        inverse = "" if recording.has_pose else ", or these the other way round"
        against = f"the slope of positions{inverse}"
        yield _agreement_finding("velocity", "leg_velocity", against, fit, slips.LENGTH_UNITS)
    candidates = slips.leg_slips(slope, valves)
    fit = pairs.compare(slope, valves, rate, 2e-3, candidates, are_rates=True)
    if fit is None or not (fit.unexplained < 0.8 or fit.slip):
        return
    fit_of_sign = fit._replace(gain=min(fit.gain, 0.0) or np.nan)  # else gains have any size
    yield _agreement_finding("valves", "valve_command", "velocities", fit_of_sign, {})
    speed = 1.0 / (fit.gain * recording.plant.parameters.leg_speed.si)
    if speed > _FASTEST_SHARE and fit.unexplained < _MOST_UNEXPLAINED and not recording.has_pose:
        scale_text = slips.scale_slip_text(speed, slips.LENGTH_UNITS)
        text = f"velocity by the valves {scale_text}, or the scale of valve_command"
        yield Finding("valves", "fault", "leg_position", speed, "1", text)


def _check_force(recording: _Recording) -> Iterator[Finding]:
    """Forces by the pressures against weight, friction and inertia."""
    plant, machine, rate = recording.plant, recording.machine, recording.low_rate
    stride = max(1, int(rate / (2.5 * _FORCE_CORNER)))

    def smooth(values: Array) -> Array:
        return pairs.smooth(values, rate, _FORCE_CORNER)[::stride]

    cap, rod, position = (smooth(recording.filtered[name]) for name in (*PRESSURES, "leg_position"))
    cylinder = plant.hydraulics.cylinder
    force = cylinder.cap_area * cap - cylinder.rod_area * rod
    if not slips.recorded_legs(force).any() or not slips.recorded_legs(position).all():
        return
    speed = np.nan_to_num(recording.leg_speed)
    acceleration = smooth(np.gradient(speed, 1.0 / rate, axis=0) if len(speed) > 1 else speed)
    try:
        poses = legs_to_pose(position, machine)
        mean_pose = legs_to_pose(position.mean(axis=0), machine)
        inertia = acceleration @ plant.reflected_mass(mean_pose)  # which places the plant
    except InputError:
        text = "leg_position has no pose of this machine: the weight on the pressures is not known"
        yield Finding("force", "loss", "pressures", np.nan, "", text)
        return
    if slips.recorded_legs(force).all():
        forces = np.stack([force.mean(axis=0), plant.static_load()])
        carried, weight = (forces @ leg_jacobian(mean_pose, machine))[:, dof_index("heave")]
        share = float(carried / weight)
        slip = slips.scale_slip_text(share, slips.PRESSURE_UNITS)
        text = "of the data sheet's weight is carried by the pressures"
        status: Status = "fault" if slip else "fine"
        text += f": {slip}" if slip else ""
        yield Finding("force", status, "pressures", 100.0 * share, "%", text)
    friction = smooth(_last_directions(speed))
    parts = np.dstack([_weights(poses, machine), friction, inertia])
    candidates = slips.pressure_slips(cap, rod, cylinder.cap_area, cylinder.rod_area)
    fit, unnamed = pairs.explain_forces(parts, force, candidates)
    yield _agreement_finding("force", "pressures", "weight, friction and inertia", fit, {})
    if unnamed and not fit.slip:
        rest = f" and {len(unnamed) - 3} more" if len(unnamed) > 3 else ""
        text = f"whether {' or '.join(unnamed[:3])}{rest} does not show: these carry alike"
        yield Finding("force", "unseen", "pressures", float(len(unnamed)), "slips", text)


def _last_directions(speeds: Array) -> Array:
    """Which way each leg moves or moved last, (N, 6): 1, -1, and 0 before it does."""
    moves = np.abs(speeds) > _CREEP_SPEED
    last_rows = np.maximum.accumulate(np.where(moves, np.arange(len(speeds))[:, None], 0))
    return np.take_along_axis(np.sign(speeds) * moves, last_rows, axis=0)


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
