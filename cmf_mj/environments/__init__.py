"""Gymnasium environments of machines with hydraulics; importing this registers the motion base's.

>>> import gymnasium, cmf_mj.environments
>>> env = gymnasium.make("cmf_mj/Hexapod-v0")
>>> observation, info = env.reset(seed=1)
>>> observation.shape, env.action_space.shape
((24,), (6,))
"""

from cmf_mj.core.errors import require

gymnasium = require("gymnasium", "rl")

from cmf_mj.environments.environment import MachineEnv, ObservedQuantity  # noqa: E402

__all__ = ["MachineEnv", "ObservedQuantity"]

if "cmf_mj/Hexapod-v0" not in gymnasium.registry:
    gymnasium.register(
        "cmf_mj/Hexapod-v0", entry_point="cmf_mj.environments.environment:HexapodEnv"
    )
