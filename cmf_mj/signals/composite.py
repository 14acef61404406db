"""Composite signals: dwells at single frequencies, several degrees of freedom at once, paths.

A dwell is a stretch of whole cycles at one frequency and full amplitude, cut out for analysis:

    settle | fade in, transient, dwell, fade out | settle | fade in, ... | settle
"""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, field_validator

from cmf_mj.core.arrays import shaped
from cmf_mj.core.errors import InputError
from cmf_mj.core.settings import Count
from cmf_mj.core.units import RATE
from cmf_mj.machine.geometry import DOFS, by_kind, dof_index
from cmf_mj.signals.signal import (
    Amplitude,
    Array,
    Command,
    Dof,
    Duration,
    Dwell,
    Frequency,
    OneAxis,
    Signal,
    SingleSignal,
    Wait,
    amplitude_in_si,
    check_fade,
    check_highest,
    check_positive,
    command_of,
    poses_along,
)
from cmf_mj.signals.single import OddLines, quintic, raised_cosine

ROUNDS = (
    (0.1, 0.2, 0.4, 0.6, 0.8, 1.0, 1.2),
    (1.4, 1.6, 1.8, 2.0, 2.4, 2.6, 3.0),
    (3.4, 3.6, 4.0, 4.4, 4.6, 5.0, 5.4),
    (5.6, 6.0, 6.4, 6.6, 7.0, 7.4, 7.6),
    (8.0, 8.4, 8.6, 9.0, 9.4, 9.6, 10.0),
)
"""Frequencies of the seven channels in the five rounds [Hz], Table 2-3."""


class _SineFrames(NamedTuple):
    """Control frames of a sine about its dwell."""

    before: int
    after: int
    rest: int  #: At rest afterwards.


class DwelledSines(OneAxis):
    """Sines in sequence, each with a dwell."""

    cycles: Count = 5  #: Whole cycles of a dwell.
    fade: Duration = 1.0  #: Before and after each dwell [s].
    settle: Duration = 5.5  #: Rest before, between and after the sines [s].

    @abstractmethod
    def _tones(self) -> list[tuple[float, float]]:
        """Frequency [Hz] and amplitude [m or rad] of each sine."""

    @property
    def _lead_in(self) -> float:
        """Time from the start of a sine to its dwell [s]."""
        return self.fade

    @property
    def length(self) -> float:
        """Length of the table [s]."""
        around = self._lead_in + self.fade + self.settle
        return self.settle + sum(self.cycles / frequency + around for frequency, _ in self._tones())

    def _frames(self) -> _SineFrames:
        times = self._lead_in, self.fade, self.settle
        return _SineFrames(*(round(time * self.rate) for time in times))

    @property
    def dwells(self) -> tuple[Dwell, ...]:
        """One for each sine."""
        sine = self._frames()
        dwells, start = list[Dwell](), sine.rest + sine.before
        for frequency, amplitude in self._tones():
            frames = round(self.cycles / frequency * self.rate)
            dwells.append(Dwell(start, frames, frequency, amplitude, self.cycles))
            start += frames + sine.after + sine.rest + sine.before
        return tuple(dwells)

    def _history(self, seed: int) -> Array:
        sine = self._frames()
        rest = np.zeros(sine.rest)
        pieces = [rest]
        for dwell in self.dwells:
            time = np.arange(-sine.before, dwell.frames + sine.after) / self.rate
            envelope = raised_cosine(time.size, self.fade, self.rate)
            tone = dwell.amplitude * np.sin(2.0 * np.pi * dwell.frequency * time) * envelope
            pieces += [tone, rest]
        return np.concatenate(pieces)


class SevenSines(DwelledSines, SingleSignal):
    """One round of the facility's seven-channel generator (Table 2-3).

    Seven sines in sequence; defaults from the record lengths of Appendix A. The report takes
    0.33 in and 0.2 deg.
    """

    kind: Literal["seven_sines"]
    number: Annotated[int, Field(ge=1, le=5)]  #: Number of the round, 1 to 5.

    def _tones(self) -> list[tuple[float, float]]:
        return [(frequency, self.size) for frequency in ROUNDS[self.number - 1]]


