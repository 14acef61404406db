"""Composes valves, cylinders and supply into n actuators and advances them one mechanical step.

The mechanics hands over where the legs were at the two ends of the step. The content of a volume
changes by the flows into it alone, dC/dt = Q(p), and gives its pressure through C = V r(p); so the
displacement enters exactly, and only the flows are integrated: by the two-stage singly diagonally
implicit Runge-Kutta method of Alexander (1977),

    gamma = 1 - 1/sqrt(2),  stages at gamma t and t,

second order and L-stable, so that a chamber near its stop or with no pressure across its port,
whose rates reach 1e5 1/s, is as harmless as one in mid-stroke. See `solver` for the stages. The
method conserves what is linear in the state: oil, to rounding.

The method is not contractive where flows are not linear: a chamber torn to vacuum, which takes oil
back at one atmosphere only, would swing between vacuum and pressure for ever. A step in which a
chamber is below half an atmosphere is taken by the implicit Euler method, which is.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.compiled import inlined
from cmf_mj.core.errors import InputError
from cmf_mj.plant.cylinder import (
    CAP,
    ROD,
    force,
    holding_pressures,
    make_cylinders,
    make_frictions,
    slide,
    throttled,
    volumes,
)
from cmf_mj.plant.oil import ATMOSPHERE, Oil, density, least_pressure, make_oil
from cmf_mj.plant.parameters import HydraulicParameters
from cmf_mj.plant.solver import POWERS, Stage, make_stage, solve
from cmf_mj.plant.supply import (
    ACCUMULATOR,
    CONTENTS,
    GAS,
    ISOLATION,
    RETURN_PRESSURE,
    SUPPLY_PRESSURE,
    Supply,
    charged,
    gas_pressure,
    make_supply,
)
from cmf_mj.plant.valve import JAMMED, OVERRIDE, laminar_root, make_valves, opening, orifice, spool

_GAMMA = 1.0 - 1.0 / np.sqrt(2.0)

_TORN = -0.5 * ATMOSPHERE  #: Gauge pressure below which a chamber counts as torn [Pa].

ENERGIES = (*POWERS, "mechanical", "friction")
"""Columns of `HydraulicState.energy` [J]: work of pump and accumulators, losses in valves, lines,
leakage, relief and burst hose, work on the pistons, and the part of it friction takes."""

_MECHANICAL, _FRICTION = map(ENERGIES.index, ("mechanical", "friction"))


class Hydraulics(NamedTuple):
    """Compiled parameters of n actuators on one supply, for one length of step."""

    valve: np.recarray  #: (n, 2) of `valve.Valve`.
    cylinder: np.recarray  #: (n,) of `cylinder.Cylinder`.
    friction: np.recarray  #: (n,) of `friction.Friction`.
    oil: Oil  #: One oil.
    supply: Supply  #: One supply.
    laminar: float  #: s of all orifices [sqrt(Pa)].
    step: float  #: Length of a step [s].
    proof_pressure: float  #: Largest chamber pressure [Pa].


class HydraulicState(NamedTuple):
    """State of n actuators and their supply."""

    drive: NDArray[np.float64]  #: Drive outputs, fractions, (n, 2).
    play: NDArray[np.float64]  #: Drive less spool command, fractions, (n, 2).
    spool: NDArray[np.float64]  #: Spool positions, fractions, (n, 2).
    content: NDArray[np.float64]  #: Oil in cap and rod chambers [m^3], (n, 2).
    pressure: NDArray[np.float64]  #: Pressures of cap and rod chambers [Pa], (n, 2).
    bristle: NDArray[np.float64]  #: Deflection of the friction contacts [m], (n,).
    friction: NDArray[np.float64]  #: Friction force [N], (n,).
    supply: NDArray[np.float64]  #: State of the supply, (9,), see `supply.SUPPLY`.
    energy: NDArray[np.float64]  #: Energy passed since the start, see `ENERGIES`.
    stage: Stage  #: Workspace.


def make_hydraulics(
    parameters: HydraulicParameters, actuators: Sequence[str], step: float
) -> Hydraulics:
    """Derive all elements for a mechanical step [s]; those in `parameters.actuators` differ."""
    for name in parameters.actuators:
        if name not in actuators:
            raise InputError(
                f"actuators: {name!r} is not an actuator; allowed: {', '.join(actuators)}"
            )
    return Hydraulics(
        make_valves(parameters, actuators, _GAMMA * step, step),
        make_cylinders(parameters, actuators),
        make_frictions(parameters, actuators),
        make_oil(parameters),
        make_supply(parameters),
        laminar_root(parameters),
        step,
        parameters.proof_pressure.si,
    )


def rest(
    hydraulics: Hydraulics, load: NDArray[np.float64], extension: NDArray[np.float64]
) -> HydraulicState:
    """State that holds the static loads [N] at the extensions [m] with closed valves."""
    supply, cylinder = hydraulics.supply, hydraulics.cylinder
    legs = load.shape[0]
    pressure = holding_pressures(cylinder, load, supply.pressure, supply.return_pressure)
    content = np.empty_like(pressure)
    for leg in range(legs):
        for side, volume in enumerate(volumes(cylinder[leg], extension[leg])):
            content[leg, side] = volume * density(hydraulics.oil, pressure[leg, side])[0]
    return HydraulicState(
        drive=np.zeros((legs, 2)),
        play=np.zeros((legs, 2)),
        spool=np.array(hydraulics.valve.null_bias),
        content=content,
        pressure=pressure,
        bristle=np.zeros(legs),
        friction=np.zeros(legs),
        supply=charged(supply, hydraulics.oil),
        energy=np.zeros(len(ENERGIES)),
        stage=make_stage(legs),
    )


def open_to_hold(hydraulics: Hydraulics, state: HydraulicState) -> NDArray[np.float64]:
    """Open the valves of a state of `rest` until its pressures stay; the commands (n,).

    They are 0 where the pressures stay with closed valves. Of equal areas A leakage L lets none
    stay: e = L (p_cap - p_rod) / (k A phi(Ps - p_cap)) beyond the overlap feeds it, see `valve`.
    """
    command = np.zeros(state.pressure.shape[0])
    for leg, (cap, rod) in enumerate(state.pressure):
        cylinder, valve = hydraulics.cylinder[leg], hydraulics.valve[leg]
        lost = cylinder.leakage * (cap - rod)
        if cylinder.cap_area == cylinder.rod_area and lost != 0.0:
            gain = (valve.cap_gain if lost > 0.0 else valve.rod_gain).sum()
            flow = orifice(hydraulics.supply.pressure - max(cap, rod), hydraulics.laminar)[0]
            command[leg] = lost / (gain * flow) + np.sign(lost) * valve.overlap[0]
    for spools in (state.drive, state.spool):
        spools += command[:, None]
    return command


@inlined
def _open(hydraulics, state, faults, last, command, before, after):  # type: ignore[no-untyped-def]
    """Volumes and flow gains of all actuators at the end of a stage; the last moves the spools."""
    head = state.supply[SUPPLY_PRESSURE] - state.supply[RETURN_PRESSURE]
    closed = state.supply[ISOLATION]
    part = 1.0 if last else _GAMMA
    for leg in range(before.shape[0]):
        pair, cylinder = state.stage.chambers[leg], hydraulics.cylinder[leg]
        extension = before[leg] + part * (after[leg] - before[leg])
        pair.cap_volume, pair.rod_volume = volumes(cylinder, extension)
        cap_in, cap_out, rod_in, rod_out = 0.0, 0.0, 0.0, 0.0
        for index in range(2):
            valve = hydraulics.valve[leg, index]
            position = state.spool[leg, index]
            mode = faults.valve[leg, index]
            if mode != JAMMED:
                drive, play, asked = state.drive[leg, index], state.play[leg, index], command[leg]
                if mode == OVERRIDE:
                    asked = faults.spool[leg, index]
                    drive, play = asked, 0.0
                drive, play, position = spool(valve, last, asked, drive, play, position)
                if last:
                    state.drive[leg, index] = drive
                    state.play[leg, index] = play
                    state.spool[leg, index] = position
            if head >= valve.threshold_pressure:
                size = (1.0 - closed) * opening(valve, position)
                if size >= 0.0:
                    cap_in += size * valve.cap_gain
                    rod_out += size * valve.rod_gain
                else:
                    cap_out -= size * valve.cap_gain
                    rod_in -= size * valve.rod_gain
        if closed > 0.0:
            cap_out += closed * cylinder.settle_gain
            rod_out += closed * cylinder.settle_rod_gain
        if cylinder.cushion_length > 0.0:
            half = cylinder.half_stroke
            both = hydraulics.valve[leg, 0], hydraulics.valve[leg, 1]
            full_cap = both[0].cap_gain + both[1].cap_gain
            full_rod = both[0].rod_gain + both[1].rod_gain
            cap_out = throttled(cylinder, half + extension, cap_out, full_cap)
            rod_out = throttled(cylinder, half - extension, rod_out, full_rod)
        pair.cap_in, pair.cap_out, pair.rod_in, pair.rod_out = cap_in, cap_out, rod_in, rod_out


@inlined
def _set_out(state, last, share, least):  # type: ignore[no-untyped-def]
    """Known contents of a stage, and guesses: pressures go on as over the last step or stage."""
    stage, network = state.stage, state.supply
    for leg in range(state.pressure.shape[0]):
        pair = stage.chambers[leg]
        cap, rod = state.pressure[leg, CAP], state.pressure[leg, ROD]
        if last:
            pair.cap_known += share * (pair.cap_content - pair.cap_known)
            pair.rod_known += share * (pair.rod_content - pair.rod_known)
            pair.cap = max(cap + (pair.cap - cap) / _GAMMA, least)
            pair.rod = max(rod + (pair.rod - rod) / _GAMMA, least)
        else:
            pair.cap_known, pair.rod_known = state.content[leg, CAP], state.content[leg, ROD]
            pair.cap = max(cap + _GAMMA * pair.cap_change, least)
            pair.rod = max(rod + _GAMMA * pair.rod_change, least)
    for node in range(CONTENTS + 1):
        if last:
            stage.known[node] += share * (stage.node[node] - stage.known[node])
        else:
            stage.known[node] = network[node]
            stage.node[node] = network[node]


@inlined
def _count(hydraulics, energy, stage, time, part, before, after):  # type: ignore[no-untyped-def]
    """Add to the energies what a stage passes in its time, over its part of the motion."""
    for i in range(len(POWERS)):
        energy[i] += time * stage.power[i]
    for leg in range(before.shape[0]):
        pair = stage.chambers[leg]
        load = force(hydraulics.cylinder[leg], pair.cap, pair.rod)
        energy[_MECHANICAL] += part * load * (after[leg] - before[leg])


@inlined
def advance(hydraulics, state, faults, command, before, after, stopped=False):  # type: ignore[no-untyped-def]
    """Advance all actuators and the supply by one mechanical step; whether both stages converged.

    Command fractions (n,) are held over the step, from the extensions (n,) [m] before to those
    after. If `stopped`, in an emergency stop, the supply closes and the settle valves open.
    """
    step, supply, stage = hydraulics.step, hydraulics.supply, state.stage
    network, energy = state.supply, state.energy
    chambers, manifolds = stage.chambers, stage.manifolds[0]
    legs = before.shape[0]
    weight, least = _GAMMA * step, least_pressure(hydraulics.oil)
    gas, rise = gas_pressure(supply, network[ACCUMULATOR])
    manifolds.gas, manifolds.gas_rise, manifolds.gas_oil = gas, rise, network[ACCUMULATOR]
    failed = faults.plant[0]
    manifolds.running = 0.0 if failed.pump_lost > 0.0 else 1.0
    manifolds.bank = max(supply.accumulators - failed.accumulators_lost, 0.0)
    manifolds.burst = supply.jet * failed.burst_area
    travel = supply.isolation_rate * step
    closing = travel if stopped else -travel
    network[ISOLATION] = min(max(network[ISOLATION] + closing, 0.0), 1.0)
    manifolds.high, manifolds.low = network[SUPPLY_PRESSURE], network[RETURN_PRESSURE]

    for i in range(energy.shape[0]):
        stage.energy[i] = energy[i]
    torn = False
    for leg in range(legs):
        torn |= state.pressure[leg, CAP] < _TORN or state.pressure[leg, ROD] < _TORN
    converged = True
    for last in (False, True):
        _open(hydraulics, state, faults, last, command, before, after)
        _set_out(state, last, (step - weight) / weight, least)
        solved = solve(
            hydraulics.cylinder, hydraulics.oil, supply, hydraulics.laminar, stage, weight
        )
        converged &= solved >= 0
        share = weight if last else step - weight
        _count(hydraulics, energy, stage, share, share / step, before, after)
        for leg in range(legs):
            torn |= chambers[leg].cap < _TORN or chambers[leg].rod < _TORN
    if torn:
        for i in range(energy.shape[0]):
            energy[i] = stage.energy[i]
        for leg in range(legs):
            pair = chambers[leg]
            pair.cap_known, pair.rod_known = state.content[leg, CAP], state.content[leg, ROD]
        for node in range(CONTENTS + 1):
            stage.known[node] = network[node]
        solved = solve(hydraulics.cylinder, hydraulics.oil, supply, hydraulics.laminar, stage, step)
        converged = solved >= 0
        # Work by the mean of both ends, as the mechanics does it.
        _count(hydraulics, energy, stage, step, 0.5, before, after)
        for leg in range(legs):
            pressure = state.pressure[leg]
            load = force(hydraulics.cylinder[leg], pressure[CAP], pressure[ROD])
            energy[_MECHANICAL] += 0.5 * load * (after[leg] - before[leg])

    for leg in range(legs):
        pair = chambers[leg]
        pair.cap_change = pair.cap - state.pressure[leg, CAP]
        pair.rod_change = pair.rod - state.pressure[leg, ROD]
        state.pressure[leg, CAP], state.pressure[leg, ROD] = pair.cap, pair.rod
        state.content[leg, CAP], state.content[leg, ROD] = pair.cap_content, pair.rod_content
        moved = after[leg] - before[leg]
        state.bristle[leg], state.friction[leg] = slide(
            hydraulics.friction[leg], state.bristle[leg], moved / step, step
        )
        energy[_FRICTION] += state.friction[leg] * moved
    for node in range(CONTENTS + 1):
        network[node] = stage.node[node]
    network[SUPPLY_PRESSURE], network[RETURN_PRESSURE] = manifolds.high, manifolds.low
    network[GAS] = gas
    return converged


@inlined
def loads(cylinders, pressure, friction, out):  # type: ignore[no-untyped-def]
    """Write the axial forces [N], (n,), of all actuators on their rods, friction taken off."""
    for leg in range(out.shape[0]):
        load = force(cylinders[leg], pressure[leg, CAP], pressure[leg, ROD])
        out[leg] = load - friction[leg]
