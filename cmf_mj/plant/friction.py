"""Friction of seals and bearings: stick and slip, regularised (LuGre).

A contact is a field of bristles of mean deflection z. With v the sliding speed,

    dz/dt = v - |v| z / Z(v),    Z(v) = d (1 + (Fb / Fc - 1) exp(-(v / vs)^2))
    F = (Fc / d) (z + t dz/dt) + b v

Fc is the Coulomb force, Fb the breakaway force, vs the Stribeck speed, d the presliding travel, t
a damping time that keeps a sticking contact from ringing. A load below Fb stops at a deflection of
about d and stays; above it the contact slips. z follows its equation exactly for a constant speed
over a step, so that no step is too long. Source: Canudas de Wit, Olsson, Astrom, Lischinsky (1995).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cmf_mj.core.arrays import compiled_params, record_array
from cmf_mj.core.compiled import compiled
from cmf_mj.plant.parameters import HydraulicParameters

_DAMPING_TIME = 0.005
"""t [s]."""


class Friction(NamedTuple):
    """Compiled parameters of one contact."""

    coulomb_friction: float  #: Fc [N].
    excess: float  #: Fb / Fc - 1.
    stribeck_speed: float  #: vs [m/s].
    presliding: float  #: d [m].
    viscous_friction: float  #: b [N s/m].


def make_frictions(parameters: HydraulicParameters, actuators: Sequence[str]) -> np.recarray:
    """Derive the contacts of all actuators from a parameter set, (n,) of `Friction`."""

    def one(actuator: str) -> Friction:
        numbers = parameters.actuator(actuator)
        coulomb, breakaway = numbers["coulomb_friction"].si, numbers["breakaway_friction"].si
        excess = breakaway / coulomb - 1.0 if coulomb > 0.0 else 0.0
        return compiled_params(Friction, numbers, excess=excess)

    return record_array(Friction, map(one, actuators))


@compiled
def slide(friction, bristle, speed, step):  # type: ignore[no-untyped-def]
    """Bristle deflection z [m] after sliding at a constant speed, and the force F [N] there."""
    viscous = friction.viscous_friction * speed
    coulomb = friction.coulomb_friction
    if coulomb == 0.0:
        return 0.0, viscous
    ratio = speed / friction.stribeck_speed
    fade = np.exp(-min(ratio * ratio, 700.0))
    largest = friction.presliding * (1.0 + friction.excess * fade)
    if speed != 0.0:
        ends = largest if speed > 0.0 else -largest
        bristle = ends + (bristle - ends) * np.exp(-abs(speed) * step / largest)
    rate = speed - abs(speed) * bristle / largest
    stiffness = coulomb / friction.presliding
    return bristle, stiffness * (bristle + _DAMPING_TIME * fade * rate) + viscous
