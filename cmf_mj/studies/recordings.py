"""Whether a recording is what its map says of a machine: what `cmf recording check` reports.

missing     channels and legs that were not recorded, and what cannot be known without them
gaps        samples without a number
range       leg positions beyond the stroke, pressures beyond the supply
clipping    a sensor that stays at its largest or smallest value while the machine goes on
resolution  least step of a sensor over the stroke or the supply pressure
saturation  share of the time in which valves are fully open
legs        positions against the demand's, which are those of its pose by the kinematics (Eq C.6)
velocity    against the slope of the positions: signs, units, time base
valves      commands against velocities: positive extends
force       Ac p_cap - Ar p_rod against the leg's force, or against J^-T (weight) and inertia
clock       delay of the motion behind its demand; no machine moves before it is asked to
law         response of the first half against that of the second, where both drive the same
"""

import re
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Annotated, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.errors import InputError
from cmf_mj.core.result import Field, Result, fields_of
from cmf_mj.machine.cab import load_cab
from cmf_mj.machine.kinematics import leg_jacobian, pose_to_legs
from cmf_mj.machine.machine import Machine
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.record.columns import POSES
from cmf_mj.record.record import Record
from cmf_mj.studies.recording_pairs import (
    LENGTHS,
    PRESSURES_IN,
    Agreement,
    Dynamics,
    agree,
    clipped,
    exchanged,
    halves,
    legs_there,
    pose_slips,
    pressure_slips,
    runs,
    shared_legs,
    slipped,
    smooth,
    swaps,
    turned,
    whole_legs,
)

Array = NDArray[np.float64]
Status = Literal["fault", "loss", "fine", "unseen"]

PRESSURES = ("cap_pressure", "rod_pressure")
MEASURED = ("leg_position", "leg_velocity", "leg_acceleration", *PRESSURES, "leg_force")

_COMPARED = (*MEASURED, *POSES, "leg_reference", "valve_command")

_PAIRS = {
    *(("leg_position", demand) for demand in (*POSES, "leg_reference")),
    ("leg_reference", "demand_pose"),
}
"""What is compared with what asks for it."""

_LEGS = ("legs", "range", "velocity")  #: Checks of what the legs say of themselves.
_SLOWEST = 0.4  #: Delay of a loop [s] beyond which clocks are apart.
_COARSE = 0.01  #: Step of a sensor over its range that is too coarse.
_OPEN = 0.2  #: Share of the time with a valve fully open that costs much.
_CHANGED = 0.1  #: Change of the response from half to half that is another law's.


class Finding(NamedTuple):
    """What one check found."""

    name: str
    status: Status  #: fault: wrong; loss: usable, less known; unseen: these data cannot show it.
    channel: str
    value: Annotated[float, Field(form=".3g")]  #: Its figure, NaN where it has none.
    unit: str
    said: Annotated[str, Field(title="")]  #: In words.


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
    plant = Hexapod(load_cab(cab, machine))
    found = [
        one
        for check in (_missing, _gaps, _range, _sensors)
        for one in check(record, machine, plant)
    ]
    record = _slow(record)
    found += [
        one for check in (_motion, _velocity, _valves) for one in check(record, machine, plant)
    ]
    if any(
        one.status == "fault" and one.channel[:3] == "leg" and one.name in _LEGS for one in found
    ):
        return found  # forces by legs that are not what they say would only repeat it
    return [*found, *_force(record, machine, plant)]


def verdict(findings: list[Finding]) -> str:
    """The faults in words, or that there are none and what is lost."""
    faults, losses = ([f for f in findings if f.status == s] for s in ("fault", "loss"))
    if faults:
        return "; ".join(f"{one.channel}: {one.said}" for one in faults)
    said = (f"{one.channel}: {one.said}" for one in losses)
    lost = f"; lost: {'; '.join(said)}" if losses else ""
    return f"the recording fits the machine{lost}"


def table(findings: list[Finding], title: str) -> Result[Finding]:
    """The findings to print."""
    return Result(findings, fields_of(Finding), title)


def _named(legs: NDArray[np.bool_]) -> str:
    numbers = [str(k + 1) for k in np.flatnonzero(legs)]
    return f"leg{'s' * (len(numbers) > 1)} {' '.join(numbers)}"


