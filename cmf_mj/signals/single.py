"""Excitations of one degree of freedom.

Steps, pulses, sines, noise and chirps start at rest; a multisine repeats without a gap, and its
first period is the transient. A `fade` [s] takes a history in and out by a raised cosine. Axes are
the report's (z down: a positive heave step lowers the platform).
"""

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy import signal

from cmf_mj.core.errors import InputError
from cmf_mj.core.settings import Seed
from cmf_mj.core.units import FASTEST_RATE
from cmf_mj.machine.geometry import dof_index
from cmf_mj.signals.signal import (
    LONGEST,
    Array,
    Duration,
    Frequency,
    Motion,
    Signal,
    SingleSignal,
    Wait,
    check_fade,
    command_of,
)

Cycles = Annotated[float, Field(gt=0.0, le=LONGEST * FASTEST_RATE / 2)]  #: Of a sine, above 0.


def raised_cosine(samples: int, fade: float, rate: int, *, fade_out: bool = True) -> Array:
    """Envelope (samples,): 0 to 1 within the first `fade` [s], 1 to 0 within the last."""
    time = np.arange(samples) / rate
    time_to_end = samples / rate - time if fade_out else np.inf
    share = np.minimum(time, time_to_end) / fade if fade > 0.0 else np.ones(samples)
    return 0.5 * (1.0 - np.cos(np.pi * np.clip(share, 0.0, 1.0)))


def quintic(s: Array) -> Array:
    """From 0 to 1 with no velocity and no acceleration at either end: s^3 (10 - 15 s + 6 s^2)."""
    return s**3 * (10.0 - s * (15.0 - 6.0 * s))


def _time(duration: float, rate: int) -> Array:
    return np.arange(round(duration * rate)) / rate


def _with_rest(history: Array, settle: float, rate: int) -> Array:
    rest = np.zeros(round(settle * rate))
    return np.concatenate([rest, history, rest])


class Step(SingleSignal):
    """A step of `amplitude` at the time `at` [s]; the run lasts `duration` [s].

    >>> cmf_mj.signals.step("heave", 0.0254).pose[[0, -1], 2]  # one inch down
    array([0.    , 0.0254])
    """

    kind: Literal["step"]
    at: Duration = 1.0  #: Time of the step [s].
    duration: Duration | None = 13.0  #: Length of the run [s]; None for two frames after the step.

    @property
    def length(self) -> float:
        """Length of the table [s]."""
        return self.at + 2.0 / self.rate if self.duration is None else self.duration

    def _check(self) -> None:
        if self.at > (round(self.length * self.rate) - 1) / self.rate:
            raise InputError(f"at: {self.at} s must be less than the duration of {self.length} s")

    def _history(self, seed: int) -> Array:
        return np.where(_time(self.length, self.rate) >= self.at, self.size, 0.0)


class Pulse(SingleSignal):
    """A rectangular pulse: out at the time `at` [s], back `width` [s] later."""

    kind: Literal["pulse"]
    width: Duration = 1.0  #: Time at the height [s], at least two frames.
    at: Duration = 1.0  #: Start [s].
    duration: Duration | None = 13.0  #: Length of the run [s]; None for three frames more.

    @property
    def length(self) -> float:
        """Length of the table [s]."""
        return self.at + self.width + 3.0 / self.rate if self.duration is None else self.duration

    def _check(self) -> None:
        begin, width = self._frames()
        if width < 2:
            raise InputError(f"width: {self.width} s must be two frames or more, {2 / self.rate} s")
        if begin + width >= round(self.length * self.rate):
            run = f"the {self.length} s of the run"
            raise InputError(f"width: {self.width} s after {self.at} s must be within {run}")

    def _frames(self) -> tuple[int, int]:
        """Start and width in control frames."""
        return max(round(self.at * self.rate), 1), round(self.width * self.rate)

    def _history(self, seed: int) -> Array:
        begin, width = self._frames()
        history = np.zeros(round(self.length * self.rate))
        history[begin : begin + width] = self.size
        return history


