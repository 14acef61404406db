"""What the controls of the page mean: a scenario's tables, a law's numbers, marks of events."""

import math
from collections.abc import Iterator, Mapping
from functools import reduce
from typing import Any, NamedTuple, cast, get_args

import viser
from viser import _messages as messages

from cmf_mj.control.law import Law
from cmf_mj.control.protection import Fault
from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.core.settings import merged
from cmf_mj.facility.run import Run
from cmf_mj.facility.scenario import scenario_of
from cmf_mj.facility.settings import Change, Push, overlaid_law
from cmf_mj.facility.signal import Signal
from cmf_mj.machine.geometry import DOFS, dof_unit
from cmf_mj.machine.models import CMF
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.signals.signal import SingleSignal


class Mark(NamedTuple):
    """Something that happened."""

    time: float  #: When [s].
    text: str  #: What.
    harm: bool  #: Whether something failed or tripped.


def marks_of(scenario: Run, fault: Fault | None) -> tuple[Mark, ...]:
    """All that has happened to a run that did this scenario, in order of time."""
    rate = scenario.rate
    marks = [Mark(event.at, words(event.kind, event.leg), True) for event in scenario.events]
    for change in scenario.change:
        time = change.when(rate) / rate
        marks += [Mark(time, words(one.kind, one.leg), True) for one in change.failure]
        if texts := _texts(change):
            marks.append(Mark(time, ", ".join(texts), False))
    if fault is not None:
        text = f"tripped: {words(fault.name, fault.leg)}"
        marks.append(Mark(fault.frame / rate, text, True))
    return tuple(sorted(marks))


def words(name: str, leg: int | None) -> str:
    """What failed or was detected, and of which leg."""
    return name.replace("_", " ") + ("" if leg is None else f" of leg {leg}")


def _texts(change: Change) -> list[str]:
    """What a change changes besides failures."""
    texts = [] if change.law is None else [f"law {change.law}"]
    texts += ["gain"] if change.gains else []
    texts += [] if change.signal is None else ["signal"]
    if (push := change.push) is not None:
        texts.append("push" if any((*push.force, *push.torque)) else "push ends")
    return texts + ([] if change.request is None else [f"request {change.request}"])


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


SIGNALS: dict[str, type[SingleSignal]] = {
    get_args(signal.model_fields["kind"].annotation)[0]: signal
    for signal in get_args(get_args(Signal)[0])
    if issubclass(signal, SingleSignal)
}
"""Signals the page offers by kind; a scenario file may have any other."""

GENTLE = {"frequency": 0.5, "start": 0.05, "stop": 0.5, "number": 1}
"""Settings the page begins with where the signals have other defaults [Hz], or none."""

DIRECTIONS = {
    "forward": (1.0, 0.0, 0.0),
    "backward": (-1.0, 0.0, 0.0),
    "left": (0.0, 1.0, 0.0),
    "right": (0.0, -1.0, 0.0),
    "up": (0.0, 0.0, 1.0),
    "down": (0.0, 0.0, -1.0),
}
"""Directions of the push in the model's axes."""

LARGEST_PUSH = 100.0
"""Largest push of the page [kN]: three quarters of the weight with the lightest cab."""

RECORD_EVERY = 16
"""Control frames between rows of a session's record: 128 Hz, the facility's recorder."""


def largest_amplitude(dof: str, machine: str = CMF) -> float:
    """Operational excursion of a degree of freedom that both ends have, in in or deg."""
    low, high = load_motion_limits(None, machine).operational[DOFS.index(dof)]
    return round(units.from_si(dof_unit(dof), float(min(-low, high))), 1)


def signal_settings(kind: str) -> dict[str, Any]:
    """Settings of a kind of signal besides degree of freedom and amplitude, as the page begins.

    Those that may be left out stay so.
    """
    fields = SIGNALS[kind].model_fields.items() if kind in SIGNALS else ()
    begun = {name: GENTLE.get(name, field.default) for name, field in fields}
    basic = ("kind", "rate", "dof", "amplitude")
    return {name: value for name, value in begun.items() if name not in basic and value is not None}


def signal_table(kind: str, dof: str, amplitude: float, **settings: Any) -> list[dict[str, Any]]:
    """The signals of a scenario, none for `rest`; amplitude in in or deg."""
    if kind == "rest":
        return []
    basic = {"kind": kind, "dof": dof, "amplitude": [amplitude, dof_unit(dof)]}
    return [basic | signal_settings(kind) | settings]


def push_of(direction: str, size: float) -> Push:
    """A push of the platform in one of `DIRECTIONS`; size in kN."""
    newtons = units.to_si("kN", size)
    forward, left, up = (newtons * share for share in DIRECTIONS[direction])
    return Push(force=(forward, left, up))


def first_scenario() -> Run:
    """What a tab begins with: a gentle heave of the lightest cab with the law that flew."""
    table = {
        "title": "studio session",
        "signal": signal_table("sine", "heave", 2.0),
        "duration": "open",
        "record_every": RECORD_EVERY,
    }
    return scenario_of(table, "studio")


def settled(scenario: Run) -> Run:
    """The same machine with the law and the signal in force at the end, from rest.

    Failures, pushes and requests are left out: what begins again is whole.
    """
    law, gains, signal = scenario.law, scenario.gains, scenario.signal
    for change in scenario.change:
        if change.law is not None:
            law, gains = change.law, {}
        gains = merged(gains, change.gains)
        signal = signal if change.signal is None else change.signal
    begun = {"law": law, "gains": gains, "signal": signal, "duration": "open"}
    return scenario.model_copy(update=begun | {"events": (), "change": ()})


def check_commands(client: viser.ClientHandle) -> None:
    """Let the controls of a tab take only what `check_value` lets pass, and show the rest."""
    gui, connection = client.gui, client._websock_connection

    async def update(client_id: Any, message: messages.GuiUpdateMessage) -> None:
        try:
            check_value(gui._gui_input_handle_from_uuid.get(message.uuid), message.updates)
        except InputError as error:
            client.add_notification("Refused", str(error), color="red", auto_close_seconds=30.0)
        else:
            await gui._handle_gui_updates(client_id, message)

    connection.unregister_handler(messages.GuiUpdateMessage)
    connection.register_handler(messages.GuiUpdateMessage, update)


def check_value(handle: Any, updates: dict[str, Any]) -> None:
    """Refuse what a control cannot be set to by hand."""
    if handle is None:
        return
    label = handle.label or "button"
    if set(updates) != {"value"}:
        raise InputError(f"{label}: {sorted(updates)} is refused; allowed: value")
    value = updates["value"]
    if (options := getattr(handle, "options", None)) is not None:
        fine, allowed = value in options, ", ".join(options)
    elif isinstance(handle.value, bool):
        fine, allowed = isinstance(value, bool), "true, false"
    elif isinstance(handle.value, int | float):
        low, high = (getattr(handle, end, None) for end in ("min", "max"))
        fine = isinstance(value, int | float) and not isinstance(value, bool)
        fine = fine and math.isfinite(value) and (low is None or low <= value <= high)
        allowed = "a number" if low is None else f"{low:g} to {high:g}"
    else:
        fine, allowed = False, "nothing"
    if not fine:
        raise InputError(f"{label}: {value!r} is refused; allowed: {allowed}")
