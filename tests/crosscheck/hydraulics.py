"""The hydraulics of a set with constant supply and no losses but friction, written a second time.

Nothing is taken from `cmf_mj.plant`: only the numbers of the parameter set are shared. There the
unknown is the oil content of a chamber, advanced by an L-stable Runge-Kutta method; here it is the
pressure, a differential equation that any integrator can take together with the mechanics:

    V r'(p) dp/dt = Q - r(p) dV/dt,    r = 1 + z + z^2 / 2,    z = p / beta
    dV_cap/dt = A_cap v,    dV_rod/dt = -A_rod v

    Q_cap =  G_cap (u+ phi(Ps - p_cap) - u- phi(p_cap - Pt)) - L (p_cap - p_rod)
    Q_rod = -G_rod (u+ phi(p_rod - Pt) - u- phi(Ps - p_rod)) + L (p_cap - p_rod)
    u+- of what is left of a spool's way beyond its overlap, sign(u) max(|u| - o, 0)
    phi(dp) = sign(dp) (sqrt(s^2 + 4 |dp|) - s) / 2

Q counts content, s is the root of half the transition pressure. Spools do not depend on anything
else, so their two lags are summed in closed form frame by frame:

    d = c + D e^{-a t},    u = c + (U - k D) e^{-b t} + k D e^{-a t},    k = b / (b - a)

with D and U the offsets of drive and spool from the held command c at the start of a frame. A seal
that slides, with the same friction at all speeds, is Dahl's contact, s from -1 to 1:

    F = -Fc s,    ds/dt = (v - |v| s) / d
"""

from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.errors import InputError
from cmf_mj.core.units import RATE
from cmf_mj.plant.parameters import HydraulicParameters

_OFF = (
    "null_bias",
    "hysteresis",
    "bearing_leakage",
    "viscous_friction",
    "cushion_length",
    "entrained_gas",
)
"""Effects that these equations leave out, and which a set must therefore have switched off."""


@numba.njit(cache=True)
def _flow(drop: float, laminar: float) -> float:
    """phi of a drop [sqrt(Pa)]."""
    size = 0.5 * (np.sqrt(laminar * laminar + 4.0 * abs(drop)) - laminar)
    return size if drop >= 0.0 else -size


@numba.njit(cache=True)
def _rates(circuit, pressure, extension, speed, spool):  # type: ignore[no-untyped-def]
    """What `Circuit.rates` gives."""
    found = np.empty_like(pressure)
    for leg in range(pressure.shape[1]):
        opens = max(abs(spool[leg]) - circuit.overlap, 0.0)
        leak = circuit.leakage[leg] * (pressure[0, leg] - pressure[1, leg])
        for side in range(2):
            p, sign = pressure[side, leg], 1.0 - 2.0 * side
            filled = (spool[leg] >= 0.0) == (side == 0)
            drop = (circuit.supply if filled else circuit.tank) - p
            flow = circuit.gain[side, leg] * opens * _flow(drop, circuit.laminar) - sign * leak
            ratio = p / circuit.bulk_modulus
            content = 1.0 + ratio + 0.5 * ratio * ratio
            yielding = (1.0 + ratio) / circuit.bulk_modulus
            length = circuit.half_stroke + sign * extension[leg]
            rate = flow / circuit.area[side, 0] - content * sign * speed[leg]
            found[side, leg] = rate / (length * yielding)
    return found


