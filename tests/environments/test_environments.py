"""The Gymnasium environments: checked, repeatable, side by side, and what they say they do."""

import warnings
from typing import Any

import gymnasium
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from cmf_mj import InputError, attach_hydraulics, drive, load_law, pose_to_legs, simulate
from cmf_mj.environments import MachineEnv, ObservedQuantity
from cmf_mj.environments.environment import HexapodEnv
from cmf_mj.facility.session import OutOfBounds, Session
from cmf_mj.facility.unknown import Unknown
from cmf_mj.facility.unknowns import Unknowns, load_unknowns
from cmf_mj.plant.hexapod import Hexapod

UNKNOWNS = load_unknowns("valve_gains")
PRESS = """
<mujoco model="press">
  <worldbody><light pos="0 -3 4"/>
    <body name="load"><joint name="ram" type="slide" axis="0 0 1" range="0 1.9304"/>
      <geom type="box" size="0.5 0.5 0.1" mass="3000"/></body>
    <body name="other" pos="2 0 0"><joint name="side" type="slide" axis="1 0 0" range="0 1.9304"/>
      <geom type="box" size="0.5 0.5 0.1" mass="1000"/></body>
  </worldbody>
</mujoco>
"""


def press(law: str | None = None, **options: Any) -> MachineEnv:
    """Two cylinders in the middle of their strokes; the reward is the first's extension."""
    plant = attach_hydraulics(mujoco.MjSpec.from_string(PRESS), ["ram", "side"])
    how: dict[str, Any] = {"start": plant.configuration([0.0, 0.0]), "seconds": 1.0}
    how["reward"] = lambda env, _: (env.extension[0], False)
    return MachineEnv(plant, law, **how | options)


@pytest.mark.parametrize(
    "options", [{}, {"action": "valves"}, {"action": "residual", "unknowns": UNKNOWNS}, None]
)
def test_the_checker_has_no_warning(options: dict[str, Any] | None) -> None:
    env: Any = press() if options is None else gymnasium.make("cmf_mj/Hexapod-v0", **options)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped, skip_render_check=True)
    width = sum(quantity.width for quantity in env.unwrapped.quantities)
    assert env.observation_space.shape == (width,)


@pytest.mark.slow
@pytest.mark.parametrize("own", [False, True])
def test_a_picture_shows_the_machine(own: bool) -> None:
    how: dict[str, Any] = {"render_mode": "rgb_array", "seconds": 1.0}
    env: Any = press(**how) if own else gymnasium.make("cmf_mj/Hexapod-v0", **how)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped, skip_render_check=own)
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape == (480, 640, 3) and picture.std() > 5.0
    env.close()


def run(env: Any, seed: int, steps: int = 12) -> list[Any]:
    seen, _ = env.reset(seed=seed)
    drawn = np.random.default_rng(seed)
    told: list[Any] = [seen.tobytes()]
    for _ in range(steps):
        shape = env.action_space.shape
        seen, reward, *_ = env.step(drawn.uniform(-0.3, 0.3, shape).astype(np.float32))
        told += [seen.tobytes(), np.asarray(reward).tobytes()]
    return told


@pytest.mark.parametrize("options", [{}, {"action": "valves"}, {"unknowns": UNKNOWNS}])
def test_a_seed_gives_its_bits_again_and_another_seed_others(options: dict[str, Any]) -> None:
    first, again = HexapodEnv(**options), HexapodEnv(**options)
    assert run(first, 3) == run(again, 3) == run(first, 3)
    assert run(first, 3) != run(first, 4)


def test_processes_give_the_bits_of_one_environment_after_the_other() -> None:
    """The run of 1/16 s ends in between: each is reset by the step after."""
    many = gymnasium.make_vec(
        "cmf_mj/Hexapod-v0", num_envs=2, vectorization_mode="async", seconds=0.0625
    )
    alone = [HexapodEnv(seconds=0.0625) for _ in range(2)]
    seen, infos = many.reset(seed=7)
    for index, env in enumerate(alone):
        own, info = env.reset(seed=7 + index)
        assert (own == seen[index]).all() and (info["target"] == infos["target"][index]).all()
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (2, 6)).astype(np.float32)
    for ended in (False, True):
        seen, rewards, _, cut, _ = many.step(actions)
        for index, env in enumerate(alone):
            own, reward, *_ = env.step(actions[index])
            assert (own == seen[index]).all() and reward == rewards[index]
        assert cut.tolist() == [ended] * 2
    assert many.step(actions)[3].tolist() == [False] * 2
    many.close()


