"""What may differ between two runs of the same plant and law."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypedDict

from numpy.typing import ArrayLike

from cmf_mj.control.protection import ProtectionSettings
from cmf_mj.core.arrays import whole
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.rates import MOST_FRAMES, RATE
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.plant.events import Event
from cmf_mj.plant.plant import Plant


class RunOptions(TypedDict, total=False):
    """Options of every run, as in `Options`."""

    start: ArrayLike | None
    events: Sequence[Event]
    record_every: int
    command_delay: int


class Options(NamedTuple):
    """What may differ between two runs of the same plant and law."""

    start: ArrayLike | None = None
    """Configuration to start from, as `plant.place` takes it; default neutral."""
    events: Sequence[Event] = ()  #: Failures on the time line.
    record_every: int = 1  #: Keep one frame in this many.
    command_delay: int = 1  #: Frames from a DCL frame to its command at the valves.
    protection: ProtectionSettings | None = None  #: Conditions that make an emergency stop.
    electronics: ElectronicsSettings | None = None
    """Sensors, converters, servo electronics; default ideal."""
    frames: int | None = None  #: Control frames of the run; default the rows of the table.
    window: int | None = None
    """Control frames whose `rows` are kept, the latest; default all, as `history`."""

    def checked(self) -> "Options":
        """The same with whole numbers of Python, which alone share a compiled loop."""
        numbers: dict[str, Any] = {}
        for field, least, most in (
            ("record_every", 1, MOST_FRAMES),
            ("window", 1, MOST_FRAMES),
            ("frames", 1, MOST_FRAMES),
            ("command_delay", 0, RATE),
        ):
            value = getattr(self, field)
            numbers[field] = None if value is None else whole(field, value, least, most)
        return self._replace(**numbers)


def chosen(plant: object, options: Mapping[str, Any], **others: Any) -> Options:
    """The options of a run on a plant; what is no plant, and no option, is refused by name."""
    if not isinstance(plant, Plant):
        raise InputError(f"plant: {plant!r} is refused; allowed: a Plant, such as Hexapod('gfd')")
    for name in options:
        check_name("option", name, RunOptions.__annotations__)
    return Options(**options, **others)
