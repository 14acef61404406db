"""What every run must keep, frame by frame; a check returns what is wrong, or nothing.

The decisive one is `near`: the demand of the DCU stays inside the range of the poses that came from
the host in the second before the newest of them, as far as the machine may go, widened by SHARE of
half that range and by the way a host's speed goes on in STOP. From the first frame of a fault on
the machine is being stopped, and the demand may be anywhere until the fault has been reset.
"""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.states import State
from cmf_mj.core.units import RATE
from cmf_mj.facility.operation import account
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.plant.oil import ATMOSPHERE
from cmf_mj.record.record import Record
from faults.hosts import WILD, Array, derivatives, says
from faults.plans import JUMPS, Plan
from faults.runs import Part, Run

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests"))
from power_balance import power_balance  # noqa: E402

SHARE = 0.2
"""By which the demand may leave the host's range, of half that range."""

STOP = 0.1
"""Time that a host's largest speed goes on, when it falls silent [s]: half the DCU's stop time of
0.08 s, and 0.05 s by which a gap of that speed grows before it closes."""

GAIN = 1.2
"""Largest gain from host to demand below 1 Hz."""

QUIET, JUMP = 2.0, 40.0
"""Largest acceleration of the demand: of a host of ordinary jitter over the host's own; of one that
jumps, in m/s^2, the DCU's limit of 4 g."""

ODD = 30.0
"""Acceleration that any other host may cause, over its largest speed [1/s]."""

BEND = 7.0
"""Acceleration that a wrong velocity may cause, over it times the rate of the host: 5.8 in the
quintic between two frames, and what closes the gap; the DCU soon leaves it aside."""

LEAST = 1e-4, 0.05
"""What is too small to matter: of a pose [m or rad] and of its second derivative."""

FAR = 0.2
"""Share of the working stroke that a leg may be away from its reference for `FAR_TIME`."""

FAR_TIME = 0.1
"""[s]."""

BALANCE, TORN, OIL, GAP = 2e-3, 2e-2, 2e-6, 1e-4
"""Share of the energy that may be missing, where no chamber is torn open and where one is, and of
the oil; opening of a gimbal [m]."""

END = 20.0
"""Travel before its stop, in gaps, over which a piston displaces less oil than its area: it works
on a volume that stays, which the balance of energy does not know."""


def _sound(part: Part) -> NDArray[np.bool_]:
    """Whether each frame is before any fault, or after one was reset, (N,)."""
    record, fault = part.operation.record, part.operation.record.metadata["fault"]
    sound = record["operating_state"] != State.FAULT
    if fault is not None:
        struck = record.time >= fault["time"]
        back = np.cumsum(record["operating_state"] == State.FAULT) > 0
        sound &= ~struck | back
    return np.asarray(sound)


def _speed(run: Run) -> tuple[float, float]:
    """Largest speed and acceleration of the host as the machine's clock sees them."""
    plan, column = run.plan, DOFS.index(run.plan.dof)
    if plan.door == "telemetry":
        values = [p.operation.arrivals.values for p in run.parts]
        rows = np.concatenate(values)[:, 1:]
        largest = np.abs(rows).max(axis=(0, 2)) if rows.size else np.zeros(2)
        return float(largest[0]), float(largest[1])
    own = np.arange(0.0, plan.seconds * plan.speed, 1e-3)
    velocity, acceleration = (np.abs(v[:, column]).max() for v in derivatives(plan, own))
    louder = max([1.0, *(o.size for o in plan.oddities if o.kind == "second")])
    return float(velocity * plan.speed * louder), float(acceleration * plan.speed**2 * louder)


def hulls(frames: NDArray[np.int64], poses: Array, count: int, second: int) -> tuple[Array, Array]:
    """Least and largest pose of the second before the newest arrival, by frame, (count, 6)."""
    begin = np.searchsorted(frames, frames - second) - 1
    low, high = np.zeros((frames.size + 1, 6)), np.zeros((frames.size + 1, 6))
    for last in range(frames.size):
        start = np.zeros((int(begin[last] < 0), 6))
        rows = np.concatenate([start, poses[max(begin[last], 0) : last + 1]])
        low[last + 1], high[last + 1] = rows.min(axis=0), rows.max(axis=0)
    newest = np.searchsorted(frames, np.arange(count), side="right")
    return low[newest], high[newest]