class SteppedSines(DwelledSines):
    """Each frequency at each amplitude, for describing functions."""

    kind: Literal["stepped_sines"]
    frequencies: Annotated[tuple[Frequency, ...], Field(min_length=1)]  #: One after the other [Hz].
    amplitudes: Annotated[tuple[Amplitude, ...], Field(min_length=1)]
    """At each frequency, one after the other [m or rad, or with unit]."""
    cycles: Count = 10  #: Whole cycles of a dwell.
    transient: Wait = 2.0  #: Before each dwell [s]; take it longer than the machine rings.
    fade: Duration = 1.0  #: Before the transient and after the dwell [s].
    settle: Duration = 1.0  #: Rest before, between and after the sines [s].

    @property
    def _lead_in(self) -> float:
        return self.fade + self.transient

    def _check(self) -> None:
        self._amplitudes()

    def _amplitudes(self) -> list[float]:
        return [amplitude_in_si(self.dof, amplitude) for amplitude in self.amplitudes]

    def _sizes_in_si(self) -> dict[str, Any]:
        return {"amplitudes": self._amplitudes()}

    def _tones(self) -> list[tuple[float, float]]:
        return list(product(self.frequencies, self._amplitudes()))


class FadedSines(Signal):
    """A test profile: sines one after the other, along each degree of freedom in turn.

    Each lasts `duration` with its fades and ends at rest at neutral.
    """

    kind: Literal["faded_sines"]
    frequencies: Annotated[tuple[Frequency, ...], Field(min_length=1)]  #: One after the other [Hz].
    amplitudes: Annotated[tuple[float, ...], Field(min_length=1)]  #: One for each frequency [m].
    dofs: Annotated[tuple[Dof, ...], Field(min_length=1)]  #: One after the other.
    rotation: float = 0.7  #: Amplitude of a rotation over that of a translation [rad/m].
    duration: Duration = 23.0  #: Length of a sine with its fades [s].
    fade: Duration = 6.0  #: Fade at each end [s].

    @property
    def length(self) -> float:
        """Length of the table [s]."""
        return len(self.dofs) * len(self.frequencies) * self.duration

    def _check(self) -> None:
        if len(self.amplitudes) != len(self.frequencies):
            counts = f"{len(self.amplitudes)} for {len(self.frequencies)} frequencies"
            raise InputError(f"amplitudes: {counts}; allowed: one for each")
        check_fade(self.fade, self.duration)
        check_highest("amplitudes", *self.amplitudes, *(self.rotation * a for a in self.amplitudes))

    def command(self, seed: int = 0) -> Command:
        """The sines."""
        frames = round(self.duration * self.rate)
        time = np.arange(frames) / self.rate
        envelope = raised_cosine(frames, self.fade, self.rate)
        sines = np.concatenate(
            [
                amplitude * np.sin(2.0 * np.pi * frequency * time) * envelope
                for frequency, amplitude in zip(self.frequencies, self.amplitudes, strict=True)
            ]
        )
        pose = np.zeros((len(self.dofs), sines.size, len(DOFS)))
        for stretch, dof in zip(pose, self.dofs, strict=True):
            stretch[:, dof_index(dof)] = by_kind(dof, 1.0, self.rotation) * sines
        return Command(pose.reshape(-1, len(DOFS)), self)


class OrthogonalMultisines(OddLines):
    """Multisines in several degrees of freedom at once, no two with a line in common.

    With n driven, degree of freedom i has every n-th of the odd lines, from the i-th on, 2 n /
    period apart: motion of one degree of freedom at another's lines is crosstalk (or odd non-linear
    distortion).
    """

    kind: Literal["orthogonal_multisines"]
    amplitudes: dict[str, float]  #: Peaks [m or rad] by name, or six as of a pose; 0 for rest.
    period: Duration = 60.0  #: Length of one period [s]; a whole number of frames.

    @field_validator("amplitudes", mode="before")
    @classmethod
    def _by_name(cls, amplitudes: Mapping[str, float] | Sequence[float]) -> dict[str, float]:
        if not isinstance(amplitudes, Mapping):
            if not isinstance(amplitudes, Sequence) or len(amplitudes) != len(DOFS):
                raise InputError("must be six values or a mapping by name")
            amplitudes = dict(zip(DOFS, amplitudes, strict=True))
        for name in amplitudes:
            dof_index(name)
        return {name: amplitudes[name] for name in DOFS if amplitudes.get(name, 0.0) != 0.0}

    def _check(self) -> None:
        driven_count = len(self.amplitudes)
        if not driven_count:
            raise InputError("amplitudes: all are 0; at least one must not be")
        check_highest("amplitudes", *self.amplitudes.values())
        super()._check()
        if self.orders.size < driven_count:
            raise InputError(
                f"period: {self.period} s gives {self.orders.size} odd lines in {self.start} to "
                f"{self.stop} Hz; {driven_count} degrees of freedom need one each"
            )

    @property
    def lines(self) -> dict[str, NDArray[np.int64]]:
        """Numbers of the lines of each driven degree of freedom, multiples of 1/period."""
        driven_count = len(self.amplitudes)
        return {name: self.orders[i::driven_count] for i, name in enumerate(self.amplitudes)}

    def command(self, seed: int = 0) -> Command:
        """The periods and the tail."""
        seed = seed if self.seed is None else self.seed
        generator = np.random.default_rng(seed)
        histories = {
            name: self._sum(self.amplitudes[name], orders, generator)
            for name, orders in self.lines.items()
        }
        return Command(poses_along(histories), self, seed)


