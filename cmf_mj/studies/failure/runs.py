"""Runs of one event each, alone on its machine."""

from collections.abc import Callable, Sequence
from pathlib import Path

from cmf_mj.control.law import Law, load_law
from cmf_mj.control.protection import ProtectionSettings, load_protection
from cmf_mj.core.errors import InputError
from cmf_mj.core.rates import FRAME
from cmf_mj.core.threads import on_threads
from cmf_mj.facility.simulation import OutOfBounds, simulate
from cmf_mj.plant.events import Event
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters.hydraulics import HydraulicParameters
from cmf_mj.plant.parameters.loading import load_hydraulics
from cmf_mj.signals.single import Command
from cmf_mj.studies.failure.manoeuvre import AFTER, FREQUENCY, manoeuvre, size_of
from cmf_mj.studies.failure.measures import FailureResult, measure


def run_failure(
    event: Event,
    plant: Hexapod | None = None,
    law: str | Path | Law = "velocity",
    dof: str = "heave",
    amplitude: float | None = None,
    frequency: float = FREQUENCY,
    *,
    after: float = AFTER,
    command: Command | None = None,
    protection: str | Path | ProtectionSettings | None = "default",
) -> FailureResult:
    """Run one event and measure what it does.

    Args:
        event: what fails, where, when and how much.
        plant: default the hexapod with the GFD and the `hardware` set.
        law: name, TOML file or loaded law.
        dof: degree of freedom of the manoeuvre.
        amplitude: of its sine [m or rad]; default 6 in or 4 deg.
        frequency: of its sine [Hz].
        after: length of the run after the event [s].
        command: another manoeuvre in place of the sine; it must be longer than `event.at`.
        protection: `default`, a TOML file, or None for no protection.

    Raises:
        InputError: an argument out of range, named.
    """
    machine = Hexapod() if plant is None else plant
    loaded = load_law(law)
    size = size_of(dof, amplitude)
    run = manoeuvre(dof, size, frequency, at=event.at, after=after) if command is None else command
    frames = run.pose.shape[0]
    if not event.at < (frames - 1) * FRAME:
        raise InputError(
            f"at: {event.at} s must be less than the run of {(frames - 1) * FRAME:g} s"
        )
    message = ""
    try:
        record = simulate(machine, loaded, run, events=[event], protection=protection)
    except OutOfBounds as left:
        # The same run again, up to the frame before.
        message = str(left)
        shorter = Command(run.pose[: max(left.frame, 2)], run.description, run.seed)
        record = simulate(machine, loaded, shorter, events=[event], protection=protection)
    return measure(machine, event, dof, protection is not None, record, message)


def run_failures(
    events: Sequence[Event],
    *,
    cab: str = "gfd",
    hydraulics: str | Path | HydraulicParameters = "hardware",
    law: str | Path | Law = "velocity",
    dof: str = "heave",
    amplitude: float | None = None,
    frequency: float = FREQUENCY,
    after: float = AFTER,
    protection: str | Path | ProtectionSettings | None = "default",
    jobs: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[FailureResult]:
    """Run several events, each alone on a machine of its own, on threads.

    Args:
        events: one run each.
        cab: `gfd`, `rfd` or `ifd`.
        hydraulics: a set's name, a TOML file or a loaded set.
        law: as for `run_failure`.
        dof: as for `run_failure`.
        amplitude: as for `run_failure`.
        frequency: as for `run_failure`.
        after: as for `run_failure`.
        protection: as for `run_failure`.
        jobs: threads; default one a core. Results do not depend on it.
        progress: called with (runs done, runs in all) after each.

    Raises:
        InputError: an argument out of range, named.
    """
    loaded, parameters = load_law(law), load_hydraulics(hydraulics)
    guard = None if protection is None else load_protection(protection)
    size = size_of(dof, amplitude)

    def one(event: Event) -> FailureResult:
        plant = Hexapod(cab, parameters)
        return run_failure(
            event, plant, loaded, dof, size, frequency, after=after, protection=guard
        )

    return on_threads(one, events, jobs, progress)
