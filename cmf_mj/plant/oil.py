"""Oil: how much of it a volume holds at a pressure, and the energy it carries.

The content C of a volume V is the volume that its oil alone, without gas, fills at atmospheric
pressure: C = V r(p), with p gauge. At p = 0 it is V / (1 + e): entrained gas fills the rest. Here

    1 / r(p) = 1 / (1 + z + z^2 / 2) + g(p),    z = p / beta
    g(p) = e (pa / (p + pa))^(1/n)                       entrained gas, share e
         + c pa (1 / (p + pa) - 1 / pa),   p < 0         gas released below the atmosphere, share c

The first term is exp(-p / beta), a constant bulk modulus, to third order. The second is off by
default. The third is the cavitation floor: a chamber torn open fills with gas and its absolute
pressure stays above 0, whatever its volume.

Oil that passes from p1 to p2 carries the enthalpy h per content, so that a loss is Q (h1 - h2):

    h(p) = integral of 1 / r,    energy stored in a volume  U = C h - p V
"""

from typing import NamedTuple

import numpy as np

from cmf_mj.core.arrays import compiled_params
from cmf_mj.core.compiled import compiled
from cmf_mj.plant.parameters import HydraulicParameters

ATMOSPHERE = 101325.0  #: Standard atmosphere [Pa].


class Oil(NamedTuple):
    """Compiled parameters of the oil."""

    bulk_modulus: float  #: beta [Pa].
    compliance: float  #: 1 / beta [1/Pa].
    entrained_gas: float  #: e, volume share at atmospheric pressure.
    gas_exponent: float  #: n.
    released: float  #: c pa [Pa]; 0 without a cavitation floor.


def make_oil(parameters: HydraulicParameters) -> Oil:
    """Derive the oil from a parameter set."""
    compliance = 1.0 / parameters.bulk_modulus.si
    released = parameters.cavitation_gas.si * ATMOSPHERE
    return compiled_params(Oil, parameters, compliance=compliance, released=released)


@compiled
def density(oil, pressure):  # type: ignore[no-untyped-def]
    """r(p), content per volume, and its slope [1/Pa]."""
    z = pressure * oil.compliance
    ratio = 1.0 + z + 0.5 * z * z
    slope = (1.0 + z) * oil.compliance
    if oil.entrained_gas == 0.0 and (pressure >= 0.0 or oil.released == 0.0):
        return ratio, slope
    volume = 1.0 / ratio
    volume_slope = -slope * volume * volume
    absolute = pressure + ATMOSPHERE
    if oil.entrained_gas > 0.0:
        gas = oil.entrained_gas * (ATMOSPHERE / absolute) ** (1.0 / oil.gas_exponent)
        volume += gas
        volume_slope -= gas / (oil.gas_exponent * absolute)
    if pressure < 0.0:
        volume += oil.released * (1.0 / absolute - 1.0 / ATMOSPHERE)
        volume_slope -= oil.released / (absolute * absolute)
    ratio = 1.0 / volume
    return ratio, -volume_slope * ratio * ratio


@compiled
def least_pressure(oil):  # type: ignore[no-untyped-def]
    """Gauge pressure that no iteration may go below [Pa]: just above vacuum where gas fills it."""
    if oil.entrained_gas > 0.0 or oil.released > 0.0:
        return -ATMOSPHERE + 1e-3
    return -np.inf


@compiled
def enthalpy(oil, pressure):  # type: ignore[no-untyped-def]
    """h(p) [J/m^3 of content].

    The integral of the third term of 1 / r, the gas released, is left out: with the shipped share
    of 1e-6 it is less than 2 J/m^3 in size, down to `least_pressure`.
    """
    z = pressure * oil.compliance
    value = pressure * (1.0 - z * (0.5 - z * (1.0 / 6.0)))
    if oil.entrained_gas > 0.0:
        exponent = 1.0 - 1.0 / oil.gas_exponent
        ratio = (pressure + ATMOSPHERE) / ATMOSPHERE
        if exponent < 1e-9:
            value += oil.entrained_gas * ATMOSPHERE * np.log(ratio)
        else:
            value += oil.entrained_gas * ATMOSPHERE * (ratio**exponent - 1.0) / exponent
    return value
