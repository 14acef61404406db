"""Recordings of the Exudyn machine in closed loop with the project's controller.

Sensors, electronics, law and reference are the loop's own blocks, frame by frame; the machine and
its hydraulics are not. So a recording differs from one of `Run.record` by what the engines differ.
"""

from typing import Any

import numpy as np

from cmf_mj.control import dcl
from cmf_mj.control.feedback import LegFeedback
from cmf_mj.core.compiled import compiled
from cmf_mj.electronics.chain import deliver, measure
from cmf_mj.facility.front import follow, watches_switches
from cmf_mj.facility.run import Run
from cmf_mj.record.record import Record
from cmf_mj.studies.fit.plan import demand
from crosscheck.machine import Machine, State

_SIGNALS = {"signal", "change", "duration"}

KEPT = {"leg_reference": "m", "leg_position": "m", "cap_pressure": "Pa", "rod_pressure": "Pa"}
KEPT |= {"valve_command": "1"}


@compiled
def decide(controller, faults, frame, truth, feedback, reference, command):  # type: ignore[no-untyped-def]
    """The valve commands (n,) of a frame at the true state, and what the law reads of it."""
    compensated = controller.dcl.feedback.gravity_compensation
    measure(controller.electronics, faults, frame, truth, compensated, feedback)
    follow(controller.source, frame, feedback.position, 0, False, reference)
    dcl.step(controller.dcl, controller.state, reference, feedback)
    for leg in range(command.shape[0]):
        command[leg] = controller.dcl.workspace.command[leg]
    deliver(controller.electronics, watches_switches(controller.source), truth.position, command)


def recorded(run: Run, machine: Machine) -> Record:
    """Let an Exudyn machine do a run; channels as `KEPT`, kept every `record_every` frames.

    Of a run of signals the poses are made first: what changes on its way is a session's.
    """
    if run.source is None:
        given = {name: getattr(run, name) for name in run.model_fields_set - _SIGNALS}
        run = Run(**given | {"source": demand(run)})
    session = run.session()
    session.plant.check()
    controller, memory = session.controller, session.memory
    frames, legs = session.frames, session.plant.legs
    commands = np.zeros((frames + controller.delay, legs))
    kept: dict[str, list[Any]] = {name: [] for name in KEPT}

    def control(frame: int, state: State) -> Any:
        truth = LegFeedback(*state[:3], *state.pressure)
        read, command = memory.feedback, commands[frame + controller.delay]
        faults = session.dynamics.faults
        decide(controller, faults, frame, truth, read, memory.reference, command)
        if frame % session.record_every == 0:
            limited = controller.dcl.workspace.limited_demand
            row = limited, read.position, *read[3:5], commands[frame]
            for name, value in zip(KEPT, row, strict=True):
                kept[name].append(value.copy())
        return commands[frame]

    machine.control(control, frames, session.plant.machine.frame)
    time = np.arange(0, frames, session.record_every) / session.rate
    channels = {name: np.array(rows) for name, rows in kept.items()}
    described = session.describe()
    return Record(time, channels, KEPT, {key: described[key] for key in ("sample_rate", "law")})
