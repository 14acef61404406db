"""Excitations: commands of platform pose at 2048 Hz that know how they were made.

Steps, sines and chirps start at rest and end at rest; a multisine repeats without a gap, and its
first period is the transient. Amplitudes are in m or rad along one degree of freedom of
the report's axes (z down: a positive heave step lowers the platform).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import signal

from cmf_mj.kinematics import DOFS

RATE = 2048
"""Samples a second [Hz]: the control frame rate."""


@dataclass(frozen=True)
class Command:
    """A platform demand with its description."""

    pose: NDArray[np.float64]
    """Poses [m, rad], (N, 6), one a control frame."""
    description: Mapping[str, object] = field(default_factory=dict)
    """Kind, degree of freedom, amplitude, timing; plain JSON values, kept in the record."""
    seed: int | None = None
    """Seed of the random phases, where there are any."""

    def __post_init__(self) -> None:
        """Check the shape and freeze."""
        if self.pose.ndim != 2 or self.pose.shape[1] != 6 or self.pose.shape[0] < 1:
            raise ValueError(f"command: shape is {self.pose.shape}; allowed: (N, 6) with N >= 1")
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


def dof_index(dof: str) -> int:
    """Position of a degree of freedom in a pose.

    Raises:
        ValueError: it is not one of the six.
    """
    if dof not in DOFS:
        raise ValueError(f"dof: {dof!r} is not one of {', '.join(DOFS)}")
    return DOFS.index(dof)


def _positive(**values: float) -> None:
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0.0):
            raise ValueError(f"{name}: {value} must be a finite number greater than 0")


def _bounded(amplitude: float, **frequencies: float) -> None:
    if not np.isfinite(amplitude):
        raise ValueError(f"amplitude: {amplitude} must be a finite number")
    for name, value in frequencies.items():
        if value > RATE / 2:
            raise ValueError(f"{name}: {value} Hz must be at most {RATE / 2} Hz")


def _command(
    dof: str, history: NDArray[np.float64], description: dict[str, object], seed: int | None = None
) -> Command:
    pose = np.zeros((history.shape[0], 6))
    pose[:, dof_index(dof)] = history
    return Command(pose, {"dof": dof, **description}, seed)


def _time(duration: float) -> NDArray[np.float64]:
    return np.arange(round(duration * RATE)) / RATE


def step(dof: str, amplitude: float, *, at: float = 1.0, duration: float = 13.0) -> Command:
    """A step of `amplitude` at the time `at` [s]; the run lasts `duration` [s]."""
    _bounded(amplitude)
    _positive(duration=duration, at=at)
    if at >= duration:
        raise ValueError(f"at: {at} s must be less than the duration of {duration} s")
    history = np.where(_time(duration) >= at, amplitude, 0.0)
    return _command(
        dof, history, {"kind": "step", "amplitude": amplitude, "at": at, "duration": duration}
    )


def sine(
    dof: str, amplitude: float, frequency: float, *, cycles: float = 10.0, fade: float = 1.0
) -> Command:
    """A sine of whole or part `cycles`, faded in and out by raised cosines of `fade` [s]."""
    _positive(frequency=frequency, cycles=cycles, fade=fade)
    _bounded(amplitude, frequency=frequency)
    duration = cycles / frequency
    fade = min(fade, 0.5 * duration)
    time = _time(duration)
    edge = np.clip(np.minimum(time, duration - time) / fade, 0.0, 1.0)
    history = amplitude * np.sin(2 * np.pi * frequency * time) * 0.5 * (1 - np.cos(np.pi * edge))
    return _command(
        dof,
        history,
        {"kind": "sine", "amplitude": amplitude, "frequency": frequency, "cycles": cycles},
    )


def chirp(
    dof: str,
    amplitude: float,
    *,
    start: float = 0.01,
    stop: float = 10.0,
    duration: float = 100.0,
    settle: float = 2.0,
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
    """
    _positive(start=start, stop=stop, duration=duration, settle=settle)
    _bounded(amplitude, stop=stop)
    if stop <= start:
        raise ValueError(f"stop: {stop} Hz must be above start, {start} Hz")
    stop = max(round((start + stop) * duration), 1) / duration - start
    time = _time(duration)
    sweep = amplitude * signal.chirp(time, start, duration, stop, method="linear", phi=-90.0)
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
        },
    )


def multisine(
    dof: str,
    amplitude: float,
    *,
    start: float = 0.1,
    stop: float = 10.0,
    period: float = 20.0,
    periods: int = 3,
    seed: int = 0,
) -> Command:
    """Odd random-phase multisine, equal lines, repeated whole periods.

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
        seed: of the phases.
    """
    _positive(start=start, stop=stop, period=period)
    _bounded(amplitude, stop=stop)
    if periods < 2:
        raise ValueError(f"periods: {periods} must be at least 2: one transient, one measured")
    samples = round(period * RATE)
    if abs(samples / RATE - period) > 1e-9:
        raise ValueError(f"period: {period} s must be a whole number of frames of 1/{RATE} s")
    orders = np.arange(1, samples // 2, 2)
    orders = orders[(orders >= start * period) & (orders <= stop * period)]
    if orders.size == 0:
        raise ValueError(f"stop: no odd multiple of {1 / period} Hz lies in {start} to {stop} Hz")
    phases = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, orders.size)
    spectrum = np.zeros(samples // 2 + 1, dtype=complex)
    spectrum[orders] = np.exp(1j * phases)
    once = np.fft.irfft(spectrum, samples)
    once *= amplitude / np.abs(once).max()
    once = np.roll(once, -int(np.abs(once).argmin()))
    return _command(
        dof,
        np.tile(once, periods),
        {
            "kind": "multisine",
            "amplitude": amplitude,
            "start": start,
            "stop": stop,
            "period": period,
            "periods": periods,
        },
        seed,
    )
