"""What has happened to a run, as marks in its plots and on its lamp."""

from typing import NamedTuple

from cmf_mj.control.protection import Fault
from cmf_mj.facility.scenario.settings import Change, Scenario


class Mark(NamedTuple):
    """Something that happened."""

    time: float  #: When [s].
    text: str  #: What.
    harm: bool  #: Whether something failed or tripped.


def marks_of(scenario: Scenario, fault: Fault | None) -> tuple[Mark, ...]:
    """All that has happened to a run that did this scenario, in order of time."""
    rate = scenario.rate
    marks = [Mark(event.at, words(event.kind, event.leg), True) for event in scenario.event]
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
