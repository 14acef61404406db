"""Many runs at once are the single runs to the bit, whatever happens to the others."""

import numpy as np
import pytest

from cmf_mj import (
    Hexapod,
    InputError,
    RunError,
    SingleLegs,
    load_hydraulics,
    signals,
    simulate,
    simulate_many,
)
from cmf_mj.plant.plant import Plant

LAWS = ("velocity", "position_error_rate", "acceleration")


def steps(*sizes: float) -> list[signals.Command]:
    """Steps in heave [m]."""
    return [signals.step("heave", size, at=0.02, duration=0.2) for size in sizes]


def test_each_case_is_its_single_run() -> None:
    commands = steps(0.002, -0.004, 0.01)
    names = ("leg_extension", "cap_pressure", "platform_pose", "gimbal_error")
    runs = simulate_many(Hexapod("rfd"), LAWS, commands, channels=names, threads=2, record_every=8)
    for case, (law, command) in enumerate(zip(LAWS, commands, strict=True)):
        single = simulate(Hexapod("rfd"), law, command, record_every=8)
        np.testing.assert_array_equal(runs.time, single.time)
        for name in names:
            np.testing.assert_array_equal(runs[name][case], single[name])
            assert runs.units[name] == single.units[name]
    assert runs.left == ("", "", "")


def test_each_case_may_have_a_plant_of_its_own() -> None:
    masses = (2000.0, 4000.0)

    def plant(case: int) -> Plant:
        return SingleLegs(effective_mass=masses[case])

    poses = np.stack([command.pose for command in steps(0.005, 0.005)])
    runs = simulate_many(plant, "velocity", poses, record_every=16)
    for case in range(2):
        single = simulate(plant(case), "velocity", poses[case], record_every=16)
        np.testing.assert_array_equal(runs["leg_extension"][case], single["leg_extension"])
    assert not np.array_equal(*runs["leg_extension"])


def test_a_case_that_leaves_its_bounds_is_marked_and_leaves_the_others_alone() -> None:
    """Without gas in the oil a chamber that is torn open goes below vacuum."""
    oil = load_hydraulics("hardware")
    none = oil.cavitation_gas.model_copy(update={"value": 0.0})
    plant = SingleLegs(oil.model_copy(update={"cavitation_gas": none}))
    poses = np.zeros((3, 320, 6))
    poses[1, 8:, 2], poses[1, 150:, 2] = -0.9, 0.9
    runs = simulate_many(plant, "velocity", poses, record_every=64)
    assert [bool(text) for text in runs.left] == [False, True, False]
    assert "below vacuum" in runs.left[1]
    assert np.isnan(runs["leg_extension"][1]).all()
    assert np.isfinite(runs["leg_extension"][[0, 2]]).all()
    with pytest.raises(RunError, match="all 1 cases"):
        simulate_many(plant, "velocity", poses[1:2])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"law": ["velocity", "original"]}, "law: 2 for 3 cases; allowed: one, or one a case"),
        ({"channels": ()}, "allowed: at least one"),
        ({"commands": np.empty((0, 8, 6))}, "allowed: at least one"),
        ({"commands": steps(0.001) + [signals.step("heave", 0.1)]}, "commands: case 1 has shape"),
        ({"channels": ("leg_length",)}, "channel: 'leg_length' is not one of"),
        ({"threads": 0}, "jobs: 0 must be at least 1"),
    ],
)
def test_refusals(arguments: dict[str, object], message: str) -> None:
    chosen = {"law": "velocity", "commands": np.zeros((3, 8, 6))} | arguments
    with pytest.raises(InputError, match=message):
        simulate_many(SingleLegs(), **chosen)  # type: ignore[arg-type]