def test_a_pose_demand_is_the_run_of_that_ramp() -> None:
    """Its legs are those of `simulate`, which engages on the first row of the ramp."""
    env = HexapodEnv(seconds=1.0)
    env.reset(seed=0, options={"target": np.zeros(6)})
    actions = [np.array([0.0, 0.0, 0.1, 0.05, 0.0, 0.0]), np.array([0.1, 0.0, 0.1, 0.0, 0.0, 0.0])]
    poses, asked = [], np.zeros(6)
    for action in actions:
        env.step(action.astype(np.float32))
        aim = action.astype(np.float32).astype(float) * [0.3, 0.3, 0.2, 0.15, 0.15, 0.2]
        poses.append(asked + np.arange(1, 65)[:, None] / 64 * (aim - asked))
        asked = aim
    legs = pose_to_legs(np.vstack([*poses, poses[-1][-1:]]))
    record = simulate(Hexapod("gfd", "hardware"), load_law("velocity"), legs, legs=True)
    assert env.session is not None
    assert np.abs(record["leg_extension"][127] - env.session.memory.extension).max() < 1e-4


def test_at_the_target_the_reward_is_nought_and_the_run_is_truncated() -> None:
    env = HexapodEnv(seconds=0.25)
    env.reset(seed=0, options={"target": np.zeros(6)})
    ends = [env.step(np.zeros(6, dtype=np.float32)) for _ in range(8)]
    assert [end[3] for end in ends] == [False] * 7 + [True]
    assert -1e-3 < sum(end[1] for end in ends) <= 0.0
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(6, dtype=np.float32))


def test_a_run_that_leaves_the_bounds_of_the_machine_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    env = HexapodEnv()
    env.reset(seed=0)

    def left(*_: object) -> None:
        raise OutOfBounds("leg_1 is at 2 m", 0)

    monkeypatch.setattr(Session, "run", left)
    _, reward, done, cut, info = env.step(np.zeros(6, dtype=np.float32))
    assert (reward, done, cut, info["left"]) == (-100.0, True, False, "leg_1 is at 2 m")
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(6, dtype=np.float32))


def test_unknowns_draw_another_machine_for_each_run() -> None:
    """A spread of 10 % in the legs' speeds shows in where the legs go."""
    env, seen = HexapodEnv("valves", unknowns=UNKNOWNS), []
    for seed in (1, 2, 1):
        env.reset(seed=seed, options={"target": np.zeros(6)})
        for _ in range(10):
            here, *_ = env.step(np.full(6, 0.2, dtype=np.float32))
        seen.append(here[:6])
    apart = np.ptp(seen[0]) / seen[0].mean()
    assert 0.02 < apart < 0.25
    assert (seen[0] == seen[2]).all() and (seen[0] != seen[1]).any()


@pytest.mark.parametrize("law", [None, "velocity"])
def test_a_step_is_the_frames_of_a_run(law: str | None) -> None:
    """To the bit: valve commands of `drive`, or straight lines of extensions of `simulate`."""
    env, actions = press(law, frames=40), [[0.1, -0.2], [0.3, 0.0], [-0.05, 0.2]]
    env.reset(seed=0)
    ends, rewards = [], []
    for action in actions:
        rewards.append(env.step(np.array(action, dtype=np.float32))[1])
        ends.append(env.extension.copy())
    given = np.array(actions, dtype=np.float32).astype(float)
    plant, start = env.plant, env._start
    if law is None:
        rows = np.vstack([np.repeat(given, 40, axis=0), given[-1:]])
        record = drive(plant, rows, start=start, command_delay=1)
    else:
        half, share = plant.hydraulics.cylinder.half_stroke, np.arange(1, 41)[:, None] / 40
        plant.start(start)
        knots = np.vstack([plant.extensions(), given * half])
        lines = [a + share * (b - a) for a, b in zip(knots[:-1], knots[1:], strict=True)]
        # A run engages on its first row, an environment at its start.
        rows = np.vstack([*lines, knots[-1:]])
        record = simulate(plant, law, rows, legs=True, start=start)
    same = np.array_equal if law is None else lambda a, b: np.abs(a - b).max() < 1e-4
    for step, end in enumerate(ends, start=1):
        assert same(record["leg_extension"][40 * step - 1], end)
    assert rewards == [end[0] for end in ends]