def _slow(record: Record) -> Record:
    """What moves below 10 Hz, gaps bridged."""
    every, channels = max(1, int(record.rate / 50.0)), {}
    for name in record.channels:
        if name in _COMPARED and (found := whole_legs(record, name)):
            channels[name] = np.full((record.time.size, 6), np.nan)
            channels[name][:, np.array(found[1]) - 1] = smooth(found[0], record.rate, 10.0)
    made = {name: values[::every] for name, values in channels.items()}
    metadata = dict(record.metadata) | {"sample_rate": record.rate / every}
    return Record(record.time[::every], made, {n: record.units[n] for n in made}, metadata)


def _missing(record: Record, machine: Machine, plant: Hexapod) -> Iterator[Finding]:
    for channel in record.channels:
        values = record[channel]
        if channel in MEASURED and values.ndim == 2:
            dead = np.ptp(np.nan_to_num(values), axis=0) == 0.0
            absent = ~legs_there(values)
            if absent.any():
                yield _loss(
                    "missing", channel, absent.sum(), "legs", f"{_named(absent)} not recorded"
                )
            if (dead & ~absent).any() and record.time.size > 100 and (~dead).any():
                lost = f"{_named(dead & ~absent)} constant: not connected?"
                yield Finding("missing", "fault", channel, float(dead.sum()), "legs", lost)
    there = [name for name in PRESSURES if name in record.channels]
    if len(there) == 1:
        other = PRESSURES[1 - PRESSURES.index(there[0])]
        yield _loss("missing", other, 6, "legs", "not recorded: no force, so no mass and friction")
    elif not there:
        lost = "no pressures: mass, centre of mass and friction are known by the data sheet alone"
        yield _loss("missing", "pressures", 12, "columns", lost)


def _loss(name: str, channel: str, value: float, unit: str, said: str) -> Finding:
    return Finding(name, "loss", channel, float(value), unit, said)


def _gaps(record: Record, machine: Machine, plant: Hexapod) -> Iterator[Finding]:
    for channel, values in record.channels.items():
        columns = np.atleast_2d(values.T)
        for k, column in enumerate(columns):
            empty = np.isnan(column)
            if not empty.any() or empty.all():
                continue
            spans = list(runs(empty))
            first, end = max(spans, key=lambda span: span[1] - span[0])
            leg = f"leg {k + 1}, " * (len(columns) > 1)
            said = (
                f"{leg}{int(empty.sum())} samples without a number in {len(spans)} gaps, the "
                f"longest from {record.time[first]:.4g} to {record.time[end - 1]:.4g} s"
            )
            yield Finding("gaps", "fault", channel, (end - first) / record.rate, "s", said)
    bridged = record.metadata.get("recording", {}).get("bridged", {})
    if bridged:
        most = max(bridged, key=bridged.__getitem__)
        said = f"straight lines fill up to {bridged[most]} samples a column"
        yield _loss("gaps", most.split("/")[0], bridged[most] / record.rate, "s", said)


def _range(record: Record, machine: Machine, plant: Hexapod) -> Iterator[Finding]:
    supply = float(plant.hydraulics.supply.pressure)
    most = max(2.0 * supply, plant.hydraulics.proof_pressure)
    for channel, most in (
        *((name, machine.half_stroke) for name in ("leg_position", "leg_reference")),
        *((name, most) for name in PRESSURES),
    ):
        if channel not in record.channels or not np.isfinite(record[channel]).any():
            continue
        unit, largest = record.units[channel], float(np.nanmax(np.abs(record[channel])))
        lowest = float(np.nanmin(record[channel]))
        if largest > 1.02 * most:
            said = f"up to {largest:.4g} {unit}, beyond {most:.4g}: is its unit right?"
            if channel.startswith("leg") and lowest > 0.5 * machine.retracted:
                said = f"{lowest:.4g} to {largest:.4g} m: from gimbal to gimbal? State `offset`"
            yield Finding("range", "fault", channel, largest, unit, said)
        elif channel in PRESSURES and lowest < -2e5:
            yield Finding("range", "fault", channel, lowest, unit, "below a vacuum")
        elif channel in PRESSURES and largest < 1e-3 * supply:
            said = f"at most {largest:.3g} Pa of a supply of {supply:.3g}: is its unit bar or psi?"
            yield Finding("range", "fault", channel, largest, unit, said)


