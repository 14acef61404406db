"""Where the energy and the oil of a run are: balances of a record, row by row.

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

from cmf_mj.core.compiled import allocating
from cmf_mj.core.errors import InputError
from cmf_mj.plant.cylinder import volumes
from cmf_mj.plant.hydraulics import ENERGIES
from cmf_mj.plant.oil import density, enthalpy, stored
from cmf_mj.plant.plant import Plant
from cmf_mj.plant.solver import FLOWS
from cmf_mj.record.record import Record


class PowerBalance(NamedTuple):
    """Energies since the start [J] and oil [m^3], each (N,)."""

    delivered: NDArray[np.float64]  #: Work of pump and accumulators.
    lost: NDArray[np.float64]  #: Losses of the oil, `FLOWS` but for the first two.
    work: NDArray[np.float64]  #: Work on the pistons, friction included.
    stored: NDArray[np.float64]
    """Rise of the energy of compression, and of what the tank holds under return pressure; NaN
    where a chamber is torn open, as `residual` and `oil`."""
    residual: NDArray[np.float64]  #: delivered - lost - work - stored.
    oil: NDArray[np.float64]  #: All oil, as the volume it would fill at atmospheric pressure.


def power_balance(plant: Plant, record: Record) -> PowerBalance:
    """Balance energy and oil of a run of the plant, a record of `simulate` or `drive`."""
    described = plant.describe()
    for field in ("model_digest", "hydraulic_parameters"):
        if record.metadata[field] != described[field]:
            raise InputError(f"record: its {field} is not that of {plant.name}")
    hydraulics = plant.hydraulics
    passed = {name: record["energy"][:, i] for i, name in enumerate(ENERGIES)}
    delivered = passed["pump"] + passed["accumulators"]
    lost = np.sum([passed[name] for name in FLOWS[2:]], axis=0)
    kept = record["tank_content"] * enthalpy(hydraulics.oil, hydraulics.supply.return_pressure)
    oil = (
        record["supply_content"]
        + record["return_content"]
        + record["tank_content"]
        + hydraulics.supply.accumulators * record["accumulator_oil"]
    )
    supply, oil_law = hydraulics.supply, hydraulics.oil
    for name, volume in (("supply", supply.supply_volume), ("return", supply.return_volume)):
        _manifold(oil_law, volume, record[f"{name}_content"], record[f"{name}_pressure"], kept)
    legs = record["leg_extension"], record["cap_pressure"], record["rod_pressure"]
    _chambers(hydraulics, *legs, oil, kept)
    torn = np.minimum(record["cap_pressure"], record["rod_pressure"]).min(axis=1) < 0.0
    oil[torn] = np.nan
    rise = np.where(torn, np.nan, kept - kept[0])
    work = passed["mechanical"]
    return PowerBalance(delivered, lost, work, rise, delivered - lost - work - rise, oil)


@allocating
def _manifold(oil, volume, content, pressure, kept):  # type: ignore[no-untyped-def]
    """Add the energy stored in a manifold to each row of `kept`."""
    for row in range(kept.shape[0]):
        kept[row] += stored(oil, content[row], pressure[row], volume)


@allocating
def _chambers(hydraulics, extension, cap_pressure, rod_pressure, total, kept):  # type: ignore[no-untyped-def]
    """Add oil and energy stored in the chambers to each row of `total` and `kept`."""
    oil = hydraulics.oil
    for row in range(total.shape[0]):
        for leg in range(extension.shape[1]):
            cap, rod = volumes(hydraulics.cylinder[leg], extension[row, leg])
            for volume, pressure in (
                (cap, cap_pressure[row, leg]),
                (rod, rod_pressure[row, leg]),
            ):
                content = volume * density(oil, pressure)[0]
                total[row] += content
                kept[row] += stored(oil, content, pressure, volume)
