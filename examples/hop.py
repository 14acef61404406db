"""A one-leg hopper with a hydraulic hip and knee learns to hop on machines that differ.

python examples/hop.py                  train: seed 1, 12 generations of 8 jumps on 3 machines each
python examples/hop.py --generations 0  only show the jump trained so

Four numbers make a jump: how far hip and knee valves open, for how long, and how they bring the leg
back in flight. Covariance matrix adaptation finds them on machines drawn from what is unknown:
masses, valve gains, supply pressure, leakage. Needs pip install 'cmf-mj[rl,search]'.
"""

import argparse
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import cma
import mujoco
import numpy as np
from numpy.typing import NDArray

import cmf_mj
from cmf_mj.core.threads import on_threads
from cmf_mj.environments import MachineEnv, ObservedQuantity
from cmf_mj.environments.environment import of_cylinders
from cmf_mj.facility.unknown import Unknown
from cmf_mj.facility.unknowns import Unknowns

MODEL = """
<mujoco model="hopper">
  <worldbody>
    <light pos="0 -2 3"/>
    <geom name="floor" type="plane" size="2 2 0.1" friction="1"/>
    <body name="trunk" pos="0 0 0.6057">
      <joint name="rail" type="slide" axis="0 0 1"/>
      <geom type="box" size="0.15 0.1 0.1" pos="0 0 0.1" mass="25"/>
      <body name="thigh" euler="0 -45 0">
        <joint name="hip" axis="0 1 0" range="-35 40"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.03" mass="5"/>
        <body name="shank" pos="0 0 -0.4" euler="0 90 0">
          <joint name="knee" axis="0 1 0" range="-75 35"/>
          <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.025" mass="3"
                contype="0" conaffinity="0"/>
          <geom name="foot" type="sphere" pos="0 0 -0.4" size="0.04" mass="0.5"
                solref="0.04 1" friction="1"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="hip" gear="350" ctrlrange="-1 1"/>
    <motor joint="knee" gear="350" ctrlrange="-1 1"/>
  </actuator>
</mujoco>
"""
OIL = """
base = "hardware"
[hopper]
supply_pressure = { value = 200, unit = "bar", status = "assumed", source = "mobile hydraulics" }
relief_pressure = { value = 230, unit = "bar", status = "assumed", source = "15 % above" }
precharge_pressure = { value = 120, unit = "bar", status = "assumed", source = "60 %" }
proof_pressure = { value = 1000, unit = "bar", status = "assumed", source = "five times" }
pump_flow = { value = 40, unit = "l/min", status = "assumed", source = "a few kW" }
accumulator_count = { value = 1, unit = "1", status = "assumed", source = "one, beside the pump" }
accumulator_volume = { value = 2, unit = "l", status = "assumed", source = "some jumps" }
supply_volume = { value = 1, unit = "l", status = "assumed", source = "lines" }
return_volume = { value = 1, unit = "l", status = "assumed", source = "lines" }
bulk_modulus = { value = 12000, unit = "bar", status = "assumed", source = "oil with hoses" }
drive_lag = { value = 60, unit = "Hz", status = "assumed", source = "small servo-valves" }
valve_lag = { value = 150, unit = "Hz", status = "assumed", source = "small servo-valves" }
leg_speed = { value = 10, unit = "mm/s/%", status = "assumed", source = "1 m/s at open valves" }
minimum_gap = { value = 0.5, unit = "mm", status = "assumed", source = "oil at the stop" }
leak_rate = { value = 10, unit = "1/s", status = "assumed", source = "as the set hardware" }
"""


def differs(path: str, percent: float) -> Unknown:
    """A number that is off by at most so many per cent."""
    return Unknown(path=path, deviation=percent, source="a hopper as built")


UNKNOWNS = Unknowns(
    trunk=differs("model.body.trunk.mass", 15.0),
    thigh=differs("model.body.thigh.mass", 10.0),
    grip=differs("model.geom.foot.friction", 20.0),
    speed=differs("hydraulics.actuators.*.leg_speed", 10.0),
    supply=differs("hydraulics.supply", 5.0),
    leak=differs("hydraulics.leak_rate", 50.0),
)
REST, SECONDS = 0.125, 1.5  # before the jump, and in all [s]
TRAINED = (1.598, 3.367, 3.831, 1.169)
"""What seed 1 finds: openings of hip and knee, at most 1, push [0.1 s], return [10/m]."""

