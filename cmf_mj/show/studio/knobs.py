"""The numbers of a law as knobs of the page, taken from its data."""

from collections.abc import Iterator, Mapping
from functools import reduce
from typing import Any, NamedTuple, cast

from cmf_mj.control.law import Law
from cmf_mj.facility.scenario.settings import overlaid_law

_LETTERS = {"input_gain": "B", "direct_gain": "D", "state_gain": "A", "output_gain": "C"}

_UNITS = {
    "reference": "%/in",
    "cap_pressure": "%/MPa",
    "rod_pressure": "%/MPa",
    "position": "%/in",
    "velocity": "%/(in/s)",
    "position_error_rate": "%/(in/s)",
    "velocity_error": "%/(in/s)",
    "error_integral": "%/(in s)",
    "acceleration": "%/(in/s^2)",
    "force": "%/lbf",
}

_SCALES = {"cap_pressure": 1e-6, "rod_pressure": 1e-6}
"""Size of a slider's unit in that of the law's data, where it is another one."""


class Knob(NamedTuple):
    """One number of a law that can be turned."""

    path: tuple[str, ...]  #: Where it is in the law.
    value: float  #: As the law has it, in the slider's unit.
    low: float  #: Least value of its slider.
    high: float  #: Largest value of its slider.
    scale: float  #: Size of the slider's unit in that of the law's data.

    @property
    def label(self) -> str:
        """Short name: the report's letters for the gain tables."""
        table, *rest = self.path
        return " ".join([_LETTERS.get(table, "model"), *rest]).replace("_", " ")

    @property
    def hint(self) -> str:
        """Full name and unit."""
        unit = _UNITS.get(self.path[-1], "") if self.path[0].endswith("t_gain") else ""
        return f"{'.'.join(self.path)} {unit}".strip()

    def table(self, value: float) -> dict[str, Any]:
        """A value of the slider as a table of `gains`."""
        return _nested(self.path, value * self.scale)


def _nested(path: tuple[str, ...], value: float) -> dict[str, Any]:
    return reduce(lambda inner, name: {name: inner}, reversed(path), cast("Any", value))


def knobs(law: Law) -> tuple[Knob, ...]:
    """One knob for each number of a law that is not zero."""
    data = law.model_dump(include={*_LETTERS, "reference_model"}, exclude_none=True)
    return tuple(_knob(law, path, value) for path, value in _numbers(data) if value != 0.0)


def _numbers(data: Mapping[str, Any], above: tuple[str, ...] = ()) -> Iterator[tuple[Any, float]]:
    for name, value in data.items():
        if isinstance(value, Mapping):
            yield from _numbers(value, (*above, name))
        elif isinstance(value, int | float):
            yield (*above, name), float(value)


def _knob(law: Law, path: tuple[str, ...], value: float) -> Knob:
    """A knob that reaches as far towards zero and the double as the law allows."""

    def allowed(end: float) -> bool:
        try:
            overlaid_law(law, _nested(path, end))
        except ValueError:
            return False
        return True

    scale = _SCALES.get(path[-1], 1.0)
    near = next(filter(allowed, (0.0, 0.02 * value, 1.0, value)))
    far = next(filter(allowed, (2.0 * value, 1.0, 0.99, value)))
    low, high = sorted((near / scale, far / scale))
    return Knob(path, value / scale, low, high, scale)
