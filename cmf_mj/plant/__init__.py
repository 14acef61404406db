"""The plant: hydraulic actuators driving mechanics that MuJoCo integrates."""

from cmf_mj.plant.attach import attach_hydraulics
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.plant import Plant
from cmf_mj.plant.single_legs import SingleLegs

__all__ = ["Hexapod", "Plant", "SingleLegs", "attach_hydraulics"]
