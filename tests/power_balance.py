"""Where the energy and the oil of a run are, row by row.

    pump + accumulators = losses + work on the pistons + rise of what is stored by compression
    oil in chambers, manifolds, accumulators and out at the tank = constant

Both close to rounding; what is left is the residual. Two things open the first: a piston in the
last twenty `minimum_gap` before its stop works on a volume that stays, and a chamber torn open
hides its oil: at a pressure below the atmosphere a pascal is a great deal of it, so that those rows
of `residual` and `oil` are not a number.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj import Record
from cmf_mj.plant.cylinder import volumes
from cmf_mj.plant.hydraulics import ENERGIES
from cmf_mj.plant.oil import Oil, density, enthalpy
from cmf_mj.plant.plant import Plant


def stored(oil: Oil, content: float, pressure: float, volume: float) -> float:
    """U [J], energy of the oil in a volume, 0 for oil at atmospheric pressure."""
    return float(content * enthalpy(oil, pressure) - pressure * volume)


class PowerBalance(NamedTuple):
    """Energies since the start [J] and oil [m^3], each (N,)."""

    delivered: NDArray[np.float64]  #: Work of pump and accumulators.
    lost: NDArray[np.float64]  #: Losses of the oil.
    work: NDArray[np.float64]  #: Work on the pistons, friction included.
    stored: NDArray[np.float64]  #: Rise of the energy of compression, and of what the tank holds.
    residual: NDArray[np.float64]  #: delivered - lost - work - stored.
    oil: NDArray[np.float64]  #: All oil, as the volume it would fill at atmospheric pressure.


def power_balance(plant: Plant, record: Record) -> PowerBalance:
    """Balance energy and oil of a run of the plant, a record of `simulate` or `drive`."""
    oil, supply = plant.hydraulics.oil, plant.hydraulics.supply
    energy = np.vectorize(lambda *what: stored(oil, *what))
    ratio = np.vectorize(lambda pressure: density(oil, pressure)[0])
    passed = {name: record["energy"][:, i] for i, name in enumerate(ENERGIES)}
    delivered, work = passed["pump"] + passed["accumulators"], passed["mechanical"]
    losses = ("valves", "lines", "leakage", "relief", "burst")
    lost = np.sum([passed[name] for name in losses], axis=0)
    total = np.sum([record[f"{name}_content"] for name in ("supply", "return", "tank")], axis=0)
    total += supply.accumulators * record["accumulator_oil"]
    kept = record["tank_content"] * enthalpy(oil, supply.return_pressure)
    for name, volume in (("supply", supply.supply_volume), ("return", supply.return_volume)):
        kept += energy(record[f"{name}_content"], record[f"{name}_pressure"], volume)
    for leg, cylinder in enumerate(plant.hydraulics.cylinder):
        room = np.array([volumes(cylinder, x) for x in record["leg_extension"][:, leg]])
        for side, name in enumerate(("cap", "rod")):
            pressure = record[f"{name}_pressure"][:, leg]
            content = room[:, side] * ratio(pressure)
            total += content
            kept += energy(content, pressure, room[:, side])
    torn = np.minimum(record["cap_pressure"], record["rod_pressure"]).min(axis=1) < 0.0
    total[torn] = np.nan
    rise = np.where(torn, np.nan, kept - kept[0])
    return PowerBalance(delivered, lost, work, rise, delivered - lost - work - rise, total)