def _sensors(record: Record, machine: Machine, plant: Hexapod) -> Iterator[Finding]:
    supply = float(plant.hydraulics.supply.pressure)
    for channel in MEASURED:
        found = whole_legs(record, channel)
        if found is None or record.time.size < 100:
            continue
        steps = []
        for column, leg in zip(found[0].T, found[1], strict=True):
            moved = np.abs(np.diff(column))
            steps.append(float(moved[moved > 1e-12 * np.abs(column).max()].min(initial=np.inf)))
            if clip := clipped(column, steps[-1]):
                unit = record.units[channel]
                said = f"leg {leg} stays at {clip[0]:.4g} {unit} for {clip[1]} samples: clipped"
                empty = channel in PRESSURES and clip[0] < 1e-3 * supply
                yield Finding(
                    "clipping", "loss" if empty else "fault", channel, clip[0], unit, said
                )
        size = {"leg_position": machine.half_stroke, **dict.fromkeys(PRESSURES, supply)}.get(
            channel
        )
        if size is not None and np.isfinite(max(steps)):
            coarse = max(s for s in steps if np.isfinite(s)) / size
            said = "least step over the " + ("stroke" if channel == "leg_position" else "supply")
            status: Status = "loss" if coarse > _COARSE else "fine"
            yield Finding("resolution", status, channel, 100.0 * coarse, "%", said)
    if (found := whole_legs(record, "valve_command")) is not None:
        share = float((np.abs(found[0]) > 0.999).any(axis=1).mean())
        status = "loss" if share > _OPEN else "fine"
        yield Finding(
            "saturation",
            status,
            "valve_command",
            100.0 * share,
            "%",
            "of the time a valve is fully open",
        )


def _motion(record: Record, machine: Machine, plant: Hexapod) -> Iterator[Finding]:
    """Positions and references against what is demanded: legs, clock, law."""
    if (position := whole_legs(record, "leg_position")) is None:
        yield Finding("legs", "fault", "leg_position", np.nan, "", "not recorded; it is needed")
        return
    demands = [
        name
        for name in ("platform_pose", "demand_pose", "leg_reference")
        if name in record.channels
    ]
    if not demands:
        yield Finding(
            "legs", "unseen", "leg_position", np.nan, "", "no demand and no pose to compare with"
        )
    floor = 2e-3 * machine.half_stroke
    for demand in demands:
        values, six = whole_legs(record, demand) or (position[0], [])
        if len(six) < 6:
            continue
        slips = pose_slips(values, machine) if demand in POSES else {}
        expected = pose_to_legs(values, machine) if demand in POSES else values
        for channel in ("leg_position", "leg_reference"):
            found = whole_legs(record, channel)
            if found is None or (channel, demand) not in _PAIRS:
                continue
            own, legs = found
            at = np.array(legs) - 1
            chosen = {said: partial(_columns, change, at) for said, change in slips.items()}
            fits = agree(expected[:, at], own, record.rate, floor, swaps(own, legs), chosen)
            yield from _judged("legs", channel, demand, fits, LENGTHS)
            if channel == "leg_position":
                yield from _timing(record, expected[:, at], own, demand, fits)


def _columns(change: Callable[[], Array], at: NDArray[np.int64]) -> Array:
    return change()[:, at]


def _judged(
    name: str,
    channel: str,
    against: str,
    found: Agreement,
    sizes: Mapping[str, float],
    *,
    loose: bool = False,
) -> Iterator[Finding]:
    scale = slipped(found.gain, sizes, loose=loose) if found.left < 0.7 or found.slip else ""
    wrong = [text for text in (found.slip, scale) if text]
    left = 100.0 * found.left
    if wrong:
        yield Finding(name, "fault", channel, left, "%", f"against {against}: {'; '.join(wrong)}")
    elif found.left > 0.7:
        yield _loss(name, channel, left, "%", f"does not follow {against}")
    else:
        yield Finding(name, "fine", channel, left, "%", f"differs from what {against} asks for")
    if found.unseen:
        said = f"slips that would not show against {against}, such as: {found.unseen[0]}"
        yield Finding(name, "unseen", channel, float(len(found.unseen)), "", said)


