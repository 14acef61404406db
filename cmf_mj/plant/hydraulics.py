"""Valves, cylinders and supply of n actuators, advanced by one mechanical step.

The mechanics gives the extensions of the legs at both ends of the step. The content of a volume
changes by the flows into it alone, dC/dt = Q(p), and gives its pressure through C = V r(p); so the
displacement enters exactly, and only the flows are integrated: by the two-stage singly diagonally
implicit Runge-Kutta method of Alexander (1977),

    gamma = 1 - 1/sqrt(2),  stages at gamma t and t,

second order and L-stable, as chambers near a stop need, whose rates reach 1e5 1/s. See `solver` for
the stages. The method conserves what is linear in the state: oil, to rounding.

The method is not contractive where flows are not linear: a chamber torn to vacuum would swing
between vacuum and pressure for ever. A step in which a chamber is below half an atmosphere is taken
by the implicit Euler method, which is contractive.
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
    throttled_gain,
    volumes,
)
from cmf_mj.plant.oil import ATMOSPHERE, Oil, density, least_pressure, make_oil
from cmf_mj.plant.parameters import HydraulicParameters
from cmf_mj.plant.solver import POWERS, Stage, make_stage, solve
from cmf_mj.plant.supply import (
    ACCUMULATOR,
    GAS,
    INTEGRATED,
    ISOLATION,
    RETURN_PRESSURE,
    SUPPLY_PRESSURE,
    Supply,
    charge_supply,
    gas_pressure,
    make_supply,
)
from cmf_mj.plant.valve import JAMMED, OVERRIDE, laminar_root, make_valves, opening, orifice, spool

_GAMMA = 1.0 - 1.0 / np.sqrt(2.0)

_VACUUM = -0.5 * ATMOSPHERE  #: Gauge pressure below which a chamber counts as torn [Pa].

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
        supply=charge_supply(supply, hydraulics.oil),
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
        leakage = cylinder.leakage * (cap - rod)
        if cylinder.cap_area == cylinder.rod_area and leakage != 0.0:
            gain = (valve.cap_gain if leakage > 0.0 else valve.rod_gain).sum()
            flow, _ = orifice(hydraulics.supply.pressure - max(cap, rod), hydraulics.laminar)
            command[leg] = leakage / (gain * flow) + np.sign(leakage) * valve.overlap[0]
    state.drive[:] += command[:, None]
    state.spool[:] += command[:, None]
    return command


@inlined
def _set_ports(hydraulics, state, faults, is_last, command, start_extension, end_extension):  # type: ignore[no-untyped-def]
    """Volumes and flow gains of all actuators at the end of a stage; the last moves the spools."""
    head = state.supply[SUPPLY_PRESSURE] - state.supply[RETURN_PRESSURE]
    isolation = state.supply[ISOLATION]
    motion_share = 1.0 if is_last else _GAMMA
    for leg in range(start_extension.shape[0]):
        pair, cylinder = state.stage.chambers[leg], hydraulics.cylinder[leg]
        extension = start_extension[leg] + motion_share * (
            end_extension[leg] - start_extension[leg]
        )
        pair.cap_volume, pair.rod_volume = volumes(cylinder, extension)
        cap_in, cap_out, rod_in, rod_out = 0.0, 0.0, 0.0, 0.0
        for index in range(2):
            valve = hydraulics.valve[leg, index]
            position, mode = state.spool[leg, index], faults.valve[leg, index]
            if mode != JAMMED:
                fraction = faults.spool[leg, index] if mode == OVERRIDE else command[leg]
                drive = fraction if mode == OVERRIDE else state.drive[leg, index]
                play = 0.0 if mode == OVERRIDE else state.play[leg, index]
                drive, play, position = spool(valve, is_last, fraction, drive, play, position)
                if is_last:
                    state.drive[leg, index] = drive
                    state.play[leg, index] = play
                    state.spool[leg, index] = position
            if head >= valve.threshold_pressure:
                port = (1.0 - isolation) * opening(valve, position)
                if port >= 0.0:
                    cap_in += port * valve.cap_gain
                    rod_out += port * valve.rod_gain
                else:
                    cap_out -= port * valve.cap_gain
                    rod_in -= port * valve.rod_gain
        if isolation > 0.0:
            cap_out += isolation * cylinder.settle_gain
            rod_out += isolation * cylinder.settle_rod_gain
        if cylinder.cushion_length > 0.0:
            half = cylinder.half_stroke
            first, second = hydraulics.valve[leg, 0], hydraulics.valve[leg, 1]
            cap_gain = first.cap_gain + second.cap_gain
            rod_gain = first.rod_gain + second.rod_gain
            cap_out = throttled_gain(cylinder, half + extension, cap_out, cap_gain)
            rod_out = throttled_gain(cylinder, half - extension, rod_out, rod_gain)
        pair.cap_in, pair.cap_out, pair.rod_in, pair.rod_out = cap_in, cap_out, rod_in, rod_out


@inlined
def _guess_stage(state, is_last, weight_ratio, lowest_pressure):  # type: ignore[no-untyped-def]
    """Write known contents of a stage, and guesses: pressures go on as in the last one."""
    stage, network = state.stage, state.supply
    for leg in range(state.pressure.shape[0]):
        pair = stage.chambers[leg]
        cap, rod = state.pressure[leg, CAP], state.pressure[leg, ROD]
        if is_last:
            pair.cap_known += weight_ratio * (pair.cap_content - pair.cap_known)
            pair.rod_known += weight_ratio * (pair.rod_content - pair.rod_known)
            pair.cap = max(cap + (pair.cap - cap) / _GAMMA, lowest_pressure)
            pair.rod = max(rod + (pair.rod - rod) / _GAMMA, lowest_pressure)
        else:
            pair.cap_known, pair.rod_known = state.content[leg, CAP], state.content[leg, ROD]
            pair.cap = max(cap + _GAMMA * pair.cap_change, lowest_pressure)
            pair.rod = max(rod + _GAMMA * pair.rod_change, lowest_pressure)
    for node in range(INTEGRATED):
        if is_last:
            stage.known[node] += weight_ratio * (stage.node[node] - stage.known[node])
        else:
            stage.known[node] = network[node]
            stage.node[node] = network[node]


@inlined
def _add_energies(hydraulics, energy, stage, time, motion_share, start_extension, end_extension):  # type: ignore[no-untyped-def]
    """Add to the energies what a stage passes in its time, over its share of the motion."""
    for i in range(len(POWERS)):
        energy[i] += time * stage.power[i]
    for leg in range(start_extension.shape[0]):
        pair = stage.chambers[leg]
        load = force(hydraulics.cylinder[leg], pair.cap, pair.rod)
        energy[_MECHANICAL] += motion_share * load * (end_extension[leg] - start_extension[leg])


@inlined
def _solve_in_one_stage(hydraulics, state, start_extension, end_extension):  # type: ignore[no-untyped-def]
    """Take the step again by the implicit Euler method; whether it converged."""
    step, stage, energy = hydraulics.step, state.stage, state.energy
    for i in range(energy.shape[0]):
        energy[i] = stage.energy[i]
    for leg in range(start_extension.shape[0]):
        pair = stage.chambers[leg]
        pair.cap_known, pair.rod_known = state.content[leg, CAP], state.content[leg, ROD]
    for node in range(INTEGRATED):
        stage.known[node] = state.supply[node]
    cylinders, laminar = hydraulics.cylinder, hydraulics.laminar
    iterations = solve(cylinders, hydraulics.oil, hydraulics.supply, laminar, stage, step)
    # Work by the mean of both ends, as the mechanics does it.
    _add_energies(hydraulics, energy, stage, step, 0.5, start_extension, end_extension)
    for leg in range(start_extension.shape[0]):
        pressure = state.pressure[leg]
        load = force(cylinders[leg], pressure[CAP], pressure[ROD])
        energy[_MECHANICAL] += 0.5 * load * (end_extension[leg] - start_extension[leg])
    return iterations >= 0


@inlined
def _accept_step(hydraulics, state, start_extension, end_extension):  # type: ignore[no-untyped-def]
    """Write the results of the last stage to the state, and slide the friction contacts."""
    step, stage, network, energy = hydraulics.step, state.stage, state.supply, state.energy
    for leg in range(start_extension.shape[0]):
        pair = stage.chambers[leg]
        pair.cap_change = pair.cap - state.pressure[leg, CAP]
        pair.rod_change = pair.rod - state.pressure[leg, ROD]
        state.pressure[leg, CAP], state.pressure[leg, ROD] = pair.cap, pair.rod
        state.content[leg, CAP], state.content[leg, ROD] = pair.cap_content, pair.rod_content
        travel = end_extension[leg] - start_extension[leg]
        state.bristle[leg], state.friction[leg] = slide(
            hydraulics.friction[leg], state.bristle[leg], travel / step, step
        )
        energy[_FRICTION] += state.friction[leg] * travel
    for node in range(INTEGRATED):
        network[node] = stage.node[node]
    manifolds = stage.manifolds[0]
    network[SUPPLY_PRESSURE], network[RETURN_PRESSURE] = manifolds.high, manifolds.low
    network[GAS] = manifolds.gas


@inlined
def advance(hydraulics, state, faults, command, start_extension, end_extension, is_stopped=False):  # type: ignore[no-untyped-def]
    """Advance all actuators and the supply by one mechanical step; whether both stages converged.

    Command fractions (n,) are held over the step, between extensions (n,) [m] at its start and
    end. If `is_stopped`, in an emergency stop, the supply closes and the settle valves open.
    """
    step, stage, energy = hydraulics.step, state.stage, state.energy
    cylinders, oil = hydraulics.cylinder, hydraulics.oil
    weight, lowest_pressure = _GAMMA * step, least_pressure(oil)
    supply, network, plant_faults = hydraulics.supply, state.supply, faults.plant[0]
    manifolds = stage.manifolds[0]
    manifolds.gas, manifolds.gas_rise = gas_pressure(supply, network[ACCUMULATOR])
    manifolds.gas_oil = network[ACCUMULATOR]
    manifolds.running = 0.0 if plant_faults.pump_lost > 0.0 else 1.0
    manifolds.bank = max(supply.accumulators - plant_faults.accumulators_lost, 0.0)
    manifolds.burst = supply.jet * plant_faults.burst_area
    manifolds.high, manifolds.low = network[SUPPLY_PRESSURE], network[RETURN_PRESSURE]
    travel = supply.isolation_rate * (step if is_stopped else -step)
    network[ISOLATION] = min(max(network[ISOLATION] + travel, 0.0), 1.0)
    for i in range(energy.shape[0]):
        stage.energy[i] = energy[i]
    is_torn, has_converged = False, True
    for leg in range(start_extension.shape[0]):
        is_torn |= state.pressure[leg, CAP] < _VACUUM or state.pressure[leg, ROD] < _VACUUM
    for is_last in (False, True):
        _set_ports(hydraulics, state, faults, is_last, command, start_extension, end_extension)
        _guess_stage(state, is_last, (step - weight) / weight, lowest_pressure)
        iterations = solve(cylinders, oil, supply, hydraulics.laminar, stage, weight)
        has_converged &= iterations >= 0
        time = weight if is_last else step - weight
        _add_energies(hydraulics, energy, stage, time, time / step, start_extension, end_extension)
        for leg in range(start_extension.shape[0]):
            is_torn |= stage.chambers[leg].cap < _VACUUM or stage.chambers[leg].rod < _VACUUM
    if is_torn:
        has_converged = _solve_in_one_stage(hydraulics, state, start_extension, end_extension)
    _accept_step(hydraulics, state, start_extension, end_extension)
    return has_converged


@inlined
def write_loads(cylinders, pressure, friction, load):  # type: ignore[no-untyped-def]
    """Write the axial forces [N], (n,), of all actuators on their rods, friction taken off."""
    for leg in range(load.shape[0]):
        axial_force = force(cylinders[leg], pressure[leg, CAP], pressure[leg, ROD])
        load[leg] = axial_force - friction[leg]
