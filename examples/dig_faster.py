"""Train a policy that digs faster than the shipped law's cycle, with CMA-ES on the CPU.

python examples/dig_faster.py                  train: seed 1, 20 generations of 12 runs
python examples/dig_faster.py --generations 0  only run the shipped law and the policy trained so

The machine is a 20 t excavator whose law follows a reference. An action is the speed of each
cylinder's reference as a share of full speed, which changes by at most 3 m/s^2. A place is reached
when every cylinder is within 30 mm of it. With n places reached in a step of dt, and p the largest
pressure over the proof pressure, the reward of the step is r = 10 n - dt - 10 dt max(p - 0.5, 0).

The policy sends each cylinder towards its next place at a speed that falls with the distance left,

    u_i = s_i tanh(k_i (place_i - reference_i) / s_i)

six numbers, found by covariance matrix adaptation: it needs no gradients and no torch, and the same
seed finds the same numbers. Needs pip install 'cmf-mj[rl,search]'.
"""

import argparse
import time

import cma
import numpy as np
from numpy.typing import NDArray

import cmf_mj
from cmf_mj.core.threads import on_threads
from cmf_mj.environments import MachineEnv, ObservedQuantity
from cmf_mj.machine.models import model_path
from cmf_mj.signals.composite import waypoints

TRAINED = (0.658, 0.565, 0.534, 10.613, 4.426, 4.55)
"""Speeds s and gains k [1/m] of boom, stick and bucket that seed 1 finds."""

CYLINDERS = ("boom_cylinder", "stick_cylinder", "bucket_cylinder")
REACHED = 0.03  # distance of every cylinder within which a place is reached [m]
ACCELERATION = 3.0  # of the reference [m/s^2]
FULL = np.array([0.4, 0.5, 0.6])  # speed of the reference at a full action [m/s]

Array = NDArray[np.float64]


class Digging:
    """The digging cycle: its machine, what an action does, what is seen, and the reward."""

    def __init__(self) -> None:
        """Attach the hydraulics and read the cycle."""
        parts = model_path("excavator.xml"), CYLINDERS, model_path("excavator_hydraulics.toml")
        self.plant = cmf_mj.attach_hydraulics(*parts)
        self.table = np.genfromtxt(model_path("excavator_cycle.csv"), delimiter=",", names=True)
        lengths = np.column_stack([self.table[name] for name in CYLINDERS])
        self.places = lengths - self.plant.neutral  # from half stroke, the start first [m], (5, 3)
        self.law = cmf_mj.load_law(model_path("excavator_laws.toml"))
        self.start = self.plant.configuration(self.places[0])
        self.span = self.plant.hydraulics.cylinder.half_stroke - 0.05

    def env(self) -> MachineEnv:
        """The environment of a run of at most 30 s."""
        tasks = {"begin": self.begin, "act": self.act, "reward": self.judge}
        seen = [ObservedQuantity("place_less_reference", "m", 3, 2.0, self.missing)]
        how = {"quantities": seen, "start": self.start, "seconds": 30.0}
        return MachineEnv(self.plant, self.law, **tasks, **how)

    def begin(self, env: MachineEnv, options: object) -> None:
        """All places are ahead, the reference is at rest."""
        self.ahead = list(self.places[1:])
        self.reference, self.speed, self.pressure = self.places[0].copy(), np.zeros(3), 0.0

    def missing(self, env: MachineEnv) -> Array:
        """From the reference to the next place [m]."""
        return self.ahead[0] - self.reference if self.ahead else np.zeros(3)

    def act(self, env: MachineEnv, action: Array) -> Array:
        """The reference of the next step, within the strokes."""
        frame = env.plant.machine.frame
        change = np.arange(1, env.frames + 1)[:, None] * frame * ACCELERATION
        speed = self.speed + np.clip(action * FULL - self.speed, -change, change)
        path = self.reference + np.cumsum(speed, axis=0) * frame
        held = np.clip(path, -self.span, self.span)
        self.reference = held[-1].copy()
        self.speed = np.where(held[-1] == path[-1], speed[-1], 0.0)
        return held

    def judge(self, env: MachineEnv, action: Array) -> tuple[float, bool]:
        """Reward of a step, and whether all places were reached."""
        pressure = env.running.dynamics.state.pressure.max()
        share = float(pressure / env.plant.hydraulics.proof_pressure)
        self.pressure = max(self.pressure, share)
        reached = np.abs(self.ahead[0] - env.extension).max() <= REACHED
        if reached:
            self.ahead.pop(0)
        time = env.running.frame * env.plant.machine.frame
        env.info |= {"time": time, "left": len(self.ahead), "pressure": self.pressure}
        return 10.0 * reached - env.period * (1.0 + 10.0 * max(share - 0.5, 0.0)), not self.ahead


def dig(policy: Array) -> tuple[float, dict[str, float]]:
    """Run the cycle; the sum of the rewards and what the run ended with."""
    env = Digging().env()
    speed, gain = np.clip(policy[:3], 0.05, 1.0), np.clip(policy[3:], 0.1, 50.0)
    seen, info = env.reset(seed=0)
    worth, ended = 0.0, False
    while not ended:
        seen, reward, done, cut, info = env.step(speed * np.tanh(gain * seen / speed))
        worth, ended = worth + float(reward), done or cut
    return worth, info


def shipped() -> tuple[float, float]:
    """When the shipped law has been at all places of its own cycle [s], and its pressure."""
    task = Digging()
    plant, law, places = task.plant, task.law, task.places
    path = waypoints(task.table["time"], places)
    record = cmf_mj.simulate(plant, law, path, legs=True, start=task.start)
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
        f"{info['pressure']:.2f} of proof, {info['left']:.0f} left, {worth:.2f}"
    )


if __name__ == "__main__":
    main()