def _own(part: Part, door: str) -> tuple[NDArray[np.int64], Array]:
    """Arrival frames and poses of what the host means, without what it cannot mean."""
    arrivals = part.operation.arrivals
    pose = arrivals.values[:, 0]
    true = np.isfinite(arrivals.values).all(axis=(1, 2))
    if door != "telemetry":  # there what is wild is flown
        true &= (np.abs(pose) < WILD).all(axis=1)
    return arrivals.frame[true], pose[true]


def near(run: Run) -> str:
    """The demand stays in the range of its host."""
    speed = _speed(run)[0] + _wrong(run.plan)
    least, most = load_motion_limits(None, run.plant.machine).operational.T
    for part in run.parts:
        record = part.operation.record
        demand, rate = record["demand_pose"], round(record.rate)
        frames, poses = _own(part, run.plan.door)
        low, high = hulls(frames, np.clip(poses, least, most), record.time.size, rate)
        wide = SHARE * 0.5 * (high - low) + STOP * speed + LEAST[0]
        beyond = np.maximum(demand - high, low - demand) / wide
        beyond[~_sound(part)] = 0.0
        if beyond.max() > 1.0:
            frame, column = np.unravel_index(int(beyond.argmax()), beyond.shape)
            at = part.first + frame / rate
            return (
                f"{DOFS[column]} {demand[frame, column]:.4g} at {at:.3f} s; the host was between "
                f"{low[frame, column]:.4g} and {high[frame, column]:.4g}"
            )
    return ""


def gain(run: Run) -> str:
    """What comes of the host's motion below 1 Hz is not larger than that."""
    if any(o.kind in (*JUMPS, "freeze") for o in run.plan.oddities):
        return ""
    for part in run.parts:
        record = part.operation.record
        rate, (frames, poses) = round(record.rate), _own(part, run.plan.door)
        first = int(1.5 * rate)
        if not _sound(part).all() or record.time.size < first + 2 * rate or not frames.size:
            continue
        newest = np.searchsorted(frames, np.arange(record.time.size), side="right") - 1
        host = np.where(newest[:, None] >= 0, poses[newest], 0.0)[first:]
        below = int(np.floor((record.time.size - first) / rate)) + 1
        window = np.hanning(record.time.size - first)[:, None]
        sizes = []
        for each in (host, record["demand_pose"][first:]):
            spectrum = np.fft.rfft(window * (each - each.mean(axis=0)), axis=0)[1:below]
            sizes.append(np.sqrt((np.abs(spectrum) ** 2).sum(axis=0)) * 4.0 / window.size)
        worst = sizes[1] - GAIN * sizes[0] - LEAST[0]
        if worst.max() > 0.0:
            column = int(worst.argmax())
            return f"{DOFS[column]} {sizes[1][column]:.4g} for {sizes[0][column]:.4g} below 1 Hz"
    return ""


def ordinary(plan: Plan) -> bool:
    """Whether the host keeps its time but for a jitter of 2 ms, and is alone but for garbage."""
    kinds = {o.kind for o in plan.oddities}
    jitter = max([0.0, *(o.size for o in plan.oddities if o.kind == "jitter")])
    return kinds <= {"jitter", "garbage"} and jitter <= 2e-3


def _wrong(plan: Plan) -> float:
    """By how much the velocity that a host says is not that of its poses, in its own time.

    One that sends none is known by its first frame that moves.
    """
    if plan.door != "native" or plan.derivatives == "zero":
        return 0.0
    own = np.arange(0.0, plan.seconds * plan.speed, 1e-3)
    said = says(plan, own)[:, 1]
    return float(np.abs(said - derivatives(plan, own)[0]).max())


def acceleration(run: Run) -> str:
    """The demand is not shaken harder than its host gives reason for."""
    plan, (speed, most) = run.plan, _speed(run)
    kinds = {o.kind for o in plan.oddities}
    bound = QUIET * most + LEAST[1]
    words = plan.door == "moog" and (plan.begin != "engaged" or plan.actions)
    if kinds & set(JUMPS) or len(run.parts) > 1 or words:
        bound = JUMP  # a Moog client begins to say positions in the midst of its motion
    elif not ordinary(plan) or plan.speed != 1.0 or plan.derivatives != "exact":
        fast = max(plan.speed, 1.0)  # that its clock is slow is not known at once
        bound += ODD * speed + BEND * plan.rate * fast**2 * _wrong(plan)
    for part in run.parts:
        values = np.abs(part.operation.record["demand_acceleration"])
        values[~_sound(part)] = 0.0
        if values.max() > bound:
            frame, column = np.unravel_index(int(values.argmax()), values.shape)
            at = part.first + frame / part.operation.record.rate
            return (
                f"{DOFS[column]} {values[frame, column]:.4g} at {at:.3f} s; "
                f"allowed: {bound:.4g}, the host has {most:.4g}"
            )
    return ""