class AccelerationStep(OneAxis):
    """A demand whose acceleration steps to `acceleration`.

    It lasts for `hold` [s], then is reversed for the same time: the demand ends at rest,
    acceleration x hold^2 away.
    """

    kind: Literal["acceleration_step"]
    acceleration: float  #: In m/s^2 or rad/s^2.
    hold: Duration  #: Time of each half [s].
    at: Duration = 1.0  #: Start [s].

    @property
    def length(self) -> float:
        """Length of the table [s]."""
        return 2.0 * (self.at + self.hold)

    def _check(self) -> None:
        if round(self.hold * self.rate) < 2:
            raise InputError(f"hold: {self.hold} s must be two frames or more, {2 / self.rate} s")
        if not self.acceleration:
            raise InputError("acceleration: 0 is refused; allowed: any other number")
        check_highest("acceleration", self.acceleration * self.hold**2)

    def _history(self, seed: int) -> Array:
        rest = round(self.at * self.rate)
        time = np.arange(1, round(self.hold * self.rate) + 1) / self.rate
        speeding_up = 0.5 * self.acceleration * time**2
        end = self.acceleration * time[-1] ** 2
        slowing_down = np.append(end - speeding_up[-2::-1], end)
        return np.concatenate([np.zeros(rest), speeding_up, slowing_down, np.full(rest, end)])


def _check_rising(times: Array) -> None:
    if times.ndim != 1 or times.size < 2 or times[0] != 0.0 or not (np.diff(times) > 0.0).all():
        raise InputError(f"times: {times.tolist()} must be at least two numbers that rise from 0 s")


def waypoints(times: ArrayLike, values: ArrayLike, rate: int = RATE) -> Array:
    """A path at rest at each of its points, of least jerk between them, for `legs=True`.

    From a to b, with s from 0 to 1 over the stretch: a + (b - a) (10 s^3 - 15 s^4 + 6 s^5), whose
    peak speed is 1.875 times the mean (Flash and Hogan, 1985).

    `times` (m,) [s] rise from 0, `values` (m, n) are e.g. extensions [m], `rate` is that of the
    machine's control law [Hz]. The result is (N, n), one row a control frame.

    >>> cmf_mj.signals.waypoints([0.0, 2.0], [[0.0], [0.4]])[[1024, 2048, -1], 0].round(3)
    array([0.041, 0.2  , 0.4  ])
    """
    check_positive(rate=rate)
    point_times = np.asarray(times, dtype=float)
    _check_rising(point_times)
    points = shaped("values", values, point_times.size, None)
    time = np.arange(round(point_times[-1] * rate) + 1) / rate
    points_passed = np.searchsorted(point_times, time, side="right")
    stretch = np.clip(points_passed - 1, 0, point_times.size - 2)
    s = np.clip((time - point_times[stretch]) / np.diff(point_times)[stretch], 0.0, 1.0)[:, None]
    return points[stretch] + (points[stretch + 1] - points[stretch]) * quintic(s)


class Waypoints(Signal):
    """Poses at rest, joined by paths of least jerk."""

    kind: Literal["waypoints"]
    times: tuple[float, ...]  #: Rising from 0 [s].
    poses: tuple[tuple[float, float, float, float, float, float], ...]
    """Surge, sway, heave [m], roll, pitch, yaw [rad], one a time."""

    @property
    def length(self) -> float:
        """Length of the table [s]."""
        return max(self.times, default=0.0)

    def _check(self) -> None:
        if len(self.times) != len(self.poses) or len(self.times) < 2:
            counts = f"{len(self.times)} for {len(self.poses)} poses"
            raise InputError(f"times: {counts}; allowed: one a pose, at least 2")
        _check_rising(np.array(self.times))
        for pose in self.poses:
            check_highest("poses", *pose)

    def command(self, seed: int = 0) -> Command:
        """The path."""
        return Command(waypoints(self.times, self.poses, self.rate), self)


seven_sines = command_of(SevenSines)
stepped_sines = command_of(SteppedSines)
faded_sines = command_of(FadedSines)
orthogonal_multisines = command_of(OrthogonalMultisines)
acceleration_step = command_of(AccelerationStep)
