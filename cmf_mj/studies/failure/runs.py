"""Runs of one event each, on a new machine that moves in a sine from rest to rest."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cmf_mj.control.protection import ProtectionSettings
from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.core.rates import FRAME
from cmf_mj.core.threads import on_threads
from cmf_mj.facility.simulation import OutOfBounds, simulate
from cmf_mj.machine.dof import by_kind
from cmf_mj.plant.events import Event
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.signals.peaks import check_limits
from cmf_mj.signals.signal import Command, check_not_negative, check_positive
from cmf_mj.signals.single import sine
from cmf_mj.studies.case import Case, make_case
from cmf_mj.studies.failure.measures import FADE, REST, FailureResult, measure

AMPLITUDES = (6.0 * units.INCH, 4.0 * units.DEGREE)
"""Default amplitude of the manoeuvre in translation [m] and rotation [rad]."""

FREQUENCY = 0.5
"""Default frequency of the manoeuvre [Hz]; 6 in then move a leg at 16 in/s."""

AFTER = 26.0
"""Default length of the run after the event [s]: pump lost, noticed after 11 s, and settled."""


def manoeuvre(
    dof: str, amplitude: float, frequency: float, *, at: float, after: float = AFTER
) -> Command:
    """The sine of a failure run, faded in and out, and two seconds of rest.

    `amplitude` is in m or rad, `frequency` in Hz; the event comes `at`, the run ends `after` it, at
    least 4 s later [s].
    """
    check_positive(frequency=frequency)
    check_not_negative(at=at)
    if not after >= 2.0 * REST:
        raise InputError(f"after: {after} s must be at least {2.0 * REST:g} s")
    cycles = (at + after - REST) * frequency
    return sine(dof, amplitude, frequency, cycles=cycles, fade=FADE, rest=REST)


def run_failure(
    event: Event,
    case: Case | None = None,
    *,
    frequency: float = FREQUENCY,
    after: float = AFTER,
    command: Command | None = None,
    protection: str | Path | ProtectionSettings | None = "default",
) -> FailureResult:
    """Run one event and measure what it does.

    `case` names law, hexapod, degree of freedom and amplitude of the manoeuvre's sine (default 6 in
    or 4 deg in heave with velocity feedback, the GFD, the `hardware` set); `after` is the length of
    the run after the event [s]. `command` stands in for the sine and must be longer than
    `event.at`. `protection` is `default`, a TOML file, or None for none.
    """
    chosen = make_case("velocity") if case is None else case
    machine = Hexapod(chosen.cab, chosen.hydraulics, machine=chosen.on)
    size = by_kind(chosen.dof, *AMPLITUDES) if chosen.amplitude is None else chosen.amplitude
    if command is None:
        command = manoeuvre(chosen.dof, size, frequency, at=event.at, after=after)
        check_limits(command, machine=chosen.on)
    frames = command.pose.shape[0]
    if not event.at < (frames - 1) * FRAME:
        raise InputError(
            f"at: {event.at} s must be less than the run of {(frames - 1) * FRAME:g} s"
        )
    message = ""
    options: dict[str, Any] = {"events": [event], "protection": protection}
    try:
        record = simulate(machine, chosen.law, command, **options)
    except OutOfBounds as left:
        # The same run again, up to the frame before.
        message = str(left)
        shorter = Command(command.pose[: max(left.frame, 2)], command.signal, command.seed)
        record = simulate(machine, chosen.law, shorter, **options)
    return measure(machine, event, chosen.dof, protection is not None, record, message)


def run_failures(
    events: Sequence[Event], case: Case | None = None, *, jobs: int | None = None, **options: Any
) -> list[FailureResult]:
    """Run several events with the options of `run_failure`, each on a new machine, on threads."""
    return on_threads(lambda event: run_failure(event, case, **options), events, jobs)
