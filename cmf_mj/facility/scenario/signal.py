"""What a scenario demands of the platform: each excitation as a table of its settings.

A signal becomes a `Motion`: the pose (6,) of any number of control frames since the signal began.
Those of `signals` and `excitations` are tables that hold their last pose; a sine without `cycles`
goes on for ever. Several signals of a scenario are added.
"""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, model_validator
from scipy.interpolate import BPoly

from cmf_mj import signals
from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.core.rates import RATE
from cmf_mj.core.settings import Settings
from cmf_mj.facility.host.files import read_stream
from cmf_mj.machine.dof import by_kind
from cmf_mj.machine.kinematics import DOFS
from cmf_mj.record.record import Record
from cmf_mj.signals import composite as excitations
from cmf_mj.signals.single import Command

Motion = Callable[[NDArray[np.int64]], NDArray[np.float64]]
"""Control frames since the beginning (N,) to poses (N, 6) [m, rad], z down."""

Dof = Literal["surge", "sway", "heave", "roll", "pitch", "yaw"]

_UNITS = {"in": "length", "m": "length", "mm": "length", "deg": "angle", "rad": "angle"}


def _known_unit(amplitude: tuple[float, str]) -> tuple[float, str]:
    if amplitude[1] not in _UNITS:
        raise InputError(f"unit {amplitude[1]!r} is not one of {', '.join(_UNITS)}")
    return amplitude


Amplitude = Annotated[tuple[float, str], AfterValidator(_known_unit)]
"""A number and its unit: in, m or mm along, deg or rad about an axis."""


def in_si(dof: str, amplitude: tuple[float, str]) -> float:
    """An amplitude in m or rad.

    Raises:
        InputError: a length for an angle, or an angle for a length.
    """
    value, unit = amplitude
    wanted = by_kind(dof, "length", "angle")
    if _UNITS[unit] != wanted:
        allowed = ", ".join(name for name, kind in _UNITS.items() if kind == wanted)
        raise InputError(f"amplitude: unit {unit!r} is refused for {dof}; allowed: {allowed}")
    return units.to_si(unit, value)


class _Signal(Settings):
    """What all signals share."""

    @abstractmethod
    def command(self, seed: int) -> Command:
        """The signal as a table at 2048 Hz.

        Args:
            seed: of the scenario, where the signal has none of its own.
        """

    def motion(self, seed: int) -> Motion:
        """The signal as a function of the control frames since it began."""
        return tabulated(self.command(seed).pose)

    def description(self, seed: int) -> dict[str, Any]:
        """What a record keeps of it, as `Command` has it."""
        return dict(self.command(seed).description)


class _Single(_Signal):
    """A signal along one degree of freedom."""

    dof: Dof  #: Degree of freedom.
    amplitude: Amplitude  #: Size and unit, such as `[2.0, "in"]`.

    @model_validator(mode="after")
    def _fitting(self) -> Self:
        in_si(self.dof, self.amplitude)
        return self

    @property
    def size(self) -> float:
        """Amplitude [m or rad]."""
        return in_si(self.dof, self.amplitude)

    def _options(self, *left_out: str) -> dict[str, Any]:
        names = type(self).model_fields.keys() - {"kind", "dof", "amplitude", "seed", *left_out}
        return {name: getattr(self, name) for name in names}


class _Random(_Single):
    """A signal with random phases."""

    seed: int | None = None  #: Of the phases; default that of the scenario.


class Step(_Single):
    """A step, held for ever."""

    kind: Literal["step"]
    at: float = 1.0  #: Time [s].

    def command(self, seed: int) -> Command:
        """The step."""
        return signals.step(self.dof, self.size, at=self.at, duration=self.at + 2.0 / RATE)


class Pulse(_Single):
    """A rectangular pulse."""

    kind: Literal["pulse"]
    at: float = 1.0  #: Start [s].
    width: float = 1.0  #: Time at the height [s].

    def command(self, seed: int) -> Command:
        """The pulse."""
        length = self.at + self.width + 3.0 / RATE
        return signals.pulse(self.dof, self.size, duration=length, **self._options())


