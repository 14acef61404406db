"""Iterative learning: what one run of a manoeuvre missed corrects the demand of the next.

r are the legs of the motion asked, at the host's times, and y_k those of trial k. With c_k the
correction of the demand, G the closed loop from demand to legs with the DCU's delay, n_k what does
not repeat (noise), and zero-phase filters over the whole record, which is known in advance,

    y_k = G (r + c_k) + n_k,    e_k = r - y_k,    c_0 = 0,    c_k+1 = Q (c_k + L e_k)

    c_k+1 = Q (1 - L G) c_k + Q L ((1 - G) r - n_k)

The correction converges where the largest singular value of Q (1 - L G) is below 1, at least by
that ratio a trial. Q = 1 / (1 + (f / CORNER)^8). Over machines and poses G_i, the mean of
|1 - L G_i|^2 (Frobenius) is least for the L of the normal equations; SHARE g of it is learnt:

    L = g mean(G_i^H) mean(G_i G_i^H)^-1,    for one machine g G^-1

It learns little where the machines disagree, as near a lightly damped mode that moves with the
pose. At each frequency it is then reduced by the factor of 0 to 1 with which the largest ratio of
all machines is least, and Q by what brings that ratio to `SLOWEST`: none of them diverges, and
noise does not add up. For one machine, with q = Q (1 - g) and S the density of n,

    e_k = (1 - g Q (1 - q^k) / (1 - q)) e_0 -> (1 - Q) / (1 - q) e_0
    density of the noise that is learnt into the motion -> S (g Q)^2 / (1 - q^2)

The demand is changed, not the law: r + c_k keeps the limits of host frames, `within_limits`, and
what they hold back is no part of c_k. The machine rests for `LEAD` first, where the correction
fades in, since no demand can be early from its first frame on. Errors count after it and below
`BAND`: root mean square of a degree of freedom [m, rad], and as one number of all legs [m].
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import control
import numpy as np
from numpy.typing import NDArray
from scipy import signal

from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.control.law import Law, load_law
from cmf_mj.core.errors import InputError
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.facility.host.stream import HostStream, differentiate, make_stream, resample
from cmf_mj.facility.host_chain import dcu_of
from cmf_mj.facility.operation import operate
from cmf_mj.facility.unknowns import load_unknowns, with_valve_gains
from cmf_mj.machine.cab import Cab
from cmf_mj.machine.kinematics import legs_to_pose, pose_to_legs
from cmf_mj.machine.limits import MotionLimits
from cmf_mj.machine.machine import Machine
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.pilot.cueing import within_limits
from cmf_mj.pilot.fly import RECORD_EVERY, low_passed
from cmf_mj.pilot.motion import MOST_RATE
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters import HydraulicParameters
from cmf_mj.signals.single import quintic

SHARE = 0.6  #: Of an error, what the next trial makes up.
CORNER = 6.0  #: Of Q, where it is one half [Hz].
SLOWEST = 0.9  #: Largest ratio of two trials.
BAND = 4.0  #: Highest frequency of the errors that count [Hz].
LEAD = 1.0  #: Rest before the manoeuvre [s].
_HIGHEST = 10.0  #: Nothing is learnt above it [Hz].
_PAD_FRAMES = 320  #: Reflected at the ends before a filter.
_LEARNING_FACTORS = np.linspace(0.0, 1.0, 21)  #: On L.

Array = NDArray[np.float64]
Response = NDArray[np.complex128]


class Learner(NamedTuple):
    """Filters of histories of n legs, at K `filter_frequencies`."""

    responses: Response  #: G_i of the machines, (M, K, n, n).
    learning: Response  #: L, (K, n, n).
    smoothing: Response  #: Q times the unit matrix, (K, n, n).

    def improved(self, correction: Array, error: Array) -> Array:
        """Q (c + L e) of a correction and an error, (N, n)."""
        return filtered(self.smoothing, correction + filtered(self.learning, error))

    def ratio(self) -> Array:
        """Largest singular value of Q (1 - L G_i), (M, K): below 1 machine i learns."""
        unlearnt = np.eye(self.learning.shape[1]) - self.learning @ self.responses
        return np.asarray(np.linalg.norm(self.smoothing @ unlearnt, 2, axis=(-2, -1)))


def filter_frequencies(frame_count: int) -> Array:
    """Frequencies [Hz] of the filters of histories of so many frames at 80 Hz, (K,)."""
    lines = np.fft.rfftfreq(frame_count + 2 * _PAD_FRAMES, 1.0 / MOST_RATE)
    return np.asarray(lines[lines <= _HIGHEST])


def filtered(response: Response, history: Array) -> Array:
    """A history (N, n) through a response (K, n, n), nothing above its frequencies."""
    padded = np.pad(
        history, ((_PAD_FRAMES, _PAD_FRAMES), (0, 0)), mode="reflect", reflect_type="odd"
    )
    lines = np.fft.rfft(padded, axis=0)[: len(response)]
    filtered_lines = np.einsum("kij,kj->ki", response, lines)
    return np.asarray(np.fft.irfft(filtered_lines, len(padded), axis=0)[_PAD_FRAMES:-_PAD_FRAMES])


def make_learner(responses: Sequence[Response], frequency: Array, share: float = SHARE) -> Learner:
    """The filters for machines with the responses (K, n, n) at `filter_frequencies`."""
    machines = np.array(responses)
    adjoints = machines.conj().swapaxes(-1, -2)
    learning = share * adjoints.mean(axis=0) @ np.linalg.inv((machines @ adjoints).mean(axis=0))
    unit = np.eye(machines.shape[-1])
    ratios = [
        np.linalg.norm(unit - factor * learning @ machines, 2, axis=(-2, -1)).max(axis=0)
        for factor in _LEARNING_FACTORS
    ]
    best_factors = _LEARNING_FACTORS[np.argmin(ratios, axis=0)]
    learning *= best_factors[:, None, None]
    smoothing = np.minimum(1.0, SLOWEST / np.min(ratios, axis=0))
    smoothing /= 1.0 + (frequency / CORNER) ** 8
    return Learner(machines, learning, smoothing[:, None, None] * unit.astype(complex))


def leg_response(
    law: Law, plant: Hexapod, pose: Array, frequency: Array, dcu: Any = None
) -> Response:
    """G from the legs of the host's frames to those of a plant about a pose, (K, 6, 6).

    Dry friction is left out.
    """
    loop = Linear(plant, pose, friction="none").leg_loop(law)
    omega = 2.0 * np.pi * np.maximum(frequency, 0.01)  # at rest an integrator has no response
    response = np.moveaxis(control.frequency_response(loop, omega).frdata, -1, 0)
    delay = sum(dcu_of(plant.machine, dcu).delay.parts(plant.machine.rate).values())
    return np.asarray(response * np.exp(-1j * omega * delay)[:, None, None])


class Trial(NamedTuple):
    """Sizes of the errors of one run: root mean squares of what counts."""

    pose: Array  #: By degree of freedom [m, rad], (6,).
    legs: float  #: Of all legs [m].
    sensed: float  #: Of all legs as sensed [m].
    predicted: float  #: The same, by the first run and the first G alone [m].
    held_frames: int  #: Of the demand, that the limits held back.


class RunErrors(NamedTuple):
    """Errors of a run: reference less flown."""

    sensed: Array  #: Of legs as sensed, at all times and frequencies [m], (N, 6).
    legs: Array  #: Of legs, `within_band` [m], (M, 6).
    pose: Array  #: Of the pose, `within_band` [m, rad], (M, 6).

    def trial(self, predicted: Array, held_frames: int) -> Trial:
        """Sizes of the errors, and of the `predicted` one of the legs, (N, 6)."""
        pose, sensed = np.sqrt((self.pose**2).mean(axis=0)), rms(within_band(self.sensed))
        return Trial(pose, rms(self.legs), sensed, rms(within_band(predicted)), held_frames)


class Learning(NamedTuple):
    """A manoeuvre as it was learnt."""

    reference: HostStream  #: The motion to follow, with the lead before it.
    demand: HostStream  #: What the host sent in its stead in the best trial.
    trials: tuple[Trial, ...]  #: The first without correction.
    best: int  #: The trial that missed least, as sensed.
    errors: tuple[Array, Array]  #: Of the pose, first and best trial, after the lead [m, rad].
    learner: Learner


def learn(
    stream: HostStream,
    law: str | Law,
    plants: Sequence[Hexapod],
    *,
    trials: int = 8,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> Learning:
    """Fly a motion on the first plant, and again corrected by what its leg sensors measured.

    G_i are those of the plants in turn, at the mean pose and where a leg is longest or shortest.
    Trial k, the first run being 0, has the noise of seed + k. Refuses fewer than one trial, less
    than a period of `BAND`, and a run that a fault ends. `options` are those of `operate`.

    >>> from cmf_mj.facility.host.stream import from_command
    >>> from cmf_mj.pilot.learning import learn
    >>> motion = from_command(cmf_mj.signals.sine("heave", 0.05, frequency=0.6, cycles=2), 80.0)
    >>> learnt = learn(motion, "velocity", [cmf_mj.Hexapod()], trials=1)
    >>> [f"{trial.legs / learnt.trials[0].legs:.0%}" for trial in learnt.trials]
    ['100%', '39%']
    """
    if trials < 1:
        raise InputError(f"trials: {trials} must be at least 1")
    loaded_law, machine = load_law(law), plants[0].machine
    limits = load_motion_limits(options.get("limits"), machine)
    reference = within_limits(_with_lead(stream), limits, machine)[0]
    if (seconds := reference.time[-1] - LEAD) < 1.0 / BAND:
        raise InputError(f"stream: lasts {seconds:.3g} s; allowed: at least {1.0 / BAND:g} s")
    learner = _learner_of(reference, loaded_law, plants, options.get("dcu"))
    fade_in = quintic(np.clip(reference.time / (0.5 * LEAD), 0.0, 1.0))[:, None]
    demand = _Demand(reference, np.zeros_like(reference.pose), 0)
    demands, runs, results = list[_Demand](), list[RunErrors](), list[Trial]()
    predicted_correction = predicted_error = np.zeros_like(reference.pose)
    for trial in range(trials + 1):
        if trial:
            predicted_correction = fade_in * learner.improved(predicted_correction, predicted_error)
            correction = fade_in * learner.improved(demand.correction, runs[-1].sensed)
            demand = _corrected(reference, correction, limits, machine)
        demands.append(demand)
        runs.append(
            measure_errors(reference, demand.stream, loaded_law, plants[0], seed + trial, **options)
        )
        predicted_error = runs[0].sensed - filtered(learner.responses[0], predicted_correction)
        results.append(runs[-1].trial(predicted_error, demand.held_frames))
        if progress is not None:
            progress(trial + 1, trials + 1)
    best = int(np.argmin([result.sensed for result in results]))
    errors = runs[0].pose, runs[best].pose
    return Learning(reference, demands[best].stream, tuple(results), best, errors, learner)


def _with_lead(stream: HostStream) -> HostStream:
    """Frames at 80 Hz that rest at the first pose for `LEAD` before they move."""
    motion, rest = resample(stream, MOST_RATE), np.zeros((round(LEAD * MOST_RATE), 6))
    pose = np.vstack([rest + motion.pose[0], motion.pose])
    velocity = np.vstack([rest, motion.velocity])
    acceleration = np.vstack([rest, motion.acceleration])
    return make_stream(np.arange(len(pose)) / MOST_RATE, pose, velocity, acceleration)


def _learner_of(reference: HostStream, law: Law, plants: Sequence[Hexapod], dcu: Any) -> Learner:
    """The learner of plants in turn, at the mean pose and where a leg is longest or shortest."""
    legs = pose_to_legs(reference.pose, plants[0].machine)
    end_frames = np.unique(np.concatenate([legs.argmin(axis=0), legs.argmax(axis=0)]))
    poses = [reference.pose.mean(axis=0), *reference.pose[end_frames]]
    lines = filter_frequencies(len(legs))
    responses = [
        leg_response(law, plants[i % len(plants)], poses[i % len(poses)], lines, dcu)
        for i in range(max(len(plants), len(poses)))
    ]
    return make_learner(responses, lines)


class _Demand(NamedTuple):
    """What the host sends in a trial."""

    stream: HostStream
    correction: Array  #: Of the legs, as far as the limits let it pass [m], (N, 6).
    held_frames: int  #: That the limits held back.


def _corrected(
    reference: HostStream, correction: Array, limits: MotionLimits, machine: Machine
) -> _Demand:
    """The demand with a correction of its legs, within the limits."""
    legs = pose_to_legs(reference.pose, machine)
    pose = legs_to_pose(legs + correction, machine)
    velocity, acceleration = differentiate(reference.time, pose - reference.pose)
    velocity, acceleration = reference.velocity + velocity, reference.acceleration + acceleration
    corrected = make_stream(reference.time, pose, velocity, acceleration)
    demand, held_back = within_limits(corrected, limits, machine)
    passed = pose_to_legs(demand.pose, machine) - legs
    return _Demand(demand, passed, int(held_back.sum()))


def rms(error: Array) -> float:
    """Root mean square of all its numbers."""
    return float(np.sqrt(np.mean(error**2)))


def measure_errors(
    reference: HostStream, demand: HostStream, law: Law, plant: Hexapod, seed: int, **options: Any
) -> RunErrors:
    """Fly a demand, with the noise of a seed, and measure its errors from the reference."""
    electronics = options.get("electronics", ElectronicsSettings())
    if electronics is not None:
        electronics = electronics.model_copy(update={"seed": seed})
    run = options | {"electronics": electronics}
    record = operate(plant, law, demand, record_every=RECORD_EVERY, **run).record
    if (fault := record.metadata["fault"]) is not None:
        raise InputError(f"law: {law.name} ends a run: {fault['name']} at {fault['time']:.3f} s")

    def error(reference_values: Array, channel: str) -> Array:
        values = low_passed(record, record[channel], record.time, reference.time)
        return reference_values - values

    legs = pose_to_legs(reference.pose, plant.machine)
    leg_error, pose_error = error(legs, "leg_extension"), error(reference.pose, "platform_pose")
    return RunErrors(error(legs, "leg_position"), within_band(leg_error), within_band(pose_error))


def within_band(error: Array) -> Array:
    """An error (N, n) below `BAND` after the lead, (M, n): as far as it counts."""
    sections = signal.butter(4, BAND, fs=MOST_RATE, output="sos")
    return np.asarray(signal.sosfiltfilt(sections, error, axis=0)[round(LEAD * MOST_RATE) :])


def draw_machine(cab: Cab, hydraulics: HydraulicParameters, seed: int, draw: int) -> Hexapod:
    """A machine of `other_machines` with valve gains; laws take its cab for the nominal."""
    generator, unknowns = np.random.default_rng([seed, draw]), load_unknowns("other_machines")
    (values,) = unknowns.draw("random", 1, generator)
    drawn_hydraulics = unknowns.apply(values, hydraulics)
    valves = with_valve_gains(drawn_hydraulics, int(generator.integers(2**32)))
    return Hexapod(unknowns.apply(values, cab, f"{cab.name}_{draw}"), valves)
