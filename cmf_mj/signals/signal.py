"""What a signal is: settings along degrees of freedom, and the command they make.

A signal of a settings file is a table with a `kind`. Its amplitude is a number in m or rad, or a
number and its unit, `[0.33, "in"]`.
"""

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from inspect import Parameter, Signature
from typing import Annotated, Any, Literal, NamedTuple, Self, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import ConfigDict, Field, PlainSerializer, PlainValidator, model_validator

from cmf_mj.core import units
from cmf_mj.core.arrays import frozen, real
from cmf_mj.core.errors import InputError
from cmf_mj.core.settings import Settings, validated
from cmf_mj.core.units import FASTEST_RATE, RATE, SLOWEST_RATE
from cmf_mj.machine.geometry import by_kind, dof_index

Array = NDArray[np.float64]

Motion = Callable[[NDArray[np.int64]], Array]
"""Control frames since the beginning (N,) to poses (N, 6) [m, rad], z down."""

Dof = Literal["surge", "sway", "heave", "roll", "pitch", "yaw"]  #: Name of a degree of freedom.
LONGEST = 3600.0  #: Longest table up to 2048 Hz [s]; an hour of poses takes 354 MB.
HIGHEST = 100.0  #: Largest demand [m or rad]: a hundred times the stroke of a leg.
Duration = Annotated[float, Field(gt=0.0, le=LONGEST)]  #: A time above 0 [s].
Wait = Annotated[float, Field(ge=0.0, le=LONGEST)]  #: A time of at least 0 [s].
Frequency = Annotated[float, Field(ge=1e-4, le=FASTEST_RATE / 2)]
"""At most half the control rate; the longest signal holds a third of the slowest cycle [Hz]."""
Rate = Annotated[int, Field(ge=SLOWEST_RATE, le=FASTEST_RATE)]  #: Control frames a second.
_FREQUENCIES = ("frequency", "frequencies", "start", "stop")
_LENGTH_UNITS, _ANGLE_UNITS = ("in", "m", "mm"), ("deg", "rad")


def check_positive(**values: float) -> None:
    """Refuse a value that is not a finite number above 0, by its name."""
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0.0):
            raise InputError(f"{name}: {value} must be a finite number greater than 0")


def check_length(seconds: float, rate: int = RATE) -> None:
    """Refuse a table that would be too long to hold."""
    longest = LONGEST * min(RATE / rate, 1.0)
    if not seconds <= longest:
        raise InputError(f"length: {seconds:g} s of the signal is refused: at most {longest:g} s")


def check_fade(fade: float, duration: float) -> None:
    """Refuse fades [s] at both ends that leave no full amplitude between them."""
    if 2.0 * fade > duration:
        raise InputError(f"fade: {fade} s must be at most half the duration of {duration} s")


def check_highest(field: str, *sizes: float) -> None:
    """Refuse demands [m or rad] that no machine follows."""
    for size in sizes:
        if not abs(size) <= HIGHEST:
            raise InputError(f"{field}: {size:g} m or rad is refused: at most {HIGHEST:g} in size")


def _number_with_unit(value: Any) -> float | tuple[float, str]:
    has_unit = isinstance(value, list | tuple) and len(value) == 2
    number, unit = value if has_unit else (value, "m")
    is_number = isinstance(number, int | float) and not isinstance(number, bool)
    if not is_number or not abs(number) < float("inf") or not isinstance(unit, str):
        raise InputError('must be a number in m or rad, or one and its unit, such as [2.0, "in"]')
    if unit not in _LENGTH_UNITS + _ANGLE_UNITS:
        raise InputError(f"unit {unit!r} is not one of {', '.join(_LENGTH_UNITS + _ANGLE_UNITS)}")
    highest = units.from_si(unit, HIGHEST)
    if not abs(number) <= highest:
        raise InputError(f"must be at most {highest:g} in size")
    return (float(number), unit) if has_unit else float(number)


Amplitude = Annotated[
    float | tuple[float, str], PlainValidator(_number_with_unit), PlainSerializer(lambda size: size)
]
"""A number in m or rad, or a number and its unit: in, m or mm along, deg or rad about an axis."""


def amplitude_in_si(dof: str, amplitude: float | tuple[float, str]) -> float:
    """An amplitude in m or rad; a length for an angle is refused, or an angle for a length."""
    if not isinstance(amplitude, tuple):
        return amplitude
    value, unit = amplitude
    allowed = by_kind(dof, _LENGTH_UNITS, _ANGLE_UNITS)
    if unit not in allowed:
        names = ", ".join(allowed)
        raise InputError(f"amplitude: unit {unit!r} is refused for {dof}; allowed: {names}")
    return units.to_si(unit, value)


