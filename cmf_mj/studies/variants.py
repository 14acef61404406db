"""The ladder from a single leg to the whole machine: each rung adds one effect.

    single_legs       six legs of 7200 lbm under 7200 lbf, constant supply, no command delay
    point_mass        the hexapod's geometry; payload a point mass at the platform centroid
    payload_inertia   the payload's inertia about its centre of mass, that still at the centroid
    centre_of_mass    the centre of mass at its height and place
    leg_inertia       cylinders and rods with their masses
    supply            pump, accumulators, manifolds and hoses instead of a constant pressure
    friction          Coulomb, breakaway and viscous friction of the `lossy` set
    electronics       noisy sensors, converters, servo electronics
    delay             one frame from the control law to the valves

With J = d(legs)/d(pose) and the payload's mass matrix M, which is diag(m, m, m, 0, 0, 0) of a
point mass, the reflected mass is M_leg = J^-T M J^-1 on every rung without leg inertia. A point
mass leaves the rotations without inertia; they follow the forces at once and compliances add:

    omega_x^2 = 1 / (m sum_i (J^-1)_xi^2 / k_i)

What MuJoCo cannot integrate at 2048 Hz is not zero but small: `SMALL` of the payload's inertia
tensor (rotational modes near 100 Hz) and of the legs' inertia (their pins then gape by 3
micrometres, a tenth of that mass by 35).
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cmf_mj.core.errors import check_name
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.machine.cab import Cab, load_cab
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters.hydraulics import HydraulicParameters
from cmf_mj.plant.parameters.loading import load_hydraulics
from cmf_mj.plant.plant import Plant
from cmf_mj.plant.single_legs import SingleLegs

SMALL = 0.01
"""Share of an inertia that is left where there should be none."""

_FRICTION = ("coulomb_friction", "breakaway_friction", "viscous_friction")


def lumped(
    cab: Cab, *, inertia: float = 1.0, centre_of_mass: bool = True, leg_mass: float = SMALL
) -> Cab:
    """A cab whose payload is one rigid body; control laws do not know.

    `inertia` is a factor on the payload's tensor about its centre of mass, which without
    `centre_of_mass` lies in the platform's centroid; `leg_mass` one on cylinders and rods.
    """
    mass, centre, tensor = cab.payload
    place = centre if centre_of_mass else np.zeros(3)
    halves: list[dict[str, Any]] = [
        {"mass": part, "centre_of_mass": place, "inertia": inertia * part / mass * tensor}
        for part in (cab.platform.mass.si, cab.mass.si)
    ]
    return cab.changed(
        f"{cab.name}, lumped",
        platform=halves[0],
        leg_mass=leg_mass,
        taken_for=cab.known_as,
        **halves[1],
    )


@dataclass(frozen=True)
class Rung:
    """One plant and what stands between it and the law."""

    name: str
    effects: tuple[str, ...]  #: Some of `EFFECTS`.

    @property
    def linear(self) -> bool:
        """Whether a linearisation of it exists."""
        return not {"friction", "electronics"} & set(self.effects) and self.command_delay > 0

    @property
    def command_delay(self) -> int:
        """Frames from the control law to the valves."""
        return int("delay" in self.effects)

    def hydraulics(self, base: HydraulicParameters) -> HydraulicParameters:
        """The hydraulic set of the rung."""
        changes: dict[str, object] = {} if "supply" in self.effects else {"supply": "constant"}
        if "friction" in self.effects:
            lossy = load_hydraulics("lossy")
            changes |= {field: getattr(lossy, field) for field in _FRICTION}
        return base.model_copy(update=changes)

    def build(self, cab: str | Path | Cab, hydraulics: HydraulicParameters) -> Plant:
        """The plant of the rung with a cab and a hydraulic set."""
        chosen, parameters = load_cab(cab), self.hydraulics(hydraulics)
        if "point_mass" not in self.effects:
            return SingleLegs(parameters, machine=chosen.machine)
        if "leg_inertia" in self.effects:
            return Hexapod(chosen, parameters)
        return Hexapod(
            lumped(
                chosen,
                inertia=1.0 if "payload_inertia" in self.effects else SMALL,
                centre_of_mass="centre_of_mass" in self.effects,
            ),
            parameters,
        )

    def electronics_settings(self, seed: int = 0) -> ElectronicsSettings | None:
        """Sensors and electronics of the rung."""
        return ElectronicsSettings(seed=seed) if "electronics" in self.effects else None


EFFECTS = (
    *("single_legs", "point_mass", "payload_inertia", "centre_of_mass", "leg_inertia"),
    *("supply", "friction", "electronics", "delay"),
)
"""What each rung adds to the one before, which is also its name."""

LADDER = tuple(Rung(name, EFFECTS[: i + 1]) for i, name in enumerate(EFFECTS))
"""All rungs, in the order of climbing."""

MACHINE = Rung("machine", (*EFFECTS[:6], "delay"))
"""The hexapod as `cmf compare` runs it: ideal sensors, no friction, one frame of delay."""


def rung_named(name: str) -> Rung:
    """A rung of the ladder, or `machine`."""
    rungs = {rung.name: rung for rung in (*LADDER, MACHINE)}
    return rungs[check_name("rungs", name, rungs)]
