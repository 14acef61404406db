"""Double-acting cylinders: force, chamber volumes, stiffness, pressures of a held load, friction.

With x the extension from neutral, h the half stroke and D the dead volumes,

    F = A_cap p_cap - A_rod p_rod,  V_cap = A_cap (h + x) + D_cap,  V_rod = A_rod (h - x) + D_rod
    leakage L (p_cap - p_rod) from cap to rod, B (p_rod - Pt) from the rod bearing to the return

so the oil is a spring of stiffness K(x) = beta (A_cap^2 / V_cap + A_rod^2 / V_rod), and K(0) over
7200 lbm is (71.00 rad/s)^2 without dead volumes, the leg mode of Eq 4.1.

Near a stop a chamber keeps the minimum gap g of oil, so that no volume vanishes. With s the travel
left, it is s + g (1 - s / e)^2 long over the last e = 20 g: it displaces nine tenths of its oil up
to the stop. Beyond the stop this fades over another g, to a length of 0.55 g, without chatter.

A cushion throttles what leaves a chamber over the last length c before the stop: an orifice of
gain G_stop / e in series with the valve, e = (c - gap) / c from 0 at the cushion's edge to 1 at the
stop. What enters passes a check valve.

The settle valve of an emergency stop joins both chambers to the return past the servo-valves: the
cap through an orifice that lowers the settle load at the settle speed, the rod wide open.

**Friction** of seals and bearings is regularised stick and slip (LuGre): a field of bristles of
mean deflection z. With v the sliding speed,

    dz/dt = v - |v| z / Z(v),    Z(v) = d (1 + (Fb / Fc - 1) exp(-(v / vs)^2))
    F = (Fc / d) (z + t exp(-(v / vs)^2) dz/dt) + b v

Fc is the Coulomb force, Fb the breakaway force, vs the Stribeck speed, d the presliding travel, t
a damping time, which counts less the faster the contact slides. A load below Fb stops at a
deflection of about d; above it the contact slips. z is exact for a constant speed over a step.
Source: Canudas de Wit, Olsson, Astrom, Lischinsky (1995).

A contact has no slope at rest, but two about motions that are stated. Legs that move much less than
d stick: F = (Fc / d) (x + t v). Legs that slide through many d, at the speed V sin(w t), feel on
average over a period (describing function of sliding, with Dawson's integral D)

    F = (4 Fc / (pi V)) (1 + (Fb / Fc - 1) D(V / vs) vs / V) v.

Both leave b v, which is linear as it is.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import dawsn

from cmf_mj.core.arrays import compiled_params, real, record_array
from cmf_mj.core.compiled import compiled
from cmf_mj.core.errors import InputError
from cmf_mj.core.quantity import Quantity
from cmf_mj.plant.oil import density, make_oil
from cmf_mj.plant.parameters import HydraulicParameters, cap_area, piston_leakage, rod_area

CAP, ROD = 0, 1  #: Columns of pressures, contents and volumes.

_SETTLE_RATIO = 10.0  #: Settle valve: flow gain of the rod's side over the cap's, per area.

_APPROACH = 20.0  #: Travel e before the stop over which a chamber nears its gap g, in gaps.

_DAMPING_TIME = 0.005  #: t of friction [s].

Contact = Literal["none", "stuck"] | float
"""How dry friction enters what is linear: left out, stuck, or sliding at an amplitude [m/s]."""

CONTACTS = "'none' (left out), 'stuck', or the speed amplitude of sliding legs in m/s"
"""What a `Contact` may be, in words."""


class Cylinder(NamedTuple):
    """Compiled parameters of one cylinder."""

    cap_area: float  #: A_cap [m^2].
    rod_area: float  #: A_rod [m^2].
    half_stroke: float  #: h [m].
    minimum_gap: float  #: g, length of a chamber at its stop [m].
    leakage: float  #: L [m^3/s/Pa].
    bearing_leakage: float  #: B [m^3/s/Pa].
    cushion_length: float  #: c [m].
    cushion_opening: float  #: G_stop over the gain of both valves.
    supply_hose: float  #: Laminar resistance from the manifold to the valves [Pa s/m^3].
    return_hose: float  #: Laminar resistance from the valves to the return manifold [Pa s/m^3].
    settle_gain: float  #: Settle valve on the cap's side [m^3/s/sqrt(Pa)].
    settle_rod_gain: float  #: Settle valve on the rod's side [m^3/s/sqrt(Pa)].
    cap_dead_volume: float  #: D_cap [m^3].
    rod_dead_volume: float  #: D_rod [m^3].
    cap_throttle: float  #: Laminar resistance between the valves and the cap chamber [Pa s/m^3].
    rest_pressure: float  #: Rod pressure at the start without leakage [Pa]; 0: null of the valve.


def make_cylinders(parameters: HydraulicParameters, actuators: Sequence[str]) -> np.recarray:
    """Derive the cylinders of all actuators from a parameter set, (n,) of `Cylinder`."""
    is_network = parameters.supply == "network"
    # Flows count content; leak_rate is what a volume at mid pressure loses.
    mid_pressure = 0.5 * (parameters.supply_pressure.si + parameters.return_pressure.si)
    mid_density = density(make_oil(parameters), mid_pressure)[0]

    def cylinder_of(numbers: dict[str, Quantity]) -> Cylinder:
        cap, rod = cap_area(numbers), rod_area(numbers)
        load = numbers["settle_load"].si
        gain = numbers["settle_speed"].si * cap / np.sqrt(load / cap) if load > 0.0 else 0.0
        return compiled_params(
            Cylinder,
            numbers,
            cap_area=cap,
            rod_area=rod,
            leakage=piston_leakage(numbers) * mid_density,
            supply_hose=numbers["supply_hose"].si * is_network,
            return_hose=numbers["return_hose"].si * is_network,
            settle_gain=gain,
            settle_rod_gain=_SETTLE_RATIO * gain * rod / cap,
        )

    return record_array(Cylinder, [cylinder_of(parameters.actuator(name)) for name in actuators])


@compiled
def force(cylinder, cap_pressure, rod_pressure):  # type: ignore[no-untyped-def]
    """Axial force on the rod, positive extending [N]."""
    return cylinder.cap_area * cap_pressure - cylinder.rod_area * rod_pressure


@compiled
def _chamber_length(cylinder, travel):  # type: ignore[no-untyped-def]
    """Length of a chamber with this travel left before its stop [m]."""
    approach = _APPROACH * cylinder.minimum_gap
    if travel >= approach:
        return travel
    gap = cylinder.minimum_gap
    if travel < 0.0:
        overtravel = min(-travel, gap)
        return gap - (1.0 - 2.0 / _APPROACH) * (overtravel - 0.5 * overtravel * overtravel / gap)
    share = 1.0 - travel / approach
    return travel + gap * share * share


@compiled
def volumes(cylinder, extension):  # type: ignore[no-untyped-def]
    """Chamber volumes (V_cap, V_rod) [m^3] at an extension from neutral [m]."""
    cap = _chamber_length(cylinder, cylinder.half_stroke + extension)
    rod = _chamber_length(cylinder, cylinder.half_stroke - extension)
    return (
        cylinder.cap_area * cap + cylinder.cap_dead_volume,
        cylinder.rod_area * rod + cylinder.rod_dead_volume,
    )


@compiled
def throttled_gain(cylinder, travel, gain, valve_gain):  # type: ignore[no-untyped-def]
    """Outflow gain of a chamber behind its cushion.

    `travel` is what is left before the stop [m], `gain` that of the paths out of the chamber
    [m^3/s/sqrt(Pa)], `valve_gain` that of both valves fully open.
    """
    cushion = cylinder.cushion_length
    if travel >= cushion or gain == 0.0:
        return gain
    closing = min((cushion - travel) / cushion, 1.0)
    ratio = gain * closing / (cylinder.cushion_opening * valve_gain)
    return gain / np.sqrt(1.0 + ratio * ratio)


def _broadcast_to_cylinders(
    name: str, values: ArrayLike, cylinder: Cylinder | np.recarray
) -> NDArray[np.float64]:
    """Real numbers, for several cylinders in one number each."""
    array, shape = real(name, values), np.shape(cylinder.cap_area)
    if shape and array.shape not in ((), shape):
        raise InputError(f"{name}: shape is {array.shape}; allowed: {shape}, one a cylinder")
    return np.broadcast_to(array, shape) if shape else array


def stiffness(
    cylinder: Cylinder | np.recarray, bulk_modulus: float, extension: ArrayLike
) -> NDArray[np.float64]:
    """K(x), stiffness -dF/dx of the enclosed oil [N/m], at extensions [m].

    Those of one cylinder have any shape; of cylinders (n,) there is one for each, (n,), or for all.
    """
    x = _broadcast_to_cylinders("extension", extension, cylinder)
    gap, half = np.asarray(cylinder.minimum_gap), cylinder.half_stroke
    approach = _APPROACH * gap

    def compliance(travel: NDArray[np.float64], dead_length: ArrayLike) -> NDArray[np.float64]:
        """Fall of a chamber's volume per travel, relative [1/m]; `dead_length` is D / A [m]."""
        share = 1.0 - np.clip(travel, 0.0, approach) / approach
        overtravel = np.clip(-travel, 0.0, gap)
        end_slope = 1.0 - 2.0 * gap / approach
        length = np.maximum(travel, 0.0) + gap * share * share
        length = length - end_slope * (overtravel - 0.5 * overtravel * overtravel / gap)
        slope = (1.0 - 2.0 * gap / approach * share) * (1.0 - overtravel / gap)
        return slope / (length + dead_length)

    cap, rod = cylinder.cap_area, cylinder.rod_area
    return bulk_modulus * (
        cap * compliance(half + x, cylinder.cap_dead_volume / cap)
        + rod * compliance(half - x, cylinder.rod_dead_volume / rod)
    )