class Dwell(NamedTuple):
    """Whole cycles of one frequency at full amplitude, from phase zero on, in whole frames."""

    start: int  #: Index of the first control frame.
    frames: int  #: Cycles / frequency, to the nearest frame.
    frequency: float  #: Frequency [Hz].
    amplitude: float  #: Amplitude [m or rad].
    cycles: int  #: Whole cycles.


class Signal(Settings):
    """A demand of platform pose, as its settings."""

    kind: str  #: Name of the kind of signal.
    rate: Rate = RATE  #: Of the machine's control law [Hz]: poses a second.

    @classmethod
    def kind_name(cls) -> str:
        """Its `kind` in files."""
        return str(get_args(cls.model_fields["kind"].annotation)[0])

    @model_validator(mode="after")
    def _checked(self) -> Self:
        for name in set(_FREQUENCIES) & set(type(self).model_fields):
            highest = float(np.max(getattr(self, name)))
            if highest > self.rate / 2:
                allowed = f"half the control rate, {self.rate / 2:g} Hz"
                raise InputError(f"{name}: {highest:g} Hz must be at most {allowed}")
        self._check()
        check_length(self.length, self.rate)
        return self

    @property
    def length(self) -> float:
        """Length of the table [s]; 0 where it follows from a file, or there is none."""
        return 0.0

    def _check(self) -> None:
        """Refuse settings that do not go together, by name."""

    def at_rate(self, rate: int) -> Self:
        """The same signal at another control rate [Hz]."""
        if rate == self.rate:
            return self
        return validated(type(self), self.model_dump() | {"rate": rate}, self.kind)

    @abstractmethod
    def command(self, seed: int = 0) -> "Command":
        """The signal at its rate; the seed is that of a signal with none in its settings."""

    def motion(self, seed: int = 0) -> Motion:
        """The signal as a function of the control frames since it began; holds its last pose."""
        return motion_of_table(self.command(seed).pose)

    def described(self) -> dict[str, Any]:
        """The settings in SI as plain JSON values, without the seed."""
        excluded = {"seed", "rate"} if self.rate == RATE else {"seed"}
        table = self.model_dump(mode="json", exclude=excluded, exclude_none=True)
        return table | self._sizes_in_si()

    def _sizes_in_si(self) -> dict[str, Any]:
        return {}

    @property
    def axis(self) -> str:
        """Degree of freedom that is moved; empty where it is not one."""
        return str(getattr(self, "dof", ""))

    @property
    def band(self) -> tuple[float, float] | None:
        """Lowest and highest frequency excited [Hz]; None where the signal has no band."""
        if not (hasattr(self, "start") and hasattr(self, "stop")):
            return None
        return float(self.start), float(self.stop)

    @property
    def lead(self) -> float:
        """Rest before the excitation [s]."""
        return float(getattr(self, "settle", 0.0))

    @property
    def dwells(self) -> tuple[Dwell, ...]:
        """Stretches of whole cycles at one frequency, in order."""
        return ()


class PoseTable(Signal):
    """A demand that is known only as a table of poses, with any other fields of its description."""

    model_config = ConfigDict(extra="allow")

    kind: str = "array"

    def at_rate(self, rate: int) -> Self:
        """Itself; another rate is refused, since the poses between frames are unknown."""
        if rate != self.rate:
            rates = f"{self.rate} a second; the machine takes {rate} a second"
            raise InputError(f"command: its poses are {rates}")
        return self

    def command(self, seed: int = 0) -> "Command":
        """Refused: the table is not part of the description."""
        raise InputError(f"signal: {self.kind!r} cannot be made again from its description")


class OneAxis(Signal):
    """A signal along one degree of freedom."""

    dof: Dof  #: Degree of freedom.

    @abstractmethod
    def _history(self, seed: int) -> Array:
        """Displacement at each frame [m or rad], (N,)."""

    def command(self, seed: int = 0) -> "Command":
        """The signal as a table of poses."""
        own_seed = getattr(self, "seed", None)
        seed = seed if own_seed is None else own_seed
        poses = poses_along({self.dof: self._history(seed)})
        return Command(poses, self, seed if hasattr(self, "seed") else None)


class SingleSignal(OneAxis):
    """A signal of one amplitude along one degree of freedom."""

    amplitude: Amplitude  #: Size [m or rad], or size and unit, such as `[2.0, "in"]`.

    @model_validator(mode="after")
    def _check_unit(self) -> Self:
        amplitude_in_si(self.dof, self.amplitude)
        return self

    @property
    def size(self) -> float:
        """Amplitude [m or rad]."""
        return amplitude_in_si(self.dof, self.amplitude)

    def _sizes_in_si(self) -> dict[str, Any]:
        return {"amplitude": self.size}