Array = NDArray[np.float64]


def hopper() -> cmf_mj.Plant:
    """The hopper, its motors replaced by cylinders of their torque; both extend to push."""
    with TemporaryDirectory() as folder:
        oil = Path(folder) / "oil.toml"
        oil.write_text(OIL)
        spec = mujoco.MjSpec.from_string(MODEL)
        return cmf_mj.attach_to_hinges(spec, ["hip", "knee"], oil, against=["knee"])


def height(env: MachineEnv) -> float:
    """Of the trunk above where it stood [m]."""
    return float(env.plant.data.qpos[0])


def hops(unknowns: Unknowns | None = UNKNOWNS) -> MachineEnv:
    """Valve commands in steps of 1/128 s; rewarded are the apex, and to stand as before."""

    def begin(env: MachineEnv, options: object) -> None:
        env.apex = 0.0

    def rise(env: MachineEnv, action: Array) -> tuple[float, bool]:
        before, env.apex = env.apex, max(env.apex, height(env))
        env.info["apex"] = env.apex
        ended = env.running.frame == env.running.frames
        return env.apex - before - ended * abs(height(env)), False

    plant = hopper()
    seen = (*of_cylinders(plant), ObservedQuantity("height", "m", 1, 2.0, height))
    how = {"begin": begin, "quantities": seen, "unknowns": unknowns}
    return MachineEnv(plant, reward=rise, frames=16, seconds=SECONDS, **how)


def jump(env: MachineEnv, policy: Array, seed: int) -> tuple[float, Array]:
    """The rewards on the machine that a seed draws, and the valve commands of all frames."""
    push, until = np.clip(policy[:2], 0.0, 1.0), REST + 0.1 * policy[2]
    gain = 10.0 * max(policy[3], 0.0)
    seen, _ = env.reset(seed=seed)
    stance, worth, ended, rows = seen[:2], 0.0, False, list[Array]()
    while not ended:
        clock = len(rows) * env.period
        action = push * (clock >= REST) if clock < until else gain * (stance - seen[:2])
        rows.append(np.clip(action, -1.0, 1.0))
        seen, reward, done, cut, _ = env.step(rows[-1])
        worth, ended = worth + reward, done or cut
    return worth, np.repeat(rows, env.frames, axis=0)


def train(seed: int, generations: int) -> Array:
    """The best jump of some generations of eight, each on three machines, on threads."""
    begin = {"seed": seed, "popsize": 8, "verbose": -9}
    search = cma.CMAEvolutionStrategy([0.3, 0.3, 1.0, 1.0], 0.2, begin)
    envs = [hops() for _ in range(8)]
    for generation in range(generations):
        tried = search.ask()
        seeds = range(3 * generation, 3 * generation + 3)
        cases = [(env, policy, seeds) for env, policy in zip(envs, tried, strict=True)]
        worth = on_threads(lambda it: np.mean([jump(*it[:2], seed)[0] for seed in it[2]]), cases)
        search.tell(tried, [-one for one in worth])
        print(f"generation {generation + 1:2}: best {max(worth):.3f} m", flush=True)
    return np.asarray(search.result.xfavorite)


def main() -> None:
    """Train, then hop on ten machines that nobody has seen, and on two hundred at once."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--generations", type=int, default=12)
    options = parser.parse_args()
    policy, start = np.array(TRAINED), time.monotonic()
    if options.generations:
        policy = train(options.seed, options.generations)
        print(f"trained in {(time.monotonic() - start) / 60:.1f} min: {policy.round(3).tolist()}")
    env, apex = hops(), []
    for machine in range(10):
        jump(env, policy, 1000 + machine)
        apex.append(env.info["apex"])
    tell("by themselves", np.array(apex))
    _, valves = jump(hops(None), policy, 0)
    known = UNKNOWNS.on(hopper())

    def alone(machine: int) -> float:
        drawn = known.apply(known.streams(2, machine), hopper())
        record = cmf_mj.drive(drawn, valves, command_delay=1, record_every=16)
        return float(record["generalised_position"][:, 0].max())

    tell("by the nominal commands", np.array(on_threads(alone, range(200))))


def tell(how: str, apex: Array) -> None:
    """How many machines hop [m]."""
    print(f"{(apex >= 0.1).sum()} of {apex.size} hop {how}: {apex.min():.3f} to {apex.max():.3f} m")


if __name__ == "__main__":
    main()