class Sine(_Single):
    """A sine, faded in by a raised cosine; without `cycles` it goes on for ever."""

    kind: Literal["sine"]
    frequency: Annotated[float, Field(gt=0.0, le=RATE / 2)]  #: Frequency [Hz].
    cycles: Annotated[float, Field(gt=0.0)] | None = None  #: Length; it is faded out at its end.
    fade: Annotated[float, Field(gt=0.0)] = 1.0  #: Of the ends [s].

    def command(self, seed: int) -> Command:
        """The sine of so many cycles."""
        return signals.sine(self.dof, self.size, **self._options())

    def description(self, seed: int) -> dict[str, Any]:
        """That of `signals.sine`, without `cycles` where it is endless."""
        if self.cycles is not None:
            return super().description(seed)
        described = {"kind": self.kind, "dof": self.dof, "amplitude": self.size}
        return described | {"frequency": self.frequency, "fade": self.fade}

    def motion(self, seed: int) -> Motion:
        """The sine, endless without `cycles`."""
        if self.cycles is not None:
            return super().motion(seed)
        index, size = DOFS.index(self.dof), self.size

        def endless(frames: NDArray[np.int64]) -> NDArray[np.float64]:
            time = np.maximum(frames, 0) / RATE
            grown = 0.5 * (1.0 - np.cos(np.pi * np.minimum(time / self.fade, 1.0)))
            poses = np.zeros((frames.size, 6))
            poses[:, index] = size * grown * np.sin(2.0 * np.pi * self.frequency * time)
            return poses

        return endless


class Chirp(_Single):
    """The report's chirp: frequency rising linearly (section 2.5)."""

    kind: Literal["chirp"]
    start: float = 0.01  #: First frequency [Hz].
    stop: float = 10.0  #: Last frequency [Hz].
    duration: float = 100.0  #: Length of the sweep [s].
    settle: float = 2.0  #: Rest before and after [s].
    fade: float = 0.0  #: Of the ends [s].

    def command(self, seed: int) -> Command:
        """The sweep."""
        return signals.chirp(self.dof, self.size, **self._options())


class Noise(_Random):
    """Gaussian noise within a band."""

    kind: Literal["noise"]
    start: float = 0.1  #: Lower edge [Hz].
    stop: float = 10.0  #: Upper edge [Hz].
    duration: float = 100.0  #: Length [s].
    settle: float = 2.0  #: Rest before and after [s].
    fade: float = 2.0  #: Of the ends [s].
    scale: Literal["peak", "rms"] = "peak"  #: What the amplitude is.

    def command(self, seed: int) -> Command:
        """The noise."""
        own = seed if self.seed is None else self.seed
        return signals.noise(self.dof, self.size, seed=own, **self._options())


class Multisine(_Random):
    """Odd random-phase multisine of whole periods."""

    kind: Literal["multisine"]
    start: float = 0.1  #: Lowest line [Hz].
    stop: float = 10.0  #: Highest line [Hz].
    period: float = 20.0  #: Length of a period [s].
    periods: int = 3  #: Periods in all.
    spectrum: Literal["flat", "acceleration"] = "flat"
    """Of equal displacement, or of equal acceleration above the corner."""
    corner: float = 1.0  #: Frequency above which displacement falls as 1/f^2 [Hz].
    fade: float = 1.0  #: Of the ends [s].

    def command(self, seed: int) -> Command:
        """The multisine."""
        own = seed if self.seed is None else self.seed
        return signals.multisine(self.dof, self.size, seed=own, **self._options())


class SevenSines(_Single):
    """One round of the facility's seven-channel generator (Table 2-3)."""

    kind: Literal["seven_sines"]
    number: Annotated[int, Field(ge=1, le=5)]  #: Round.
    cycles: int = 5  #: Whole cycles of a dwell.
    fade: float = 1.0  #: Before and after each dwell [s].
    settle: float = 5.5  #: Rest between the sines [s].

    def command(self, seed: int) -> Command:
        """The round."""
        return excitations.seven_sines(self.dof, self.size, **self._options())


