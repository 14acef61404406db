"""Friction of seals and bearings: stick and slip, regularised (LuGre).

A contact is a field of bristles of mean deflection z. With v the sliding speed,

    dz/dt = v - |v| z / Z(v),    Z(v) = d (1 + (Fb / Fc - 1) exp(-(v / vs)^2))
    F = (Fc / d) (z + t dz/dt) + b v

Fc is the Coulomb force, Fb the breakaway force, vs the Stribeck speed, d the presliding travel, t
a damping time that keeps a sticking contact from ringing. A load below Fb stops at a deflection of
about d and stays; above it the contact slips. z follows its equation exactly for a constant speed
over a step, so that no step is too long. Source: Canudas de Wit, Olsson, Astrom, Lischinsky (1995).

A contact has no slope at rest, but two about motions that are stated. Legs that move much less than
d stick: F = (Fc / d) (x + t v). Legs that slide through many d, at the speed V sin(w t), feel on
average over a period (describing function of sliding, with Dawson's integral D)

    F = (4 Fc / (pi V)) (1 + (Fb / Fc - 1) D(V / vs) vs / V) v.

Both leave b v, which is linear as it is.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import dawsn

from cmf_mj.core.arrays import compiled_params, record_array
from cmf_mj.core.compiled import compiled
from cmf_mj.core.errors import InputError
from cmf_mj.plant.parameters import HydraulicParameters

_DAMPING_TIME = 0.005
"""t [s]."""

Contact = Literal["none", "stuck"] | float
"""How dry friction enters what is linear: left out, stuck, or sliding at an amplitude [m/s]."""

CONTACTS = "'none' (left out), 'stuck', or the speed amplitude of sliding legs in m/s"
"""What a `Contact` may be, in words."""


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


def contact_text(contact: Contact | None) -> str:
    """How dry friction entered, in a word or as a speed."""
    return contact or "none" if isinstance(contact, str | None) else f"{contact:g} m/s"


class Slope(NamedTuple):
    """Dry friction of n actuators about a motion."""

    stiffness: NDArray[np.float64]  #: [N/m], (n,).
    damping: NDArray[np.float64]  #: Without the viscous part [N s/m], (n,).


def friction_slope(friction: np.recarray, contact: Contact) -> Slope:
    """Slope of the dry friction of contacts (n,) of `Friction` that are in a state.

    Raises `InputError` for a contact that is none of `CONTACTS`.
    """
    still = np.zeros(len(friction))
    force = friction.coulomb_friction
    if contact == "none":
        return Slope(still, still)
    if contact == "stuck":
        stiffness = np.divide(force, friction.presliding, out=still, where=force > 0.0)
        return Slope(stiffness, _DAMPING_TIME * stiffness)
    if isinstance(contact, str) or not 0.0 < contact < np.inf:
        raise InputError(f"friction: {contact!r} is refused; allowed: {CONTACTS}")
    ratio = np.divide(contact, friction.stribeck_speed, out=still + 1.0, where=force > 0.0)
    slides = 1.0 + friction.excess * dawsn(ratio) / ratio
    return Slope(still, 4.0 * force / (np.pi * contact) * slides)