@dataclass(frozen=True, eq=False)
class Command:
    """A platform demand, and the signal that made it; equal where signal, seed and poses are.

    >>> command = cmf_mj.signals.sine("heave", 0.1, frequency=0.5, cycles=1)
    >>> command.pose.shape, command.duration
    ((4096, 6), 2.0)
    """

    pose: Array  #: Poses [m, rad], (N, 6), one a control frame.
    signal: Signal = PoseTable()  #: The signal that made it; kept in the record.
    seed: int | None = None  #: Seed of the random phases, where there are any.

    def __post_init__(self) -> None:
        """Check the shape and freeze."""
        pose = real("command", self.pose)
        if pose.ndim != 2 or pose.shape[1] != 6 or pose.shape[0] < 1:
            raise InputError(f"command: shape is {pose.shape}; allowed: (N, 6) with N >= 1")
        object.__setattr__(self, "pose", frozen(pose))

    def __eq__(self, other: object) -> bool:
        """Whether signal, seed and poses are the same, to the bit."""
        if not isinstance(other, Command):
            return NotImplemented
        same = (self.signal, self.seed) == (other.signal, other.seed)
        return same and self.pose.tobytes() == other.pose.tobytes()

    def __hash__(self) -> int:
        """Of the poses."""
        return hash(self.pose.tobytes())

    @staticmethod
    def from_pose(pose: ArrayLike, rate: int = RATE) -> "Command":
        """A command from an array `pose` (N, 6) at a control rate [Hz]."""
        return Command(real("command", pose), PoseTable(rate=rate))

    @property
    def rate(self) -> int:
        """Poses a second [Hz]."""
        return self.signal.rate

    def at_rate(self, rate: int) -> "Command":
        """The same signal at another control rate [Hz]; an array of poses has its own alone."""
        if rate == self.rate:
            return self
        return self.signal.at_rate(rate).command(self.seed or 0)

    @property
    def description(self) -> dict[str, Any]:
        """The signal's settings in SI as plain JSON values; with the seed they make it again."""
        return self.signal.described()

    @property
    def duration(self) -> float:
        """Length [s]."""
        return self.pose.shape[0] / self.rate


def as_command(command: Command | ArrayLike, rate: int) -> Command:
    """A command, or an array of poses (N, 6), at a control rate [Hz]."""
    if not isinstance(command, Command):
        command = Command.from_pose(command, rate)
    return command.at_rate(rate)


def motion_of_table(poses: Array) -> Motion:
    """The motion of a table (N, 6), which holds its first pose before and its last one after."""
    last = poses.shape[0] - 1
    return lambda frames: poses[np.clip(frames, 0, last)]


def poses_along(histories: Mapping[str, Array]) -> Array:
    """Histories (N,) by degree of freedom as poses (N, 6), read-only."""
    pose = np.zeros((next(iter(histories.values())).size, 6))
    for name, history in histories.items():
        pose[:, dof_index(name)] = history
    pose.setflags(write=False)
    return pose


def command_of(signal: type[Signal]) -> Callable[..., Command]:
    """The function that makes a signal's command; settings with a default go by name only."""
    kind = signal.kind_name()
    fields = {name: field for name, field in signal.model_fields.items() if name != "kind"}
    parameters = [
        Parameter(name, Parameter.POSITIONAL_OR_KEYWORD)
        if field.is_required()
        else Parameter(name, Parameter.KEYWORD_ONLY, default=field.default)
        for name, field in fields.items()
    ]
    parameters.sort(key=lambda parameter: parameter.kind)
    signature = Signature(parameters, return_annotation=Command)

    def make(*args: object, **options: object) -> Command:
        settings = signature.bind(*args, **options).arguments
        return validated(signal, {"kind": kind} | as_plain(settings), kind).command()

    make.__module__, make.__name__, make.__qualname__ = signal.__module__, kind, kind
    make.__doc__ = signal.__doc__
    make.__signature__ = signature  # type: ignore[attr-defined]
    return make


def as_plain(value: Any) -> Any:
    """A value with arrays and lists as tuples, and numbers of NumPy as those of Python."""
    if isinstance(value, Mapping):
        return {str(name): as_plain(entry) for name, entry in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return as_plain(value.tolist())
    if isinstance(value, Sequence) and not isinstance(value, str):
        return tuple(as_plain(entry) for entry in value)
    return value
