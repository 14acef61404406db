"""Servo-valve: drive and spool lags, then four-way matched-port orifice flow.

Lags, from the command fraction c (held over a step) to the opening u in -1..1:

    dd/dt = a (c - d),   du/dt = b (d - u),   a, b the drive and spool corners    (Eqs 4.1, 4.4)

solved exactly. Flow into the chambers, u > 0 extending, k the speed gain, A the area of a port:

    q_cap =  k A_cap (u+ phi(Ps - p_cap) - u- phi(p_cap - Pt))
    q_rod = -k A_rod (u+ phi(p_rod - Pt) - u- phi(Ps - p_rod)),    u+ = max(u, 0), u- = max(-u, 0)

The ports are *matched*: flow gains stand to each other as the areas, so that both chambers ask
for the same leg speed. phi is the orifice law, smooth through zero,

    phi(dp) = dp / (dp^2 + ptr^2)^(1/4),

which is sqrt(|dp|) sign(dp) well above the transition pressure ptr and linear below it.
"""

from typing import NamedTuple

import numpy as np

from cmf_mj.compiled import compiled
from cmf_mj.parameters import HydraulicParameters


class Valve(NamedTuple):
    """Compiled parameters of one actuator's valve."""

    drive_rate: float
    """a, corner of the servo drive [rad/s]."""
    spool_rate: float
    """b, corner of the spool [rad/s]."""
    cap_gain: float
    """k A_cap, cap port flow at full opening [m^3/s/sqrt(Pa)]."""
    rod_gain: float
    """k A_rod, rod port flow at full opening [m^3/s/sqrt(Pa)]."""
    transition_pressure: float
    """ptr [Pa]."""


def make_valve(parameters: HydraulicParameters) -> Valve:
    """Derive the valve from a parameter set."""
    return Valve(
        drive_rate=parameters.drive_lag.si,
        spool_rate=parameters.valve_lag.si,
        cap_gain=parameters.speed_gain * parameters.cap_area,
        rod_gain=parameters.speed_gain * parameters.rod_area,
        transition_pressure=parameters.transition_pressure.si,
    )


@compiled
def lag_weights(valve, time):  # type: ignore[no-untyped-def]
    """Weights (drive, mixed, spool) of the exact lag solution after `time` [s]."""
    a, b = valve.drive_rate, valve.spool_rate
    drive = np.exp(-a * time)
    spool = np.exp(-b * time)
    mixed = b / (b - a) * (drive - spool) if abs(a - b) > 1e-9 * b else b * time * spool
    return drive, mixed, spool


@compiled
def lags(weights, command, drive, opening):  # type: ignore[no-untyped-def]
    """Advance drive output and opening under a held command.

    Args:
        weights: of `lag_weights` for the time to advance.
        command: command fraction, -1 to 1.
        drive: drive output at the start.
        opening: opening at the start.

    Returns:
        (drive output, opening), fractions.
    """
    offset = drive - command
    return (
        command + offset * weights[0],
        command + offset * weights[1] + (opening - command) * weights[2],
    )


@compiled
def orifice(drop, transition):  # type: ignore[no-untyped-def]
    """phi(dp) [sqrt(Pa)] and its derivative [1/sqrt(Pa)]."""
    square = drop * drop + transition * transition
    root = np.sqrt(np.sqrt(square))
    return drop / root, (0.5 * drop * drop + transition * transition) / (square * root)


@compiled
def port_flows(valve, opening, supply, cap_pressure, rod_pressure):  # type: ignore[no-untyped-def]
    """Flows into the chambers and their slopes.

    Returns:
        (q_cap, q_rod [m^3/s], dq_cap/dp_cap, dq_rod/dp_rod [m^3/s/Pa]); the slopes are negative.
    """
    if opening >= 0.0:
        cap, cap_slope = orifice(supply.pressure - cap_pressure, valve.transition_pressure)
        rod, rod_slope = orifice(rod_pressure - supply.return_pressure, valve.transition_pressure)
    else:
        cap, cap_slope = orifice(cap_pressure - supply.return_pressure, valve.transition_pressure)
        rod, rod_slope = orifice(supply.pressure - rod_pressure, valve.transition_pressure)
    size = abs(opening)
    return (
        valve.cap_gain * opening * cap,
        -valve.rod_gain * opening * rod,
        -valve.cap_gain * size * cap_slope,
        -valve.rod_gain * size * rod_slope,
    )
