"""Gymnasium environments of machines with hydraulics; importing this registers them.

>>> import gymnasium, cmf_mj.environments
>>> env = gymnasium.make("cmf_mj/Excavator-v0", task="reach")
>>> observation, info = env.reset(seed=1)
>>> observation.shape, env.action_space.shape
((16,), (3,))
"""

from cmf_mj.core.errors import require

gymnasium = require("gymnasium", "rl")

for _name, _module in {"Hexapod": "hexapod", "Excavator": "excavator"}.items():
    _id = f"cmf_mj/{_name}-v0"
    if _id not in gymnasium.registry:
        gymnasium.register(
            _id,
            entry_point=f"cmf_mj.environments.{_module}:{_name}Env",
            vector_entry_point=f"cmf_mj.environments.vector:{_module}s",
        )