def holding_pressures(
    cylinder: Cylinder | np.recarray, load: ArrayLike, supply: float, return_pressure: float
) -> NDArray[np.float64]:
    """Pressures (n, 2) of cap and rod that hold static loads [N] with the valve closed.

    Loads (n,) that press the leg together are positive; the cylinder is one, or one for each.
    Piston leakage ends at p_cap = p_rod = F / (A_cap - A_rod). Without leakage any pair with the
    right force stays, and with leakage and equal areas none does: then `rest_pressure` is taken, or
    where it is 0 the valve's own null p_cap + p_rod = Ps + Pt. The pair is kept between return and
    supply pressure as far as the load allows; loads beyond the stall forces are refused.
    """
    loads = np.atleast_1d(_broadcast_to_cylinders("load", load, cylinder))
    if loads.ndim != 1:
        raise InputError(f"load: shape is {loads.shape}; allowed: (n,)")
    cap_area, rod_area = cylinder.cap_area, cylinder.rod_area
    lowest = np.broadcast_to(cap_area * return_pressure - rod_area * supply, loads.shape)
    highest = np.broadcast_to(cap_area * supply - rod_area * return_pressure, loads.shape)
    for leg in np.flatnonzero(~((lowest <= loads) & (loads <= highest))):
        raise InputError(
            f"static load of leg {leg + 1}: {loads[leg]:.0f} N cannot be held by a supply of "
            f"{supply:.0f} Pa; allowed: {lowest[leg]:.0f} to {highest[leg]:.0f} N"
        )
    area_difference = cap_area - rod_area
    null_pressure = (cap_area * (supply + return_pressure) - loads) / (cap_area + rod_area)
    rod_pressure = np.where(
        (cylinder.leakage > 0.0) & (area_difference > 0.0),
        loads / np.where(area_difference > 0.0, area_difference, 1.0),
        np.where(cylinder.rest_pressure > 0.0, cylinder.rest_pressure, null_pressure),
    )
    # p_rod must lie in [Pt, Ps] and so must p_cap = (F + A_rod p_rod) / A_cap.
    lowest_rod = np.maximum(return_pressure, (cap_area * return_pressure - loads) / rod_area)
    highest_rod = np.minimum(supply, (cap_area * supply - loads) / rod_area)
    rod_pressure = np.clip(rod_pressure, lowest_rod, highest_rod)
    return np.column_stack([(loads + rod_area * rod_pressure) / cap_area, rod_pressure])