def _timing(
    record: Record, expected: Array, measured: Array, demand: str, found: Agreement
) -> Iterator[Finding]:
    if found.slip:
        return
    if np.isfinite(found.delay) and found.left < 0.7:
        late = 1e3 * found.delay
        early = -1.5 / record.rate - 2e-3
        wrong = demand not in ("platform_pose",) and not early <= found.delay <= _SLOWEST
        said = f"behind {demand}" + ": the clocks of the two are apart" * wrong
        yield Finding("clock", "fault" if wrong else "fine", "leg_position", late, "ms", said)
    if demand == "platform_pose":
        return
    two = halves(expected, measured, record.rate)
    if two is None:
        said = f"the halves do not drive the same lines of {demand}"
        yield Finding("law", "unseen", "leg_position", np.nan, "", said)
        return
    other = two[0] > max(_CHANGED, 3.0 * two[1])
    said = "change of the response from the first half to the second"
    said += ": another law, pose or supply" * other
    yield Finding("law", "fault" if other else "fine", "leg_position", 100.0 * two[0], "%", said)


def _slope(record: Record) -> tuple[Array, list[int]] | None:
    """Slope of the positions [m/s]."""
    found = whole_legs(record, "leg_position")
    if found is None or record.time.size < 30:
        return None
    return np.gradient(found[0], 1.0 / record.rate, axis=0), found[1]


def _velocity(record: Record, machine: Machine, plant: Hexapod) -> Iterator[Finding]:
    slope, found = _slope(record), whole_legs(record, "leg_velocity")
    if slope is None or found is None:
        return
    e, m, legs = shared_legs(slope, found)
    fits = agree(e, m, record.rate, 1e-3, swaps(m, legs), shift=False)
    yield from _judged("velocity", "leg_velocity", "the slope of positions", fits, LENGTHS)


def _valves(record: Record, machine: Machine, plant: Hexapod) -> Iterator[Finding]:
    slope, found = _slope(record), whole_legs(record, "valve_command")
    if slope is None or found is None:
        return
    e, m, legs = shared_legs(slope, found)
    fits = agree(e, m, record.rate, 2e-3, swaps(m, legs), shift=False, centred=True)
    if fits.left < 0.8 or fits.slip:
        yield from _judged("valves", "valve_command", "velocities", fits, {}, loose=True)


def _force(record: Record, machine: Machine, plant: Hexapod) -> Iterator[Finding]:
    cap, rod, place = (whole_legs(record, name) for name in (*PRESSURES, "leg_position"))
    if cap is None or rod is None or place is None:
        return
    p, q, legs = shared_legs(cap, rod)
    which = np.array(legs) - 1
    cylinders = plant.hydraulics.cylinder
    areas = cylinders.cap_area[which], cylinders.rod_area[which]
    force, slips = areas[0] * p - areas[1] * q, pressure_slips(p, q, areas, legs)
    friction = float(plant.hydraulics.friction.coulomb_friction.max())
    measured = whole_legs(record, "leg_force")
    if measured is not None and set(legs) <= set(measured[1]):
        own = shared_legs(measured, (p, legs))[0]
        floor = friction + 0.02 * float(np.abs(own).mean())
        fits = agree(own, force, record.rate, floor, slips, shift=False)
        yield from _judged("force", "pressures", "leg_force", fits, PRESSURES_IN)
    if len(place[1]) < 6:
        return
    try:
        dynamics = Dynamics(plant, place[0], record.rate)
        expected = dynamics.of(place[0])
    except InputError:
        said = "leg_position has no pose of this machine: the weight on the pressures is not known"
        yield _loss("force", "pressures", np.nan, "", said)
        return
    other_order = {}
    if len(legs) == 6:
        jacobian = leg_jacobian(dynamics.pose, machine)
        lifted = float((jacobian.T @ force.mean(axis=0))[2] / dynamics.wrench[2])
        slip = slipped(lifted, PRESSURES_IN)
        said = "of the data sheet's weight is carried by the pressures" + f": {slip}" * bool(slip)
        yield Finding("force", "fault" if slip else "fine", "pressures", 100.0 * lifted, "%", said)
        for what, change in exchanged(place[0], legs, "in all channels ").items():
            i, j = (int(part) - 1 for part in re.findall(r"\d", what))
            other_order[what] = partial(turned, dynamics, change, i, j)
    floor = friction + 0.01 * float(np.abs(dynamics.load).mean())
    fits = agree(
        expected[:, which], force, record.rate, floor, slips, other_order, shift=False, centred=True
    )
    if np.isfinite(fits.gain):
        yield from _judged("force", "pressures", "weight and inertia", fits, {})
    else:
        said = "inertia does not show, so that a slip of all channels alike would not either"
        yield Finding("force", "unseen", "pressures", np.nan, "", said)