class Sine(SingleSignal):
    """A sine of whole or part `cycles`, faded in and out by raised cosines of `fade` [s].

    >>> cmf_mj.signals.sine("roll", [3.0, "deg"], 0.5, cycles=4).duration
    8.0
    """

    kind: Literal["sine"]
    frequency: Frequency  #: Frequency [Hz], at most half the control rate.
    cycles: Cycles | None = 10.0  #: Length; None goes on for ever, as a motion only.
    fade: Duration = 1.0  #: Of the ends [s]; at most half the sine.
    rest: Wait = 0.0  #: At the pose zero afterwards [s].

    @property
    def length(self) -> float:
        """Length of the table [s]; 0 without an end."""
        return 0.0 if self.cycles is None else self.cycles / self.frequency + self.rest

    def _history(self, seed: int) -> Array:
        if self.cycles is None:
            raise InputError("cycles: a sine without an end has no table")
        duration = self.cycles / self.frequency
        fade = min(self.fade, 0.5 * duration)
        time = _time(duration, self.rate)
        share = np.clip(np.minimum(time, duration - time) / fade, 0.0, 1.0)
        sine = self.size * np.sin(2 * np.pi * self.frequency * time)
        history = sine * 0.5 * (1 - np.cos(np.pi * share))
        return np.concatenate([history, np.zeros(round(self.rest * self.rate))])

    def motion(self, seed: int = 0) -> Motion:
        """The sine, endless without `cycles`."""
        if self.cycles is not None:
            return super().motion(seed)
        index, size = dof_index(self.dof), self.size

        def endless(frames: NDArray[np.int64]) -> Array:
            time = np.maximum(frames, 0) / self.rate
            envelope = 0.5 * (1.0 - np.cos(np.pi * np.minimum(time / self.fade, 1.0)))
            poses = np.zeros((frames.size, 6))
            poses[:, index] = size * envelope * np.sin(2.0 * np.pi * self.frequency * time)
            return poses

        return endless


class Chirp(SingleSignal):
    """The report's chirp: frequency rising linearly, 0.01 to 10 Hz in 100 s (section 2.5).

    The report sweeps 0.33 in and 0.2 deg. `stop` is moved by at most 0.5 / duration so that the
    sweep ends on a zero crossing, as the report's does; it has no `fade` and stops at full speed.

    >>> cmf_mj.signals.chirp("surge", [0.33, "in"]).pose.max(0).round(5)
    array([0.00838, 0.     , 0.     , 0.     , 0.     , 0.     ])
    """

    kind: Literal["chirp"]
    start: Frequency = 0.01  #: First frequency [Hz].
    stop: Frequency = 10.0  #: Last frequency [Hz], at most half the control rate.
    duration: Duration = 100.0  #: Length of the sweep [s].
    settle: Duration = 2.0  #: Rest before and after, so that the record starts and ends still [s].
    fade: Wait = 0.0  #: Of the two ends of the sweep [s].

    @property
    def length(self) -> float:
        """Length of the table [s]."""
        return self.duration + 2.0 * self.settle

    @property
    def band(self) -> tuple[float, float]:
        """First and last frequency of the sweep [Hz]."""
        half_cycles = max(round((self.start + self.stop) * self.duration), 1)
        return self.start, half_cycles / self.duration - self.start

    def _check(self) -> None:
        if self.stop <= self.start:
            raise InputError(f"stop: {self.stop} Hz must be above start, {self.start} Hz")
        check_fade(self.fade, self.duration)

    def _history(self, seed: int) -> Array:
        start, stop = self.band
        sweep = self.size * signal.chirp(
            _time(self.duration, self.rate), start, self.duration, stop, method="linear", phi=-90.0
        )
        envelope = raised_cosine(sweep.size, self.fade, self.rate)
        return _with_rest(sweep * envelope, self.settle, self.rate)


class Noise(SingleSignal):
    """Gaussian noise, white in displacement from `start` to `stop` and nothing outside.

    >>> cmf_mj.signals.noise("sway", 0.01, stop=5.0).duration  # with 2 s of rest at both ends
    104.0
    """

    kind: Literal["noise"]
    start: Frequency = 0.1  #: Lower edge of the band [Hz].
    stop: Frequency = 10.0  #: Upper edge of the band [Hz].
    duration: Duration = 100.0  #: Length of the noise with its fades [s].
    settle: Duration = 2.0  #: Rest before and after [s].
    fade: Duration = 2.0  #: Of both ends of the noise [s]; it widens the band by about 1 / fade.
    scale: Literal["peak", "rms"] = "peak"
    """Meaning of the amplitude: the largest displacement, or its root mean square."""
    seed: Seed | None = None  #: Of the noise; None for that of the scenario, else 0.

    @property
    def length(self) -> float:
        """Length of the table [s]."""
        return self.duration + 2.0 * self.settle

    def _check(self) -> None:
        check_fade(self.fade, self.duration)
        if not self._in_band().any():
            band = f"{self.start} to {self.stop} Hz"
            raise InputError(f"stop: no multiple of {1 / self.duration} Hz lies in {band}")

    def _in_band(self) -> NDArray[np.bool_]:
        frequency = np.fft.rfftfreq(round(self.duration * self.rate), 1.0 / self.rate)
        return (frequency >= self.start) & (frequency <= self.stop)

    def _history(self, seed: int) -> Array:
        samples, in_band = round(self.duration * self.rate), self._in_band()
        generator = np.random.default_rng(seed)
        real, imaginary = generator.standard_normal((2, np.count_nonzero(in_band)))
        spectrum = np.zeros(in_band.size, dtype=complex)
        spectrum[in_band] = real + 1j * imaginary
        history = np.fft.irfft(spectrum, samples) * raised_cosine(samples, self.fade, self.rate)
        size = np.abs(history).max() if self.scale == "peak" else np.sqrt(np.mean(history**2))
        return _with_rest(history * (self.size / size), self.settle, self.rate)