class Friction(NamedTuple):
    """Compiled parameters of one contact."""

    coulomb_friction: float  #: Fc [N].
    excess: float  #: Fb / Fc - 1.
    stribeck_speed: float  #: vs [m/s].
    presliding: float  #: d [m].
    viscous_friction: float  #: b [N s/m].


def make_frictions(parameters: HydraulicParameters, actuators: Sequence[str]) -> np.recarray:
    """Derive the contacts of all actuators from a parameter set, (n,) of `Friction`."""

    def friction_of(actuator: str) -> Friction:
        numbers = parameters.actuator(actuator)
        coulomb, breakaway = numbers["coulomb_friction"].si, numbers["breakaway_friction"].si
        excess = breakaway / coulomb - 1.0 if coulomb > 0.0 else 0.0
        return compiled_params(Friction, numbers, excess=excess)

    return record_array(Friction, map(friction_of, actuators))


@compiled
def slide(friction, bristle, speed, step):  # type: ignore[no-untyped-def]
    """Bristle deflection z [m] after sliding at a constant speed, and the force F [N] there."""
    viscous_force = friction.viscous_friction * speed
    coulomb = friction.coulomb_friction
    if coulomb == 0.0:
        return 0.0, viscous_force
    ratio = speed / friction.stribeck_speed
    fade = np.exp(-min(ratio * ratio, 700.0))
    largest = friction.presliding * (1.0 + friction.excess * fade)
    if speed != 0.0:
        limit = largest if speed > 0.0 else -largest
        bristle = limit + (bristle - limit) * np.exp(-abs(speed) * step / largest)
    rate = speed - abs(speed) * bristle / largest
    bristle_stiffness = coulomb / friction.presliding
    return bristle, bristle_stiffness * (bristle + _DAMPING_TIME * fade * rate) + viscous_force


