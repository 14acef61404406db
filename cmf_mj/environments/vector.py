"""Environments side by side on threads: the compiled loop releases the interpreter lock.

Nothing is pickled. Each environment is its own machine; an environment whose run has ended is reset
by its next step (`AutoresetMode.NEXT_STEP`).
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, ClassVar

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from cmf_mj.core.errors import InputError
from cmf_mj.environments.environment import MachineEnv
from cmf_mj.environments.excavator import ExcavatorEnv
from cmf_mj.environments.hexapod import HexapodEnv


class ThreadVectorEnv(VectorEnv[NDArray[np.float32], NDArray[np.float32], Any]):
    """`num_envs` environments on `threads`, by default one a core."""

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]
        "autoreset_mode": AutoresetMode.NEXT_STEP
    }

    def __init__(
        self, make: Callable[[], MachineEnv], num_envs: int = 1, *, threads: int | None = None
    ) -> None:
        """Make the environments."""
        if num_envs < 1 or (threads is not None and threads < 1):
            raise InputError(f"num_envs, threads: {num_envs}, {threads}; allowed: at least 1")
        self.envs = [make() for _ in range(num_envs)]
        self.num_envs = num_envs
        self.single_observation_space = self.envs[0].observation_space
        self.single_action_space = self.envs[0].action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._ended = np.zeros(num_envs, dtype=bool)
        self._threads = min(threads or os.cpu_count() or 1, num_envs)
        self._pool = ThreadPoolExecutor(self._threads)

    def _all(self, work: Callable[[int], Any]) -> list[Any]:
        """Results of all environments, in order."""

        def some(first: int) -> list[Any]:
            return [work(index) for index in range(first, self.num_envs, self._threads)]

        results: list[Any] = [None] * self.num_envs
        for first, part in enumerate(self._pool.map(some, range(self._threads))):
            results[first :: self._threads] = part
        return results

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Reset all; a seed is that of the first, and rises by one."""
        seeds: list[int | None] = seed if isinstance(seed, list) else [None] * self.num_envs
        if isinstance(seed, int):
            seeds = [seed + index for index in range(self.num_envs)]
        self._ended[:] = False
        begun = self._all(lambda index: self.envs[index].reset(seed=seeds[index], options=options))
        return np.stack([one[0] for one in begun]), self._infos([one[1] for one in begun])

    def step(self, actions: NDArray[np.float32]) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step all; those that had ended are reset instead, with no reward."""

        def one(index: int) -> tuple[Any, ...]:
            env = self.envs[index]
            if self._ended[index]:
                seen, info = env.reset()
                return seen, 0.0, False, False, info
            return env.step(actions[index])

        seen, rewards, done, cut, infos = zip(*self._all(one), strict=True)
        self._ended = np.array(done) | np.array(cut)
        return (
            np.stack(seen),
            np.array(rewards, dtype=float),
            np.array(done),
            np.array(cut),
            self._infos(list(infos)),
        )

    def _infos(self, infos: list[dict[str, Any]]) -> dict[str, Any]:
        gathered: dict[str, Any] = {}
        for index, info in enumerate(infos):
            gathered = self._add_info(gathered, info, index)
        return gathered

    def close_extras(self, **_: Any) -> None:
        """Close the environments and end the threads."""
        for env in self.envs:
            env.close()
        self._pool.shutdown()


def _made(kind: Any, num_envs: int = 1, threads: int | None = None, **options: Any) -> Any:
    return ThreadVectorEnv(partial(kind, **options), num_envs, threads=threads)


hexapods: Callable[..., ThreadVectorEnv] = partial(_made, HexapodEnv)
excavators: Callable[..., ThreadVectorEnv] = partial(_made, ExcavatorEnv)
"""What `gymnasium.make_vec` calls."""
