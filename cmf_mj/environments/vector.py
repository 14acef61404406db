"""Environments side by side: on threads, since the compiled loop releases the interpreter lock.

Each environment is its own machine; an environment whose run has ended is reset by its next step
(`AutoresetMode.NEXT_STEP`). What a step does with the lock is a quarter of it, so that threads stop
gaining at four cores. Beyond, each environment has a process.
"""

import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv, VectorEnv
from numpy.typing import NDArray

from cmf_mj.core.arrays import whole
from cmf_mj.environments.environment import HexapodEnv, MachineEnv, checked

if TYPE_CHECKING:
    _Side = SyncVectorEnv[NDArray[np.float32], NDArray[np.float32]]
else:
    _Side = SyncVectorEnv  # before 1.4 it takes no types


FEW = 4  #: Cores to which threads gain.


class _Ahead(gym.Wrapper[NDArray[np.float32], NDArray[np.float32], Any, Any]):
    """An environment whose step has begun on a thread when its result is asked for."""

    result: Future[Any]

    def step(self, action: NDArray[np.float32]) -> Any:
        return self.result.result()


class ThreadVectorEnv(_Side):
    """`num_envs` environments on `threads`, by default one a core."""

    def __init__(
        self, make: Callable[[], MachineEnv], num_envs: int = 1, *, threads: int | None = None
    ) -> None:
        """Make the environments."""
        num_envs = whole("num_envs", num_envs, 1, 2**31 - 1)
        threads = whole("threads", threads is None and os.cpu_count() or threads, 1, 2**31 - 1)
        super().__init__([lambda: _Ahead(make())] * num_envs)
        self._ended = np.zeros(num_envs, dtype=bool)
        self._pool = ThreadPoolExecutor(threads)

    def reset(self, **options: Any) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Reset all; a seed is that of the first, and rises by one."""
        self._ended[:] = False
        return super().reset(**options)

    def step(self, actions: NDArray[np.float32]) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step all, or none; those that had ended are reset instead, with no reward."""
        checked("actions", actions, self.action_space)
        for env, action, ended in zip(self.envs, actions, self._ended, strict=True):
            if isinstance(env, _Ahead) and not ended:
                env.result = self._pool.submit(env.env.step, action)
        seen, rewards, done, cut, infos = super().step(actions)
        self._ended = done | cut
        return seen, rewards, done, cut, infos

    def close_extras(self, **options: Any) -> None:
        """Close the environments and end the threads."""
        super().close_extras(**options)
        self._pool.shutdown()


def hexapods(
    num_envs: int = 1, threads: int | None = None, **options: Any
) -> VectorEnv[Any, Any, Any]:
    """What `gymnasium.make_vec` calls: `threads`, or what gains most on the cores there are."""
    make = partial(HexapodEnv, **options)
    if threads is None and num_envs > 1 and (os.cpu_count() or 1) > FEW:
        return AsyncVectorEnv([make] * num_envs)
    return ThreadVectorEnv(make, num_envs, threads=threads)
