"""Composite commands: dwells at single frequencies, several degrees of freedom at once.

A dwell is a stretch of whole cycles at one frequency and full amplitude, cut out for analysis:

    settle | fade in, transient, dwell, fade out | settle | fade in, ... | settle

Each description lists its `dwells`: `start` (index of the first control frame), `frames`,
`frequency` [Hz], `amplitude` [m or rad] and `cycles`. The phase is zero at `start`; `frames` is
cycles / frequency to the nearest frame, so fit a sine and a cosine to it, not Fourier lines.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.core.errors import InputError
from cmf_mj.core.rates import RATE
from cmf_mj.machine.dof import dof_index
from cmf_mj.machine.kinematics import DOFS
from cmf_mj.signals.single import (
    Command,
    check_bounded,
    check_not_negative,
    check_positive,
    line_weights,
    odd_orders,
    raised_cosine,
    random_phase_sum,
    repeat,
)

ROUNDS = (
    (0.1, 0.2, 0.4, 0.6, 0.8, 1.0, 1.2),
    (1.4, 1.6, 1.8, 2.0, 2.4, 2.6, 3.0),
    (3.4, 3.6, 4.0, 4.4, 4.6, 5.0, 5.4),
    (5.6, 6.0, 6.4, 6.6, 7.0, 7.4, 7.6),
    (8.0, 8.4, 8.6, 9.0, 9.4, 9.6, 10.0),
)
"""Frequencies of the seven channels in the five rounds [Hz], Table 2-3."""


def seven_sines(
    dof: str,
    amplitude: float,
    number: int,
    *,
    cycles: int = 5,
    fade: float = 1.0,
    settle: float = 5.5,
) -> Command:
    """One round of the facility's seven-channel generator (Table 2-3): seven sines in sequence.

    The report does not say whether the channels run together. The record lengths in its Appendix A
    say they do not: 177.4, 75.5, 66.0, 62.7 and 62.6 s for the five heave rounds are 5.4 times the
    sum of the round's seven periods (22.25, 3.53, 1.65, 1.06, 0.78 s) and 57.3 s, within 1.1 s.
    Seven sines together, each as long as the slowest, miss by up to 4.4 s; seven of 0.33 in near
    10 Hz would also add up to some 19 g. The defaults, derived from these lengths, make rounds of
    169, 76, 66, 63 and 62 s.

    Args:
        dof: degree of freedom.
        amplitude: of each sine [m or rad]; the report takes 0.33 in and 0.2 deg.
        number: of the round, 1 to 5.
        cycles: whole cycles of a dwell.
        fade: before and after each dwell [s].
        settle: rest before, between and after the sines [s].
    """
    if number not in range(1, len(ROUNDS) + 1):
        raise InputError(f"number: {number} is not one of the rounds 1 to {len(ROUNDS)}")
    check_bounded(amplitude)
    tones = [(frequency, amplitude) for frequency in ROUNDS[number - 1]]
    history, dwells = _dwells(tones, cycles, 0.0, fade, settle)
    description: dict[str, object] = {
        "kind": "seven_sines",
        "dof": dof,
        "amplitude": amplitude,
        "number": number,
        "cycles": cycles,
        "fade": fade,
        "settle": settle,
        "dwells": dwells,
    }
    return Command(_poses({dof: history}), description)


def stepped_sines(
    dof: str,
    frequencies: Sequence[float],
    amplitudes: Sequence[float],
    *,
    cycles: int = 10,
    transient: float = 2.0,
    fade: float = 1.0,
    settle: float = 1.0,
) -> Command:
    """Each frequency at each amplitude, for describing functions.

    Args:
        dof: degree of freedom.
        frequencies: one after the other [Hz].
        amplitudes: at each frequency, one after the other [m or rad].
        cycles: whole cycles of a dwell.
        transient: at full amplitude before each dwell [s]; take it longer than the machine rings.
        fade: before the transient and after the dwell [s].
        settle: rest before, between and after the sines [s].
    """
    for name, values in (("frequencies", frequencies), ("amplitudes", amplitudes)):
        if len(values) == 0:
            raise InputError(f"{name}: none is given; at least one is needed")
    for frequency in frequencies:
        check_positive(frequencies=frequency)
    for amplitude in amplitudes:
        check_bounded(amplitude, frequencies=max(frequencies))
    tones = [(float(f), float(a)) for f in frequencies for a in amplitudes]
    history, dwells = _dwells(tones, cycles, transient, fade, settle)
    description: dict[str, object] = {
        "kind": "stepped_sines",
        "dof": dof,
        "frequencies": [float(f) for f in frequencies],
        "amplitudes": [float(a) for a in amplitudes],
        "cycles": cycles,
        "transient": transient,
        "fade": fade,
        "settle": settle,
        "dwells": dwells,
    }
    return Command(_poses({dof: history}), description)


def orthogonal_multisines(
    amplitudes: Mapping[str, float] | Sequence[float],
    *,
    start: float = 0.1,
    stop: float = 10.0,
    period: float = 60.0,
    periods: int = 3,
    spectrum: str = "flat",
    corner: float = 1.0,
    fade: float = 0.0,
    seed: int = 0,
) -> Command:
    """Multisines in several degrees of freedom at once, each on odd lines of its own.

    With n driven, degree of freedom i has every n-th of the odd lines, from the i-th on: the
    histories are orthogonal over a period, and what one degree of freedom does at another's lines
    is crosstalk (or odd non-linear distortion, which falls on odd lines too). The lines of one
    are 2 n / period apart.

    Args:
        amplitudes: peak per degree of freedom [m or rad]: a mapping by name, or six values in the
            order of a pose; 0 leaves one at rest.
        start: lowest line [Hz].
        stop: highest line [Hz].
        period: length of one period [s]; a whole number of frames.
        periods: periods in all, at least 2; the first is the transient.
        spectrum: `flat` or `acceleration`, as in `multisine`.
        corner: frequency above which displacement falls as 1/f^2 [Hz].
        fade: in, within the first period, and out, in a tail after the last [s].
        seed: of the phases.

    Returns:
        A command whose description has, besides the arguments, `lines`: for each driven degree of
        freedom the numbers of its lines, multiples of 1/period.
    """
    if not isinstance(amplitudes, Mapping):
        if len(amplitudes) != len(DOFS):
            raise InputError(f"amplitudes: {len(amplitudes)} values are given; allowed: 6 or names")
        amplitudes = dict(zip(DOFS, amplitudes, strict=True))
    for name, amplitude in amplitudes.items():
        dof_index(name)
        check_bounded(amplitude)
    driven = {name: float(amplitudes[name]) for name in DOFS if amplitudes.get(name, 0.0) != 0.0}
    if not driven:
        raise InputError("amplitudes: all are 0; at least one must not be")
    orders = odd_orders(start, stop, period, periods)
    if orders.size < len(driven):
        raise InputError(
            f"period: {period} s gives {orders.size} odd lines in {start} to {stop} Hz; "
            f"{len(driven)} degrees of freedom need one each"
        )
    lines = {name: orders[i :: len(driven)] for i, name in enumerate(driven)}
    generator = np.random.default_rng(seed)
    histories = {}
    for name, own in lines.items():
        weights = line_weights(own / period, spectrum, corner)
        once = random_phase_sum(driven[name], own, weights, round(period * RATE), generator)
        histories[name] = repeat(once, periods, fade)
    description: dict[str, object] = {
        "kind": "orthogonal_multisines",
        "amplitudes": driven,
        "start": start,
        "stop": stop,
        "period": period,
        "periods": periods,
        "spectrum": spectrum,
        "corner": corner,
        "fade": fade,
        "lines": {name: own.tolist() for name, own in lines.items()},
    }
    return Command(_poses(histories), description, seed)


def acceleration_step(dof: str, acceleration: float, *, hold: float, at: float = 1.0) -> Command:
    """A demand whose acceleration steps to `acceleration`, holds, and is taken back.

    Constant acceleration for `hold` [s], then the opposite for the same time: the demand ends at
    rest, acceleration x hold^2 away.
    """
    count, rest = round(hold * RATE), round(at * RATE)
    if count < 2 or not np.isfinite(acceleration) or acceleration == 0.0:
        raise InputError(f"acceleration: {acceleration} over hold {hold} s is no step")
    time = np.arange(1, count + 1) / RATE
    rise = 0.5 * acceleration * time**2
    end = acceleration * hold**2
    history = np.concatenate([np.zeros(rest), rise, end - rise[::-1], np.full(rest, end)])
    pose = np.zeros((history.size, 6))
    pose[:, dof_index(dof)] = history
    return Command(
        pose,
        {
            "kind": "acceleration_step",
            "dof": dof,
            "acceleration": acceleration,
            "hold": hold,
            "at": at,
        },
    )


def combine(*commands: Command) -> Command:
    """Several commands at once, each in degrees of freedom of its own.

    Shorter ones hold their last pose to the end of the longest. The description lists theirs under
    `commands`, with their seeds.

    Raises:
        InputError: no command, or two that move the same degree of freedom.
    """
    if not commands:
        raise InputError("commands: none is given; at least one is needed")
    frames = max(command.pose.shape[0] for command in commands)
    pose = np.zeros((frames, 6))
    driver: dict[int, str] = {}
    for number, command in enumerate(commands, start=1):
        label = f"command {number} ({command.description.get('kind', 'array')})"
        for index in np.flatnonzero(command.pose.any(axis=0)).tolist():
            if index in driver:
                raise InputError(
                    f"commands: {DOFS[index]} is moved by {driver[index]} and by {label}; "
                    "allowed: one command for a degree of freedom"
                )
            driver[index] = label
            length = command.pose.shape[0]
            pose[:, index] = np.pad(command.pose[:, index], (0, frames - length), mode="edge")
    parts = [{**command.description, "seed": command.seed} for command in commands]
    return Command(pose, {"kind": "combined", "commands": parts})


def _poses(histories: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
    """Histories (N,) by degree of freedom as poses (N, 6)."""
    pose = np.zeros((next(iter(histories.values())).size, 6))
    for name, history in histories.items():
        pose[:, dof_index(name)] = history
    return pose


def _dwells(
    tones: Sequence[tuple[float, float]], cycles: int, transient: float, fade: float, settle: float
) -> tuple[NDArray[np.float64], list[dict[str, object]]]:
    """History and list of dwells of (frequency [Hz], amplitude) tones in sequence."""
    check_positive(fade=fade, settle=settle)
    check_not_negative(transient=transient)
    if cycles != round(cycles) or cycles < 1:
        raise InputError(f"cycles: {cycles} must be a whole number, at least 1")
    rest = np.zeros(round(settle * RATE))
    before = round((fade + transient) * RATE)
    after = round(fade * RATE)
    pieces, dwells, length = [rest], list[dict[str, object]](), rest.size
    for frequency, amplitude in tones:
        frames = round(cycles / frequency * RATE)
        dwells.append(
            {
                "start": length + before,
                "frames": frames,
                "frequency": frequency,
                "amplitude": amplitude,
                "cycles": int(cycles),
            }
        )
        samples = before + frames + after
        time = (np.arange(samples) - before) / RATE
        tone = amplitude * np.sin(2.0 * np.pi * frequency * time) * raised_cosine(samples, fade)
        pieces += [tone, rest]
        length += samples + rest.size
    return np.concatenate(pieces), dwells


def waypoints(times: ArrayLike, values: ArrayLike) -> NDArray[np.float64]:
    """A path at rest at each of its points, of least jerk between them, for `legs=True`.

    From a to b, with s from 0 to 1 over the stretch: a + (b - a) (10 s^3 - 15 s^4 + 6 s^5), whose
    peak speed is 1.875 times the mean (Flash and Hogan, 1985).

    Args:
        times: of the points [s], from 0 upwards, (m,).
        values: at the points, e.g. extensions [m], (m, n).

    Returns:
        (N, n) at 2048 Hz, the last point included.

    Raises:
        InputError: fewer than two points, times that do not rise from 0, or values that are not
            one finite row a point.
    """
    when = np.asarray(times, dtype=float)
    points = np.atleast_2d(np.asarray(values, dtype=float))
    if when.ndim != 1 or when.size < 2 or when[0] != 0.0 or not (np.diff(when) > 0.0).all():
        raise InputError(f"times: {times!r} must be at least two numbers that rise from 0 s")
    if points.shape[0] != when.size or points.ndim != 2 or not np.isfinite(points).all():
        raise InputError(f"values: must be {when.size} finite rows, one a time")
    time = np.arange(round(when[-1] * RATE) + 1) / RATE
    index = np.clip(np.searchsorted(when, time, side="right") - 1, 0, when.size - 2)
    s = np.clip((time - when[index]) / np.diff(when)[index], 0.0, 1.0)[:, None]
    blend = s**3 * (10.0 - s * (15.0 - 6.0 * s))
    return points[index] + (points[index + 1] - points[index]) * blend
