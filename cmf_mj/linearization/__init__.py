"""Linearisation of any plant with its hydraulics at any configuration, as python-control systems.

`linearize` gives the state space from valve commands to what the sensors of the legs read,
`operating_point` the rest it is about, `leg_model`, `dof_model`, `reduced` and `minimal` smaller
systems, `modes` what its poles are. `linear_models.closed_loop` puts a law around it and
`pose_loop` reads that in degrees of freedom; `compare_with_simulation` checks it.
"""

from cmf_mj.linearization.assembly import linearize
from cmf_mj.linearization.comparison import Comparison, compare_with_simulation, loop_between
from cmf_mj.linearization.describing import Excitation, outward_share
from cmf_mj.linearization.files import load_system, save_system
from cmf_mj.linearization.mechanics import Mechanics, linear_mechanics
from cmf_mj.linearization.modes import Mode, modes
from cmf_mj.linearization.operating_point import OperatingPoint, operating_point
from cmf_mj.linearization.reduction import dof_model, leg_model, minimal, pose_loop, reduced

__all__ = [
    "Comparison",
    "Excitation",
    "Mechanics",
    "Mode",
    "OperatingPoint",
    "compare_with_simulation",
    "dof_model",
    "leg_model",
    "linear_mechanics",
    "linearize",
    "load_system",
    "loop_between",
    "minimal",
    "modes",
    "operating_point",
    "outward_share",
    "pose_loop",
    "reduced",
    "save_system",
]