class SteppedSines(_Signal):
    """Each frequency at each amplitude."""

    kind: Literal["stepped_sines"]
    dof: Dof  #: Degree of freedom.
    frequencies: tuple[float, ...]  #: One after the other [Hz].
    amplitudes: tuple[Amplitude, ...]  #: At each frequency, one after the other.
    cycles: int = 10  #: Whole cycles of a dwell.
    transient: float = 2.0  #: At full amplitude before each dwell [s].
    fade: float = 1.0  #: Before the transient and after the dwell [s].
    settle: float = 1.0  #: Rest between the sines [s].

    @model_validator(mode="after")
    def _fitting(self) -> Self:
        for amplitude in self.amplitudes:
            in_si(self.dof, amplitude)
        return self

    def command(self, seed: int) -> Command:
        """The dwells."""
        return excitations.stepped_sines(
            self.dof,
            self.frequencies,
            [in_si(self.dof, amplitude) for amplitude in self.amplitudes],
            cycles=self.cycles,
            transient=self.transient,
            fade=self.fade,
            settle=self.settle,
        )


class AccelerationStep(_Signal):
    """Constant acceleration, then the opposite: ends at rest."""

    kind: Literal["acceleration_step"]
    dof: Dof  #: Degree of freedom.
    acceleration: float  #: In m/s^2 or rad/s^2.
    hold: float  #: Time of each half [s].
    at: float = 1.0  #: Start [s].

    def command(self, seed: int) -> Command:
        """The path."""
        return excitations.acceleration_step(
            self.dof, self.acceleration, hold=self.hold, at=self.at
        )


class Waypoints(_Signal):
    """Poses at rest, joined by paths of least jerk: six columns a point, in m and rad."""

    kind: Literal["waypoints"]
    times: tuple[float, ...]  #: Rising from 0 [s].
    poses: tuple[tuple[float, float, float, float, float, float], ...]
    """Surge, sway, heave [m], roll, pitch, yaw [rad], one a time."""

    def command(self, seed: int) -> Command:
        """The path."""
        return Command(excitations.waypoints(self.times, self.poses), {"kind": "waypoints"})


class HostFile(_Signal):
    """A host's frames from a CSV or Parquet file, joined by quintics."""

    kind: Literal["host"]
    file: str  #: CSV or Parquet with time and six poses, SI.
    derivatives: Literal["spline", "zero"] = "spline"
    """How velocities are made where the file has none."""

    def command(self, seed: int) -> Command:
        """Poses at 2048 Hz from the first frame's time to the last one's."""
        stream = read_stream(self.file, derivatives=self.derivatives)
        if stream.time.size < 2:
            raise InputError(f"{self.file}: {stream.time.size} frames; at least 2 are needed")
        since = stream.time - stream.time[0]
        time = np.arange(int(np.floor(since[-1] * RATE + 1e-9)) + 1) / RATE
        return Command(BPoly.from_derivatives(since, stream.values)(time), {"kind": "host"})


class Recorded(_Signal):
    """The demand of a record of an earlier run."""

    kind: Literal["recorded"]
    file: str  #: Parquet record with a `demand_pose` at 2048 Hz.

    def command(self, seed: int) -> Command:
        """The recorded demand."""
        record = Record.load(self.file)
        if abs(record.rate - RATE) > 1e-9:
            raise InputError(f"{self.file}: sample_rate: {record.rate:g} Hz; allowed: {RATE} Hz")
        return Command(record["demand_pose"], {"kind": "recorded"})


Signal = Annotated[
    Step
    | Pulse
    | Sine
    | Chirp
    | Noise
    | Multisine
    | SevenSines
    | SteppedSines
    | AccelerationStep
    | Waypoints
    | HostFile
    | Recorded,
    Field(discriminator="kind"),
]
"""Any of them, told apart by `kind`."""


def tabulated(poses: NDArray[np.float64]) -> Motion:
    """A table (N, 6) that holds its first pose before and its last one after."""
    last = poses.shape[0] - 1
    return lambda frames: poses[np.clip(frames, 0, last)]


def added(parts: Sequence[_Signal], seed: int) -> Motion:
    """The sum of signals; at rest at neutral without any."""
    motions = [part.motion(seed) for part in parts]

    def total(frames: NDArray[np.int64]) -> NDArray[np.float64]:
        poses = np.zeros((frames.size, 6))
        for motion in motions:
            poses += motion(frames)
        return poses

    return total
