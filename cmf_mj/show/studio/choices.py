"""What the controls of the page mean: plain functions to tables of a scenario."""

from typing import Any

from cmf_mj.core import units
from cmf_mj.core.settings import merged
from cmf_mj.facility.scenario.settings import Push, Scenario, scenario_of
from cmf_mj.machine.dof import dof_unit
from cmf_mj.machine.kinematics import DOFS
from cmf_mj.machine.motion_limits import load_motion_limits

SIGNALS = ("rest", "sine", "step", "pulse", "chirp", "noise", "multisine")
"""Signals the page offers; a scenario file may have any other."""

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

LOWEST = 0.05
"""Lowest frequency of chirp, noise and multisine [Hz]."""

_TURNS = {"frequency": ("sine",), "stop": ("chirp", "noise", "multisine")}


def largest_amplitude(dof: str) -> float:
    """Operational excursion of a degree of freedom that both ends have, in in or deg."""
    low, high = load_motion_limits().operational[DOFS.index(dof)]
    return round(units.from_si(dof_unit(dof), float(min(-low, high))), 1)


def signal_table(kind: str, dof: str, amplitude: float, frequency: float) -> list[dict[str, Any]]:
    """The signals of a scenario the controls ask for; amplitude in in or deg.

    The frequency [Hz] is that of a sine, or the upper edge of a band.
    """
    if kind == "rest":
        return []
    table: dict[str, Any] = {"kind": kind, "dof": dof, "amplitude": [amplitude, dof_unit(dof)]}
    for name, kinds in _TURNS.items():
        if kind in kinds:
            table[name] = frequency
    if kind in _TURNS["stop"]:
        table["start"] = min(LOWEST, 0.5 * frequency)
    return [table]


def push_of(direction: str, size: float) -> Push:
    """A push of the platform in one of `DIRECTIONS`; size in kN."""
    newtons = units.to_si("kN", size)
    forward, left, up = (newtons * share for share in DIRECTIONS[direction])
    return Push(force=(forward, left, up))


def first_scenario() -> Scenario:
    """What a tab begins with: a gentle heave of the lightest cab with the law that flew."""
    return scenario_of(
        {
            "title": "studio session",
            "signal": signal_table("sine", "heave", 2.0, 0.5),
            "duration": "open",
            "record_every": RECORD_EVERY,
        },
        "studio",
    )


def settled(scenario: Scenario) -> Scenario:
    """The same machine with the law and the signal in force at the end, from rest.

    Failures, pushes and requests are left out: what begins anew is whole.
    """
    law, gains, signal = scenario.law, scenario.gains, scenario.signal
    for change in scenario.change:
        if change.law is not None:
            law, gains = change.law, {}
        gains = merged(gains, change.gains)
        signal = signal if change.signal is None else change.signal
    return scenario.model_copy(
        update={
            "law": law,
            "gains": gains,
            "signal": signal,
            "event": (),
            "change": (),
            "duration": "open",
        }
    )
