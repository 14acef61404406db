"""Servo-valve, one or two to an actuator: lags, play, lap, then four-way matched-port orifice flow.

From the command fraction c, held over a step, to the spool position u, with the corners a and b of
drive and spool, null bias n and the play p between drive and spool (hysteresis):

    dd/dt = a (c - d),    du/dt = b (d - p + n - u)                          (Eqs 4.1, 4.4)

solved exactly; p follows d where the two are further apart than half the hysteresis. The opening
is u less the overlap o, e = sign(u) max(|u| - o, 0), at most 1. The flows into the chambers:

    q_cap =  k A_cap (e+ phi(Ps - p_cap) - e- phi(p_cap - Pt)),    e+ = max(e, 0)
    q_rod = -k A_rod (e+ phi(p_rod - Pt) - e- phi(Ps - p_rod)),    e- = max(-e, 0)

The ports are *matched*: flow gains stand to each other as the areas, so that both chambers ask
for the same leg speed. An orifice of gain G behind a line of laminar resistance R has the drop

    dp = (q / G)^2 + (s / G + R) q,    so    q = G phi,  phi = 2 dp / (s' + sqrt(s'^2 + 4 |dp|)),

s' = s + R G: turbulent well above the transition pressure 2 s^2, laminar below. Where the supply
stands less than the threshold pressure above the return, the pilot stage cannot hold the spool and
nothing passes (section 2.4.2).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cmf_mj.core.arrays import compiled_params, record_array
from cmf_mj.core.compiled import compiled
from cmf_mj.plant.oil import density, make_oil
from cmf_mj.plant.parameters import VALVES, HydraulicParameters, cap_area, rod_area

NORMAL, OVERRIDE, JAMMED = 0.0, 1.0, 2.0
"""What a valve obeys: its command, a value put on the spool by a fault, or nothing."""


class Valve(NamedTuple):
    """Compiled parameters of one valve."""

    stage_drive: float  #: Weight of the drive's offset in itself after the first stage of a step.
    stage_mixed: float  #: Weight of the drive's offset in the spool after the first stage.
    stage_spool: float  #: Weight of the spool's offset in itself after the first stage.
    step_drive: float  #: Weight of the drive's offset in itself after the whole step.
    step_mixed: float  #: Weight of the drive's offset in the spool after the whole step.
    step_spool: float  #: Weight of the spool's offset in itself after the whole step.
    cap_gain: float  #: k A_cap, cap port flow at full opening [m^3/s/sqrt(Pa)].
    rod_gain: float  #: k A_rod times `rod_port`, rod port flow at full opening [m^3/s/sqrt(Pa)].
    null_bias: float  #: n, fraction.
    overlap: float  #: o, fraction.
    play: float  #: Half of the hysteresis, fraction.
    threshold_pressure: float  #: Threshold pressure [Pa].


def make_valves(
    parameters: HydraulicParameters, actuators: Sequence[str], first_stage: float, step: float
) -> np.recarray:
    """Derive the valves of all actuators from a parameter set, (n, 2) of `Valve`.

    `first_stage` and `step` are the lengths of the first stage and of the whole step [s].
    """
    half_drop = 0.5 * (parameters.supply_pressure.si - parameters.return_pressure.si)
    # Flows count content: what fills the chamber at mid pressure, where leg_speed is defined.
    mid_density = density(make_oil(parameters), parameters.return_pressure.si + half_drop)[0]
    unit_flow = orifice(half_drop, laminar_root(parameters))[0] / mid_density

    def make(actuator: str, index: int) -> Valve:
        numbers = parameters.actuator(actuator, index)
        valve_share = 1.0 / numbers["valves"].si if index < numbers["valves"].si else 0.0
        flow_gain = numbers["leg_speed"].si / unit_flow * numbers["valve_flow"].si * valve_share
        corners = numbers["drive_lag"].si, numbers["valve_lag"].si
        stage_drive, stage_mixed, stage_spool = lag_weights(*corners, first_stage)
        step_drive, step_mixed, step_spool = lag_weights(*corners, step)
        return compiled_params(
            Valve,
            numbers,
            stage_drive=stage_drive,
            stage_mixed=stage_mixed,
            stage_spool=stage_spool,
            step_drive=step_drive,
            step_mixed=step_mixed,
            step_spool=step_spool,
            cap_gain=flow_gain * cap_area(numbers),
            rod_gain=flow_gain * rod_area(numbers) * numbers["rod_port"].si,
            play=0.5 * numbers["hysteresis"].si,
        )

    return record_array(Valve, [[make(name, i) for i in range(len(VALVES))] for name in actuators])


def laminar_root(parameters: HydraulicParameters) -> float:
    """The s [sqrt(Pa)] of all orifices, of a parameter set's transition pressure."""
    return float(np.sqrt(0.5 * parameters.transition_pressure.si))


@compiled
def lag_weights(drive_rate, spool_rate, time):  # type: ignore[no-untyped-def]
    """Weights (drive, mixed, spool) of the exact lag solution after `time` [s]."""
    a, b = drive_rate, spool_rate
    drive = np.exp(-a * time)
    spool = np.exp(-b * time)
    mixed = b / (b - a) * (drive - spool) if abs(a - b) > 1e-9 * b else b * time * spool
    return drive, mixed, spool


@compiled
def spool(valve, is_last, command, drive, play, position):  # type: ignore[no-untyped-def]
    """Drive output, play and spool position of one valve after a held command, all fractions.

    Play is drive less spool command. The time is the whole step if `is_last`, else its first stage.
    """
    drive_weight = valve.step_drive if is_last else valve.stage_drive
    mixed_weight = valve.step_mixed if is_last else valve.stage_mixed
    spool_weight = valve.step_spool if is_last else valve.stage_spool
    drive_offset = drive - command
    following_drive = command + drive_offset * drive_weight
    if valve.play > 0.0:
        play = min(max(play + following_drive - drive, -valve.play), valve.play)
    target = command + valve.null_bias - play
    position = target + drive_offset * mixed_weight + (position - target) * spool_weight
    return following_drive, play, position


@compiled
def opening(valve, position):  # type: ignore[no-untyped-def]
    """e, what a spool position opens, -1 to 1."""
    magnitude = min(max(abs(position) - valve.overlap, 0.0), 1.0)
    return magnitude if position >= 0.0 else -magnitude


@compiled
def orifice(drop, laminar):  # type: ignore[no-untyped-def]
    """phi(dp) [sqrt(Pa)] and its derivative [1/sqrt(Pa)]."""
    root = np.sqrt(laminar * laminar + 4.0 * abs(drop))
    total = laminar + root
    inverse = 1.0 / (root * total)
    return 2.0 * drop * root * inverse, total * inverse
