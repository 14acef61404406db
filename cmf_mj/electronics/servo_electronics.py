r"""Servo electronics of Figure 2-7, between the control law's valve command and the valve.

    command -> counts -> volts -> limit switches -> velocity clamp -> rate limiter -> valve
              \___ DAC ___/      \____ safety module ____/        \_ drive card _/

With full-scale voltage R, n bits and F volts for full command u = 1:

    counts = round(u F / q) within -2^(n-1) .. 2^(n-1) - 1,  q = 2 R / 2^n,  volts = q counts

The DAC rounds halves to even and saturates one count below +R. A **limit switch** trips when a leg
passes the switch position either way and stays so until reset; one tripped switch takes the command
from all legs. The lower switches are watched only in hold and engaged, since legs pass them on
their way to and from the stops. The **velocity clamp** bounds the command, which equates to leg
velocity (section 2.3.3), to a share of full opening. The **rate limiter** bounds the change of the
command per time, also when a switch trips. These act on hardware voltages and know nothing of the
control law, whose own limits should be met first.
"""

from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cmf_mj.core.arrays import compiled_params
from cmf_mj.core.compiled import compiled
from cmf_mj.core.quantity import Length, Quantity, Status, Voltage, positive_in
from cmf_mj.core.settings import Loader, Settings
from cmf_mj.core.units import FRAME


class Bits(Settings):
    """Resolution of a converter."""

    value: Annotated[int, Field(ge=0, le=32)]  #: Bits; 0 for no quantisation.
    status: Status  #: How the number is known.
    source: str = Field(min_length=1)  #: Where it comes from, or why it was chosen.


class ServoSettings(Settings):
    """Servo electronics of one leg."""

    switch_position: Length
    """Leg extension or retraction from neutral at which a limit switch trips."""
    velocity_clamp: Annotated[Quantity, positive_in("%", "1")]
    """Largest command the safety module passes."""
    rate_limit: Annotated[Quantity, positive_in("%/s", "1/s")]
    """Largest change of the command on the drive card."""
    dac_range: Voltage  #: Full-scale voltage R either way.
    full_command: Voltage  #: Voltage F of full command.
    dac_bits: Bits  #: Resolution n of the DAC.


load_servo_settings = Loader(ServoSettings, Path(__file__).with_suffix(".toml"))
"""Loads the settings of the servo electronics."""


class ServoElectronics(NamedTuple):
    """Compiled parameters, SI, commands as fractions."""

    switch_position: float  #: Position of the switches either way [m].
    velocity_clamp: float  #: Largest command that passes.
    change: float  #: Largest change of the command in one frame.
    full_command: float  #: F [V].
    dac_range: float  #: R [V].
    quantum: float  #: q [V]; 0 without quantisation.


class ServoState(NamedTuple):
    """State of the servo electronics."""

    tripped: NDArray[np.bool_]  #: Latched switches, (n, 2): retracted, extended.
    command: NDArray[np.float64]  #: Command behind the rate limiter, fractions, (n,).


def make_servo_electronics(
    settings: ServoSettings | None = None, frame: float = FRAME
) -> ServoElectronics:
    """Compile the settings, default the shipped ones, for a control frame [s]."""
    chosen = settings or load_servo_settings()
    bits = chosen.dac_bits.value
    quantum = 2.0 * chosen.dac_range.si / 2.0**bits if bits else 0.0
    return compiled_params(
        ServoElectronics, chosen, change=chosen.rate_limit.si * frame, quantum=quantum
    )


def start(legs: int = 6) -> ServoState:
    """State with no switch tripped and no command."""
    return ServoState(np.zeros((legs, 2), dtype=np.bool_), np.zeros(legs))


@compiled
def reset(state):  # type: ignore[no-untyped-def]
    """Release all latched switches; those still passed trip again in the next frame."""
    state.tripped[:] = False


@compiled
def convert(electronics, command):  # type: ignore[no-untyped-def]
    """Counts and volts of a command fraction; without quantisation counts are 0.

    A command that is no number gives no voltage.
    """
    volts = command * electronics.full_command
    if np.isnan(volts):
        return 0.0, 0.0
    largest_volts = electronics.dac_range
    if electronics.quantum == 0.0:
        return 0.0, min(max(volts, -largest_volts), largest_volts)
    largest_counts = np.rint(largest_volts / electronics.quantum)
    counts = np.rint(volts / electronics.quantum)
    counts = min(max(counts, -largest_counts), largest_counts - 1.0)
    return counts, counts * electronics.quantum


@compiled
def step(electronics, state, watches_lower, command, position):  # type: ignore[no-untyped-def]
    """Turn the law's commands (n,), fractions, into those of the valves in place, one frame.

    The lower switches are watched if `watches_lower`: in hold and engaged, not on the stops, in
    raise, return and fault. A leg extension (n,) [m] that is no number trips the watched switches.
    Returns whether a switch has tripped, now or earlier.
    """
    switch = electronics.switch_position
    tripped = False
    for leg in range(command.shape[0]):
        if watches_lower and not position[leg] >= -switch:
            state.tripped[leg, 0] = True
        if not position[leg] <= switch:
            state.tripped[leg, 1] = True
        tripped |= state.tripped[leg, 0] | state.tripped[leg, 1]
    clamp, change = electronics.velocity_clamp, electronics.change
    for leg in range(command.shape[0]):
        _, volts = convert(electronics, command[leg])
        target = 0.0 if tripped else volts / electronics.full_command
        target = min(max(target, -clamp), clamp)
        # Bounds of the command: a bounded change added to the command before would round.
        before = state.command[leg]
        state.command[leg] = min(max(target, before - change), before + change)
        command[leg] = state.command[leg]
    return tripped
