"""Linearisation of any plant with its hydraulics at any configuration, as python-control systems.

`linearize` gives the state space from valve commands to what the sensors of the legs read,
`operating_point` the rest it is about, `leg_model`, `dof_model`, `reduced` and `minimal` smaller
systems, `modes` what its poles are. `linear_models.closed_loop` puts a law around it and
`pose_loop` reads that in degrees of freedom.
"""

from cmf_mj.linearization.assembly import linearize
from cmf_mj.linearization.mechanics import Mechanics, linear_mechanics
from cmf_mj.linearization.operating_point import OperatingPoint, operating_point
from cmf_mj.linearization.reduction import dof_model, leg_model, minimal, pose_loop, reduced

__all__ = [
    "Mechanics",
    "OperatingPoint",
    "dof_model",
    "leg_model",
    "linear_mechanics",
    "linearize",
    "minimal",
    "operating_point",
    "pose_loop",
    "reduced",
]