class OddLines(Signal):
    """Odd lines with random phases, repeated whole periods; the first period is the transient."""

    start: Frequency = 0.1  #: Lowest line [Hz].
    stop: Frequency = 10.0  #: Highest line [Hz].
    period: Duration = 20.0  #: Length of one period [s]; a whole number of frames.
    periods: Annotated[int, Field(ge=2, lt=2**31)] = 3  #: Periods in all.
    spectrum: Literal["flat", "acceleration"] = "flat"
    """Lines of equal displacement, or of equal acceleration above the `corner`."""
    corner: Frequency = 1.0  #: Frequency above which displacement falls as 1/f^2 [Hz].
    fade: Wait = 0.0  #: In within the first period, out after the last [s]; 0 starts in motion.
    seed: Seed | None = None  #: Of the phases; None for that of the scenario, else 0.

    @property
    def length(self) -> float:
        """Length of the table [s]."""
        return self.periods * self.period + self.fade

    def _check(self) -> None:
        if abs(round(self.period * self.rate) / self.rate - self.period) > 1e-9:
            frames = f"a whole number of frames of 1/{self.rate} s"
            raise InputError(f"period: {self.period} s must be {frames}")
        if self.orders.size == 0:
            band = f"{self.start} to {self.stop} Hz"
            raise InputError(f"stop: no odd multiple of {1 / self.period} Hz lies in {band}")
        if self.fade > self.period:
            raise InputError(f"fade: {self.fade} s must be at most the period of {self.period} s")

    @property
    def orders(self) -> NDArray[np.int64]:
        """Numbers of the lines: odd multiples of 1/period."""
        orders = np.arange(1, round(self.period * self.rate) // 2, 2)
        in_band = (orders >= self.start * self.period) & (orders <= self.stop * self.period)
        return orders[in_band]

    def _sum(
        self, amplitude: float, orders: NDArray[np.int64], generator: np.random.Generator
    ) -> Array:
        """The periods and the tail: of this peak, from the sample nearest to zero."""
        samples, weights = round(self.period * self.rate), np.ones(orders.size)
        if self.spectrum == "acceleration":
            weights = np.minimum(1.0, (self.corner / (orders / self.period)) ** 2)
        phases = generator.uniform(0.0, 2.0 * np.pi, orders.size)
        spectrum = np.zeros(samples // 2 + 1, dtype=complex)
        spectrum[orders] = weights * np.exp(1j * phases)
        period = np.fft.irfft(spectrum, samples)
        period *= amplitude / np.abs(period).max()
        period = np.roll(period, -int(np.abs(period).argmin()))
        tail = round(self.fade * self.rate)
        history = np.concatenate([np.tile(period, self.periods), period[:tail]])
        fade_in = raised_cosine(tail, self.fade, self.rate, fade_out=False)
        history[:tail] *= fade_in
        history[history.size - tail :] *= fade_in[::-1]
        return history


class Multisine(OddLines, SingleSignal):
    """Odd random-phase multisine of the peak `amplitude`, repeated whole periods.

    Lines are the odd multiples of 1/period between `start` and `stop`; even non-linear distortion
    then falls between them.

    >>> cmf_mj.signals.multisine("yaw", [0.2, "deg"], period=10.0, periods=2).duration
    20.0
    """

    kind: Literal["multisine"]

    def _history(self, seed: int) -> Array:
        return self._sum(self.size, self.orders, np.random.default_rng(seed))


step = command_of(Step)
pulse = command_of(Pulse)
sine = command_of(Sine)
chirp = command_of(Chirp)
noise = command_of(Noise)
multisine = command_of(Multisine)