class Circuit(NamedTuple):
    """Six cylinders of one size and their valves on a constant supply."""

    area: NDArray[np.float64]  #: Piston area of cap and rod side [m^2], (2, 1).
    half_stroke: float  #: Length of a chamber at neutral [m].
    minimum_gap: float  #: Length of a chamber at its stop [m].
    gain: NDArray[np.float64]
    """Flow of both valves, fully open, per root of the drop [m^3/s/sqrt(Pa)], (2, n)."""
    leakage: NDArray[np.float64]  #: Content lost from cap to rod [m^3/s/Pa], (n,).
    bulk_modulus: float  #: [Pa].
    laminar: float  #: s [sqrt(Pa)].
    supply: float  #: Ps [Pa].
    tank: float  #: Pt [Pa].
    drive_rate: float  #: a [rad/s].
    spool_rate: float  #: b [rad/s].
    overlap: float  #: o, fraction.
    friction: float  #: Fc [N].
    presliding: float  #: d [m].

    def start_pressures(self, load: NDArray[np.float64]) -> NDArray[np.float64]:
        """Equal pressures (2, n) that hold static loads [N]: what piston leakage ends at."""
        return np.tile(load / (self.area[0, 0] - self.area[1, 0]), (2, 1))

    def forces(self, pressure: NDArray[np.float64]) -> NDArray[np.float64]:
        """Axial forces [N], (n,), of pressures (2, n)."""
        return self.area[0, 0] * pressure[0] - self.area[1, 0] * pressure[1]

    def rates(
        self,
        pressure: NDArray[np.float64],
        extension: NDArray[np.float64],
        speed: NDArray[np.float64],
        spool: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """dp/dt [Pa/s], (2, n), from pressures, extensions [m], their speeds and spools (n,)."""
        return np.asarray(_rates(self, pressure, extension, speed, spool))

    def spools(
        self, drive: NDArray[np.float64], spool: NDArray[np.float64], command: Any, parts: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Drives (n,) after a frame with a held command, and spools after each of its parts.

        Both from those at its start, (n,); spools (parts, n).
        """
        a, b = self.drive_rate, self.spool_rate
        time = np.arange(1, parts + 1)[:, None] / (parts * RATE)
        slow, fast, mixed = np.exp(-a * time), np.exp(-b * time), b / (b - a)
        share = drive - command
        own = spool - command - mixed * share
        return command + share * slow[-1], command + own * fast + mixed * share * slow

    def check(self, pressure: NDArray[np.float64], extension: NDArray[np.float64]) -> None:
        """Refuse a trajectory that has left what the equations hold for.

        Args:
            pressure: [Pa], (N, n, 2).
            extension: [m], (N, n).

        Raises:
            InputError: a chamber below atmospheric pressure, where gas is released, or a leg near
                its stop, where chambers end otherwise.
        """
        lowest = float(pressure.min())
        if not lowest >= 0.0:
            raise InputError(
                f"pressure: falls to {lowest:.0f} Pa; without released gas at least 0 Pa is allowed"
            )
        most = self.half_stroke - 20.0 * self.minimum_gap
        largest = float(np.abs(extension).max())
        if not largest <= most:
            raise InputError(
                f"extension: reaches {largest:.4f} m; clear of the stops +-{most:.4f} m is allowed"
            )


def make_circuit(parameters: HydraulicParameters) -> Circuit:
    """Derive the circuit from a parameter set, of which legs may differ in speed and leakage.

    Both valves together give `leg_speed` with half the supply pressure across each port. Leakage
    lets a force built up at neutral begin to relax at `leak_rate` = 4 beta L / (h (Ac + Ar)).

    Raises:
        InputError: the set has what these equations leave out.
    """
    values = parameters.quantities()
    if parameters.supply != "constant":
        raise InputError(f"hydraulics: {parameters.name!r} must have a constant supply")
    legs = [parameters.actuator(f"leg_{leg}") for leg in range(1, 7)]
    for name in values.keys() - {"leg_speed", "leak_rate"}:
        if any(leg[name] != values[name] for leg in legs):
            raise InputError(f"actuators: {name} must be the same for the cross-verification")
    if values["breakaway_friction"].si != values["coulomb_friction"].si:
        raise InputError("breakaway_friction: must be coulomb_friction for the cross-verification")
    for name in _OFF:
        if values[name].value != 0.0:
            raise InputError(f"{name}: {values[name]} must be 0 for the cross-verification")
    si = {name: quantity.si for name, quantity in values.items()}
    bore, rod = si["bore_diameter"], si["rod_diameter"]
    area = 0.25 * np.pi * np.array([[bore * bore], [bore * bore - rod * rod]])
    laminar = float(np.sqrt(0.5 * si["transition_pressure"]))
    half_drop = 0.5 * (si["supply_pressure"] - si["return_pressure"])
    squeezed = (si["return_pressure"] + half_drop) / si["bulk_modulus"]
    content = 1.0 + squeezed + 0.5 * squeezed * squeezed
    drop = float(_flow(half_drop, laminar))
    speed, rate = (np.array([leg[n].si for leg in legs]) for n in ("leg_speed", "leak_rate"))
    relaxing = rate * si["half_stroke"] / (4.0 * si["bulk_modulus"])
    return Circuit(
        area=area,
        half_stroke=si["half_stroke"],
        minimum_gap=si["minimum_gap"],
        gain=speed * si["valve_flow"] * content / drop * area,
        leakage=relaxing * float(area.sum()) * content,
        bulk_modulus=si["bulk_modulus"],
        laminar=laminar,
        supply=si["supply_pressure"],
        tank=si["return_pressure"],
        drive_rate=si["drive_lag"],
        spool_rate=si["valve_lag"],
        overlap=si["overlap"],
        friction=si["coulomb_friction"],
        presliding=si["presliding"],
    )