def legs(run: Run) -> str:
    """Fades between operating states stay between what they lead from and to."""
    machine = run.plant.machine
    travel, speed = machine.working_stroke, _speed(run)[0]
    for part in run.parts:
        record = part.operation.record
        state, reference = record["operating_state"], record["leg_reference"]
        target = pose_to_legs(record["demand_pose"], machine)
        low, high = target.copy(), target.copy()
        for states, place in (
            ((State.RAISE,), 0.0),
            ((State.OFF, State.SETTLED, State.RETURN, State.FAULT), -travel),
        ):
            visited = np.maximum.accumulate(np.isin(state, states))[:, None]
            low, high = (
                np.where(visited, np.minimum(low, place), low),
                np.where(visited, np.maximum(high, place), high),
            )
        low, high = np.minimum.accumulate(low), np.maximum.accumulate(high)
        low, high = np.minimum(low, reference[0]), np.maximum(high, reference[0])
        wide = SHARE * 0.5 * (high - low) + 2.0 * STOP * speed + 10.0 * LEAST[0]
        beyond = np.maximum(reference - high, low - reference) / wide
        beyond[~_sound(part)] = 0.0
        if beyond.max() > 1.0:
            frame, leg = np.unravel_index(int(beyond.argmax()), beyond.shape)
            at = part.first + record.time[frame]
            return (
                f"leg {leg + 1} {reference[frame, leg]:.4g} at {at:.3f} s; "
                f"start, states and host were between {low[frame, leg]:.4g} "
                f"and {high[frame, leg]:.4g}"
            )
    return ""


def follows(run: Run) -> str:
    """A leg that is far from its reference, or beyond its stroke, is a fault."""
    machine, plan = run.plant.machine, run.plan
    broken = any(a.kind == "event" for a in plan.actions)
    for part in run.parts:
        record = part.operation.record
        extension, state = record["leg_extension"], record["operating_state"]
        engaged = _sound(part) & np.isin(state, (State.ENGAGED, State.HOLD))
        away = np.abs(extension - record["leg_reference"]).max(axis=1)
        out = engaged & (away > FAR * machine.working_stroke)
        if not broken:
            out |= engaged & (np.abs(extension).max(axis=1) > 1.02 * machine.working_stroke)
        count, run_of = round(FAR_TIME * record.rate), np.zeros(out.size + 1)
        for frame in np.flatnonzero(out):
            run_of[frame] = run_of[frame - 1] + 1.0
        if run_of.max() > count:
            frame = run_of.argmax()
            at = part.first + record.time[frame]
            return (
                f"{away[frame]:.4g} m from the reference at {at:.3f} s,"
                f" extension {np.abs(extension[frame]).max():.4g} m, and no fault"
            )
    return ""


def finite(run: Run) -> str:
    """Every channel is a number."""
    for part in run.parts:
        for name, values in part.operation.record.channels.items():
            if not np.isfinite(values).all():
                return f"{name} is not finite"
    return ""


def gimbals(run: Run) -> str:
    """The gimbals stay closed."""
    worst = max((float(p.operation.record["gimbal_error"].max()) for p in run.parts), default=0.0)
    return f"a gimbal is {worst:.4g} m open" if worst > GAP else ""