def test_any_plant_is_drawn_again_for_each_run() -> None:
    """At open valves speeds go with valve gains; the plant given stays as it was."""
    speed = Unknown(path="hydraulics.actuators.*.leg_speed", deviation=20.0, source="test")
    env = press(unknowns=Unknowns(speed=speed))
    seen = []
    for seed in (1, 2, 1):
        env.reset(seed=seed)
        here = [env.step(np.array([0.0, 0.3], dtype=np.float32))[0] for _ in range(16)][-1]
        gain = env.plant.parameters.actuator("side")["leg_speed"].si
        seen.append((here.tobytes(), here[1] / gain))
    assert seen[0] == seen[2] and seen[0][0] != seen[1][0]
    assert seen[0][1] == pytest.approx(seen[1][1], rel=0.05)


def test_a_task_draws_itself_sees_and_ends() -> None:
    """A place to reach: drawn by the seed, handed out, seen as what is left to it."""

    def aim(env: Any, options: Any) -> None:
        drawn = env.np_random.uniform(0.05, 0.1, 1)
        env.place = env.option(options, "place", drawn, 0.5)[0]
        env.info["place"] = env.place

    def left(env: Any) -> float:
        return float(env.place - env.extension[1])

    env = press(
        begin=aim,
        actions=1,
        act=lambda env, action: np.concatenate([[0.0], action]),
        quantities=[ObservedQuantity("left", "m", 1, 1.0, left)],
        reward=lambda env, _: (-abs(left(env)), abs(left(env)) < 0.01),
        seconds=4.0,
    )
    seen, info = env.reset(seed=5)
    assert seen == pytest.approx([info["place"]], abs=1e-6) and 0.05 < info["place"] < 0.1
    done = cut = False
    while not (done or cut):
        seen, reward, done, cut, info = env.step(np.clip(5.0 * seen, -1.0, 1.0))
    assert done and abs(seen[0]) < 0.01 and reward == pytest.approx(-abs(seen[0]), abs=1e-6)
    with pytest.raises(gymnasium.error.ResetNeeded, match="reset the environment first"):
        env.step(np.zeros(1))
    assert env.reset(seed=1, options={"place": [0.2]})[1] == {"place": 0.2}


@pytest.mark.parametrize("make", [press, HexapodEnv])
def test_an_action_is_finite_numbers_and_is_refused_before_it_moves_anything(make: Any) -> None:
    env = make(seconds=1.0)
    env.reset(seed=1)
    count = env.action_space.shape[0]
    for bad in (np.full(count, np.nan), np.full(count, np.inf), np.zeros(count + 1), "up", 1j):
        with pytest.raises(InputError, match=r"action(\[0\])?: "):
            env.step(bad)
    assert env.session is not None and env.session.frame == 0
    env.step(np.zeros(count))


def test_wrong_options_are_refused_by_name() -> None:
    for make, words in (
        (lambda: HexapodEnv(seconds=-1.0), r"seconds: -1\.0 is refused; allowed: above 0"),
        (lambda: press(seconds=float("nan")), "seconds: nan is refused"),
        (lambda: press(frames=0), "frames: 0 is refused"),
        (lambda: HexapodEnv("lever"), "action: 'lever'"),
        (lambda: HexapodEnv(render_mode="human"), "render_mode: 'human'"),
        (lambda: HexapodEnv(seconds=float("inf")), "seconds: inf is refused"),
        (lambda: HexapodEnv(seconds="2"), "seconds: holds <U1"),  # type: ignore[arg-type]
    ):
        with pytest.raises(InputError, match=words):
            make()


@pytest.mark.parametrize(
    ("make", "options", "words"),
    [
        (HexapodEnv, {"target": [np.nan] * 6}, r"target: \[nan.* is refused; .* shape \(6,\)"),
        (HexapodEnv, {"target": [0.0] * 3}, "target: .* is refused"),
        (HexapodEnv, {"target": [[0.0] * 6]}, "target: .* is refused"),
        (HexapodEnv, {"target": [10.0] * 6}, "target: .* of size 2 at most"),
        (HexapodEnv, {"target": None}, "target: holds object"),
        (HexapodEnv, {"Target": [0.0] * 6}, "options: .*Target.* allowed: .*'target'"),
        (HexapodEnv, [1], r"options: \[1\] is refused"),
        (press, {"target": [0.0] * 6}, "options: .* is refused; allowed: none"),
    ],
)
def test_wrong_options_of_a_reset_are_refused_by_name(make: Any, options: Any, words: str) -> None:
    """NaN gave a reward of NaN, another shape a failure inside NumPy, another name nothing."""
    with pytest.raises(InputError, match=words):
        make().reset(seed=1, options=options)