def contact_text(contact: Contact | None) -> str:
    """How dry friction entered, in a word or as a speed."""
    if contact is None:
        return "none"
    return contact if isinstance(contact, str) else f"{contact:g} m/s"


class FrictionSlope(NamedTuple):
    """Dry friction of n actuators about a motion."""

    stiffness: NDArray[np.float64]  #: [N/m], (n,).
    damping: NDArray[np.float64]  #: Without the viscous part [N s/m], (n,).


def friction_slope(friction: np.recarray, contact: Contact) -> FrictionSlope:
    """Slope of the dry friction of `friction`, (n,) of `Friction`, left out, stuck or sliding.

    Raises `InputError` for a contact that is none of `CONTACTS`.
    """
    zeros = np.zeros(len(friction))
    coulomb = friction.coulomb_friction
    if contact == "none":
        return FrictionSlope(zeros, zeros)
    if contact == "stuck":
        stiffness = np.divide(coulomb, friction.presliding, out=zeros, where=coulomb > 0.0)
        return FrictionSlope(stiffness, _DAMPING_TIME * stiffness)
    if isinstance(contact, str) or not 0.0 < contact < np.inf:
        raise InputError(f"friction: {contact!r} is refused; allowed: {CONTACTS}")
    ratio = np.divide(contact, friction.stribeck_speed, out=zeros + 1.0, where=coulomb > 0.0)
    stribeck_factor = 1.0 + friction.excess * dawsn(ratio) / ratio
    return FrictionSlope(zeros, 4.0 * coulomb / (np.pi * contact) * stribeck_factor)