def balance(run: Run) -> str:
    """Energy and oil are where they went."""
    plant, noisy = run.plant, run.plan.electronics == "noisy"
    for part in run.parts:
        record = part.operation.record
        if noisy and run.plan.control_rate != RATE:
            continue  # the pressures that were looked at are not those of a row
        if noisy:
            record = _true(part)
        cylinders = plant.hydraulics.cylinder
        room = cylinders.half_stroke - np.abs(record["leg_extension"])
        if record.time.size < 2:
            continue
        kept = power_balance(plant, record)
        torn = np.isnan(kept.residual).any()
        missing = np.nanmax(np.abs(kept.residual - kept.residual[0]), initial=0.0)
        moved = max(*(np.abs(e).max() for e in (kept.delivered, kept.lost, kept.work)), 1e3)
        oil = np.nanmax(np.abs(kept.oil / kept.oil[0] - 1.0), initial=0.0)
        at_end = (room < END * cylinders.minimum_gap).any()
        if missing > (TORN if torn else BALANCE) * moved and not at_end:
            return f"{missing:.4g} J of {moved:.4g} J are missing"
        shut = any(a.what == "accumulator_lost" for a in run.plan.actions)
        if oil > OIL and not shut:  # what is shut off keeps oil that no channel holds
            return f"a share of {oil:.4g} of the oil is missing"
    return ""


def _true(part: Part) -> Record:
    """The rows at which somebody looked at the true pressures, with these."""
    record, rows = part.operation.record, part.frames
    channels = {name: values[rows] for name, values in record.channels.items()}
    channels["cap_pressure"] = part.pressure[..., 0]
    channels["rod_pressure"] = part.pressure[..., 1]
    return Record(record.time[rows], channels, record.units, record.metadata)


def counts(run: Run) -> str:
    """Every frame is in one line of the account."""
    total = 0
    for part in run.parts:
        table = account(part.operation, part.received)
        total += part.received
        if min(table.values()) < 0:
            return f"{table}"
        names = ("early", "lost", "thinned", "after_end", "accepted", "waiting")
        known = sum(table[name] for name in (*names, *part.operation.rejections))
        if known != table["received"]:
            return f"{known} of {table['received']} frames: {table}"
    if run.plan.door == "native" and total > run.sent:
        return f"{total} frames of {run.sent} datagrams"
    return ""


def bounds(run: Run) -> str:
    """Pressures stay above vacuum and below proof; the run did not stop itself, as for a leg."""
    proof, noisy = run.plant.hydraulics.proof_pressure, run.plan.electronics == "noisy"
    for part in run.parts:
        record = part.operation.record
        sides = [part.pressure] if noisy else [record["cap_pressure"], record["rod_pressure"]]
        for pressure in sides:
            least, most = pressure.min(initial=0.0), pressure.max(initial=0.0)
            if least < -ATMOSPHERE or most > proof:
                return f"a chamber has between {least:.4g} and {most:.4g} Pa gauge"
    return run.stopped


def alarm(run: Run) -> str:
    """No fault without a reason: the DCU never leaves its host, nor a sound machine a state.

    The law of `lab` has one: it rings in the short chambers of the settled position, at 29 m/s^2
    with perfect sensors.
    """
    plan = run.plan
    rings = plan.machine == "lab" and plan.begin in ("settled", "off")
    sound = not (plan.law or plan.actions or rings) and ordinary(plan)
    for part in run.parts:
        fault = part.operation.record.metadata["fault"]
        if fault is not None and (sound or fault["name"] == "host_range"):
            return f"{fault}"
    return ""


def disk(run: Run) -> str:
    """A record is whole or not there."""
    return run.damage


def way_out(run: Run) -> str:
    """Whatever has happened, the operator can engage again, or a fault says why not."""
    broken = any(a.kind == "event" for a in run.plan.actions)
    if not run.plan.way_out or run.stopped or broken:
        return ""
    record, since = run.parts[-1].operation.record, run.plan.seconds - run.parts[-1].first
    fault = record.metadata["fault"]
    if run.end == State.ENGAGED or (fault is not None and fault["time"] >= since):
        return ""
    low = float(record["leg_extension"][-1].max() + run.plant.machine.working_stroke)
    return (
        f"{run.end.name.lower()} after {run.plan.way_out:g} s of the operator's requests, "
        f"legs {1e3 * low:.0f} mm above the settled position, fault {fault}"
    )


CHECKS: dict[str, Callable[[Run], str]] = {
    check.__name__: check
    for check in (
        *(bounds, finite, alarm, disk, counts, near, gain, acceleration, legs, follows),
        *(gimbals, balance, way_out),
    )
}


def broken(run: Run, left_out: tuple[str, ...] = ()) -> Iterator[tuple[str, str]]:
    """Name and words of every check that a run does not pass."""
    for name, check in CHECKS.items():
        if name not in left_out and (words := check(run)):
            yield name, words
