"""What a failure run flies: a sine in one degree of freedom from rest to rest."""

from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.machine.dof import by_kind, dof_index
from cmf_mj.signals.peaks import check_limits
from cmf_mj.signals.signal import Command, check_not_negative, check_positive
from cmf_mj.signals.single import sine

AMPLITUDES = (6.0 * units.INCH, 4.0 * units.DEGREE)
"""Default amplitude of the manoeuvre in translation [m] and rotation [rad]."""

FREQUENCY = 0.5
"""Default frequency of the manoeuvre [Hz]; 6 in then move a leg at 16 in/s."""

AT = 4.0
"""Default time of the event [s]: after the fade-in, at the largest speed of the default sine."""

AFTER = 26.0
"""Default length of the run after the event [s]: pump lost, noticed after 11 s, and settled."""

REST = 2.0
"""Rest after the manoeuvre [s]."""

FADE = 1.0
"""Fade of the manoeuvre at both ends [s]."""


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
    command = sine(dof, amplitude, frequency, cycles=cycles, fade=FADE, rest=REST)
    check_limits(command)
    return command


def size_of(dof: str, amplitude: float | None) -> float:
    """The amplitude of the sine [m or rad]; None for the default one of the degree of freedom."""
    if amplitude is None:
        return by_kind(dof, *AMPLITUDES)
    dof_index(dof)
    check_positive(amplitude=amplitude)
    return amplitude
