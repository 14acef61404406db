"""Excitations: commands of platform pose at 2048 Hz that know how they were made.

Steps, pulses, sines, noise and chirps start at rest; a multisine repeats without a gap, and its
first period is the transient. Where a history would start or end in motion, a `fade` [s] takes
it in and out by a raised cosine. Amplitudes are in m or rad along one degree of freedom of the
report's axes (z down: a positive heave step lowers the platform). A description holds the arguments
that make the command again; the seed stands beside it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import signal

from cmf_mj.core.errors import InputError
from cmf_mj.core.rates import RATE
from cmf_mj.machine.dof import dof_index

SPECTRA = ("flat", "acceleration")
"""Amplitude spectra of a multisine."""


@dataclass(frozen=True)
class Command:
    """A platform demand with its description."""

    pose: NDArray[np.float64]  #: Poses [m, rad], (N, 6), one a control frame.
    description: Mapping[str, object] = field(default_factory=dict)
    """Kind, degree of freedom, amplitude, timing; plain JSON values, kept in the record."""
    seed: int | None = None  #: Seed of the random phases, where there are any.

    def __post_init__(self) -> None:
        """Check the shape and freeze."""
        if self.pose.ndim != 2 or self.pose.shape[1] != 6 or self.pose.shape[0] < 1:
            raise InputError(f"command: shape is {self.pose.shape}; allowed: (N, 6) with N >= 1")
        object.__setattr__(self, "pose", np.array(self.pose, dtype=float))
        self.pose.setflags(write=False)
        object.__setattr__(self, "description", MappingProxyType(dict(self.description)))

    @staticmethod
    def from_pose(pose: ArrayLike) -> "Command":
        """A command from an array (N, 6) of poses at 2048 Hz."""
        return Command(np.asarray(pose, dtype=float), {"kind": "array"})

    @property
    def duration(self) -> float:
        """Length [s]."""
        return self.pose.shape[0] / RATE


def check_positive(**values: float) -> None:
    """Refuse what is not a finite number above 0, by its name."""
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0.0):
            raise InputError(f"{name}: {value} must be a finite number greater than 0")


def check_not_negative(**values: float) -> None:
    """Refuse what is not a finite number of at least 0, by its name."""
    for name, value in values.items():
        if not (np.isfinite(value) and value >= 0.0):
            raise InputError(f"{name}: {value} must be a finite number, at least 0")


def check_bounded(amplitude: float, **frequencies: float) -> None:
    """Refuse an amplitude that is not finite and frequencies beyond half the frame rate."""
    if not np.isfinite(amplitude):
        raise InputError(f"amplitude: {amplitude} must be a finite number")
    for name, value in frequencies.items():
        if value > RATE / 2:
            raise InputError(f"{name}: {value} Hz must be at most {RATE / 2} Hz")


def _command(
    dof: str, history: NDArray[np.float64], description: dict[str, object], seed: int | None = None
) -> Command:
    pose = np.zeros((history.shape[0], 6))
    pose[:, dof_index(dof)] = history
    return Command(pose, {"dof": dof, **description}, seed)


def raised_cosine(samples: int, fade: float, *, fade_out: bool = True) -> NDArray[np.float64]:
    """Envelope (samples,): 0 to 1 within the first `fade` [s], 1 to 0 within the last."""
    time = np.arange(samples) / RATE
    left = samples / RATE - time if fade_out else np.inf
    edge = np.minimum(time, left) / fade if fade > 0.0 else np.ones(samples)
    return 0.5 * (1.0 - np.cos(np.pi * np.clip(edge, 0.0, 1.0)))


def _time(duration: float) -> NDArray[np.float64]:
    return np.arange(round(duration * RATE)) / RATE


def step(dof: str, amplitude: float, *, at: float = 1.0, duration: float = 13.0) -> Command:
    """A step of `amplitude` at the time `at` [s]; the run lasts `duration` [s]."""
    check_bounded(amplitude)
    check_positive(duration=duration, at=at)
    if at >= duration:
        raise InputError(f"at: {at} s must be less than the duration of {duration} s")
    history = np.where(_time(duration) >= at, amplitude, 0.0)
    return _command(
        dof, history, {"kind": "step", "amplitude": amplitude, "at": at, "duration": duration}
    )


def pulse(
    dof: str, amplitude: float, *, width: float = 1.0, at: float = 1.0, duration: float = 13.0
) -> Command:
    """A rectangular pulse: out at the time `at` [s], back `width` [s] later.

    Args:
        dof: degree of freedom.
        amplitude: height [m or rad].
        width: time at the height [s], at least two frames.
        at: start [s].
        duration: length of the run [s].
    """
    check_bounded(amplitude)
    check_positive(width=width, at=at, duration=duration)
    begin, frames = max(round(at * RATE), 1), round(width * RATE)
    if frames < 2:
        raise InputError(f"width: {width} s must be at least two frames, {2 / RATE} s")
    history = np.zeros(round(duration * RATE))
    if begin + frames >= history.size:
        raise InputError(
            f"width: {width} s after {at} s must be within the {duration} s of the run"
        )
    history[begin : begin + frames] = amplitude
    return _command(
        dof,
        history,
        {"kind": "pulse", "amplitude": amplitude, "width": width, "at": at, "duration": duration},
    )


def sine(
    dof: str, amplitude: float, frequency: float, *, cycles: float = 10.0, fade: float = 1.0
) -> Command:
    """A sine of whole or part `cycles`, faded in and out by raised cosines of `fade` [s]."""
    check_positive(frequency=frequency, cycles=cycles, fade=fade)
    check_bounded(amplitude, frequency=frequency)
    duration = cycles / frequency
    fade = min(fade, 0.5 * duration)
    time = _time(duration)
    edge = np.clip(np.minimum(time, duration - time) / fade, 0.0, 1.0)
    history = amplitude * np.sin(2 * np.pi * frequency * time) * 0.5 * (1 - np.cos(np.pi * edge))
    return _command(
        dof,
        history,
        {
            "kind": "sine",
            "amplitude": amplitude,
            "frequency": frequency,
            "cycles": cycles,
            "fade": fade,
        },
    )


def chirp(
    dof: str,
    amplitude: float,
    *,
    start: float = 0.01,
    stop: float = 10.0,
    duration: float = 100.0,
    settle: float = 2.0,
    fade: float = 0.0,
) -> Command:
    """The report's chirp: frequency rising linearly, 0.01 to 10 Hz in 100 s (section 2.5).

    Args:
        dof: degree of freedom.
        amplitude: of the sine [m or rad]; the report takes 0.33 in and 0.2 deg.
        start: first frequency [Hz].
        stop: last frequency [Hz], at most half the frame rate; moved by at most 0.5 / duration so
            that the sweep ends on a zero crossing, as the report's does.
        duration: length of the sweep [s].
        settle: rest before and after, so that the record starts and ends still [s].
        fade: of the two ends of the sweep [s]; the report's has none and stops at full speed.
    """
    check_positive(start=start, stop=stop, duration=duration, settle=settle)
    check_not_negative(fade=fade)
    check_bounded(amplitude, stop=stop)
    if stop <= start:
        raise InputError(f"stop: {stop} Hz must be above start, {start} Hz")
    stop = max(round((start + stop) * duration), 1) / duration - start
    time = _time(duration)
    sweep = amplitude * signal.chirp(time, start, duration, stop, method="linear", phi=-90.0)
    sweep *= raised_cosine(sweep.size, fade)
    rest = np.zeros(round(settle * RATE))
    return _command(
        dof,
        np.concatenate([rest, sweep, rest]),
        {
            "kind": "chirp",
            "amplitude": amplitude,
            "start": start,
            "stop": stop,
            "duration": duration,
            "settle": settle,
            "fade": fade,
        },
    )


def noise(
    dof: str,
    amplitude: float,
    *,
    start: float = 0.1,
    stop: float = 10.0,
    duration: float = 100.0,
    settle: float = 2.0,
    fade: float = 2.0,
    scale: str = "peak",
    seed: int = 0,
) -> Command:
    """Gaussian noise, white in displacement from `start` to `stop` and nothing outside.

    Args:
        dof: degree of freedom.
        amplitude: of the displacement, as `scale` says [m or rad].
        start: lower edge of the band [Hz].
        stop: upper edge of the band [Hz].
        duration: length of the noise with its fades [s].
        settle: rest before and after [s].
        fade: of both ends of the noise [s]; it widens the band by about 1 / fade.
        scale: `peak` for the largest displacement, `rms` for its root mean square over `duration`.
        seed: of the noise.
    """
    check_positive(start=start, stop=stop, duration=duration, settle=settle, fade=fade)
    check_bounded(amplitude, stop=stop)
    if scale not in ("peak", "rms"):
        raise InputError(f"scale: {scale!r} is not one of peak, rms")
    if 2.0 * fade > duration:
        raise InputError(f"fade: {fade} s must be at most half the duration of {duration} s")
    samples = round(duration * RATE)
    frequency = np.fft.rfftfreq(samples, 1.0 / RATE)
    band = (frequency >= start) & (frequency <= stop)
    if not band.any():
        raise InputError(f"stop: no multiple of {1 / duration} Hz lies in {start} to {stop} Hz")
    draw = np.random.default_rng(seed).standard_normal((2, np.count_nonzero(band)))
    spectrum = np.zeros(frequency.size, dtype=complex)
    spectrum[band] = draw[0] + 1j * draw[1]
    history = np.fft.irfft(spectrum, samples) * raised_cosine(samples, fade)
    size = np.abs(history).max() if scale == "peak" else np.sqrt(np.mean(history**2))
    rest = np.zeros(round(settle * RATE))
    return _command(
        dof,
        np.concatenate([rest, history * (amplitude / size), rest]),
        {
            "kind": "noise",
            "amplitude": amplitude,
            "start": start,
            "stop": stop,
            "duration": duration,
            "settle": settle,
            "fade": fade,
            "scale": scale,
        },
        seed,
    )


def odd_orders(start: float, stop: float, period: float, periods: int) -> NDArray[np.int64]:
    """Odd multiples of 1/period within `start` to `stop` [Hz]; there must be one."""
    check_positive(start=start, stop=stop, period=period)
    check_bounded(0.0, stop=stop)
    if periods < 2:
        raise InputError(f"periods: {periods} must be at least 2: one transient, one measured")
    samples = round(period * RATE)
    if abs(samples / RATE - period) > 1e-9:
        raise InputError(f"period: {period} s must be a whole number of frames of 1/{RATE} s")
    orders = np.arange(1, samples // 2, 2)
    orders = orders[(orders >= start * period) & (orders <= stop * period)]
    if orders.size == 0:
        raise InputError(f"stop: no odd multiple of {1 / period} Hz lies in {start} to {stop} Hz")
    return orders


def line_weights(
    frequency: NDArray[np.float64], spectrum: str, corner: float
) -> NDArray[np.float64]:
    """Relative displacements at `frequency` [Hz]: 1, or (corner / f)^2 above the corner."""
    check_positive(corner=corner)
    if spectrum not in SPECTRA:
        raise InputError(f"spectrum: {spectrum!r} is not one of {', '.join(SPECTRA)}")
    if spectrum == "flat":
        return np.ones(frequency.size)
    return np.minimum(1.0, (corner / frequency) ** 2)


def random_phase_sum(
    amplitude: float,
    orders: NDArray[np.int64],
    weights: NDArray[np.float64],
    samples: int,
    generator: np.random.Generator,
) -> NDArray[np.float64]:
    """One period (samples,) with random phases and this peak, from its sample nearest to zero."""
    phases = generator.uniform(0.0, 2.0 * np.pi, orders.size)
    spectrum = np.zeros(samples // 2 + 1, dtype=complex)
    spectrum[orders] = weights * np.exp(1j * phases)
    once = np.fft.irfft(spectrum, samples)
    once *= amplitude / np.abs(once).max()
    return np.roll(once, -int(np.abs(once).argmin()))


def repeat(once: NDArray[np.float64], periods: int, fade: float) -> NDArray[np.float64]:
    """Whole periods: the start of the first faded in, a tail of `fade` [s] after the last."""
    period = once.size / RATE
    check_not_negative(fade=fade)
    if fade > period:
        raise InputError(f"fade: {fade} s must be at most the period of {period} s")
    tail = round(fade * RATE)
    history = np.concatenate([np.tile(once, periods), once[:tail]])
    history[:tail] *= raised_cosine(tail, fade, fade_out=False)
    history[history.size - tail :] *= raised_cosine(tail, fade, fade_out=False)[::-1]
    return history


def multisine(
    dof: str,
    amplitude: float,
    *,
    start: float = 0.1,
    stop: float = 10.0,
    period: float = 20.0,
    periods: int = 3,
    spectrum: str = "flat",
    corner: float = 1.0,
    fade: float = 0.0,
    seed: int = 0,
) -> Command:
    """Odd random-phase multisine, repeated whole periods.

    Lines are the odd multiples of 1/period between `start` and `stop`; even non-linear distortion
    then falls between them. The peak is scaled to `amplitude`. The first of the periods is the
    transient, dropped by the analysis.

    Args:
        dof: degree of freedom.
        amplitude: peak of the sum [m or rad].
        start: lowest line [Hz].
        stop: highest line [Hz].
        period: length of one period [s]; a whole number of frames.
        periods: periods in all, at least 2.
        spectrum: `flat` for lines of equal displacement; `acceleration` for lines of equal
            acceleration above the `corner`, which spares the machine at high frequencies.
        corner: frequency above which displacement falls as 1/f^2 [Hz].
        fade: fades in within the first period and out in a tail after the last one [s]; 0 starts
            and stops in motion.
        seed: of the phases.
    """
    check_bounded(amplitude)
    orders = odd_orders(start, stop, period, periods)
    once = random_phase_sum(
        amplitude,
        orders,
        line_weights(orders / period, spectrum, corner),
        round(period * RATE),
        np.random.default_rng(seed),
    )
    return _command(
        dof,
        repeat(once, periods, fade),
        {
            "kind": "multisine",
            "amplitude": amplitude,
            "start": start,
            "stop": stop,
            "period": period,
            "periods": periods,
            "spectrum": spectrum,
            "corner": corner,
            "fade": fade,
        },
        seed,
    )
