"""Train a policy that digs faster than the shipped law's cycle, with CMA-ES on the CPU.

python examples/dig_faster.py                  train: seed 1, 20 generations of 12 runs
python examples/dig_faster.py --generations 0  only run the shipped law and the policy trained so

The policy sends each cylinder towards its next place at a speed that falls with the distance left,

    u_i = s_i tanh(k_i (place_i - reference_i) / s_i)

six numbers, found by covariance matrix adaptation: it needs no gradients and no torch, and the same
seed finds the same numbers. Needs pip install 'cmf-mj[rl,search]'.
"""

import argparse
import time

import cma
import gymnasium
import numpy as np
from numpy.typing import NDArray

import cmf_mj
import cmf_mj.environments  # registers the environments
from cmf_mj.core.threads import on_threads
from cmf_mj.environments.excavator import CYLINDERS, REACHED
from cmf_mj.machine.models import model_path
from cmf_mj.signals.composite import waypoints

TRAINED = (0.658, 0.565, 0.534, 10.613, 4.426, 4.55)
"""Speeds s and gains k [1/m] of boom, stick and bucket that seed 1 finds."""

Array = NDArray[np.float64]


def dig(policy: Array) -> tuple[float, dict[str, float]]:
    """Run the cycle; the sum of the rewards and what the run ended with."""
    env = gymnasium.make("cmf_mj/Excavator-v0")
    speed, gain = np.clip(policy[:3], 0.05, 1.0), np.clip(policy[3:], 0.1, 50.0)
    seen, info = env.reset(seed=0)
    worth, ended = 0.0, False
    while not ended:
        place = seen[9:12] - seen[6:9]  # less the reference
        seen, reward, done, cut, info = env.step(speed * np.tanh(gain * place / speed))
        worth, ended = worth + float(reward), done or cut
    env.close()
    return worth, info


def shipped() -> tuple[float, float]:
    """When the shipped law has been at all places of its own cycle [s], and its pressure."""
    parts = model_path("excavator.xml"), CYLINDERS, model_path("excavator_hydraulics.toml")
    plant = cmf_mj.attach_hydraulics(*parts)
    table = np.genfromtxt(model_path("excavator_cycle.csv"), delimiter=",", names=True)
    places = np.column_stack([table[name] for name in CYLINDERS]) - plant.neutral
    law = cmf_mj.load_law(model_path("excavator_laws.toml"))
    path = waypoints(table["time"], places)
    record = cmf_mj.simulate(plant, law, path, legs=True, start=plant.configuration(path[0]))
    row = 0
    for place in places[1:]:
        near = np.abs(record["leg_extension"][row:] - place).max(axis=1) <= REACHED
        row += int(near.argmax())
    pressure = max(record["cap_pressure"].max(), record["rod_pressure"].max())
    return float(record.time[row]), float(pressure / plant.hydraulics.proof_pressure)


def train(seed: int, generations: int) -> Array:
    """The best policy of some generations of twelve runs on threads."""
    # In units of their spread: speeds of 0.3 and gains of 2 to begin with.
    spread = np.array([0.2, 0.2, 0.2, 2.0, 2.0, 2.0])
    begin = np.array([0.3, 0.3, 0.3, 2.0, 2.0, 2.0]) / spread
    search = cma.CMAEvolutionStrategy(begin, 1.0, {"seed": seed, "popsize": 12, "verbose": -9})
    for generation in range(generations):
        tried = search.ask()
        worth = [-worth for worth, _ in on_threads(lambda x: dig(spread * x), tried)]
        search.tell(tried, worth)
        best = -search.result.fbest
        print(f"generation {generation + 1:2}: best {best:.2f}", flush=True)
    return np.asarray(spread * search.result.xbest)


def main() -> None:
    """Train and compare."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--generations", type=int, default=20)
    options = parser.parse_args()
    policy, start = np.array(TRAINED), time.monotonic()
    if options.generations:
        policy = train(options.seed, options.generations)
        print(f"trained in {(time.monotonic() - start) / 60:.1f} min: {policy.round(3).tolist()}")
    law, pressure = shipped()
    print(f"shipped law: all places after {law:.1f} s, pressure {pressure:.2f} of proof")
    worth, info = dig(policy)
    print(
        f"policy:      all places after {info['time']:.1f} s, pressure "
        f"{info['pressure_over_proof']:.2f} of proof, {info['places_left']:.0f} left, {worth:.2f}"
    )


if __name__ == "__main__":
    main()
