"""Causes of a change, on a machine whose change is known."""

from pathlib import Path

import numpy as np
import pytest
from guide_files import SHORT, written

from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.studies.diagnosis import (
    Slopes,
    _Problem,
    diagnose,
    find_slopes,
    moved_machine,
    numbers_of,
)
from cmf_mj.studies.guide import load_guide, make_bench, make_head, run_guide
from cmf_mj.studies.guide_check import Master, load_master

CHANGES = {
    "valve gain of leg_3": np.log(0.95) / 0.05,
    "oil stiffness": -2.0,
    "position gain of leg_5": 1.0,
}


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> tuple[Master, Slopes]:
    folder = tmp_path_factory.mktemp("guide")
    on = make_bench(load_guide(written(folder, SHORT)), "lab")
    run_guide(on, make_head(on, machine="lab"), folder / "master")
    master = load_master(folder / "master")
    tried = [one for one in numbers_of(on.plant) if one.name in CHANGES or "leg_1" in one.name]
    return master, find_slopes(master, numbers=tried)


def changed(master: Master, folder: Path, *names: str) -> Master:
    on, numbers = master.bench, {one.name: one for one in numbers_of(master.bench.plant)}
    moved = {numbers[name]: CHANGES[name] for name in names}
    machine = moved_machine(on.plant, ElectronicsSettings(), moved)
    run_guide(on, master.head, folder, repetitions=2, seed=9, **machine)
    return load_master(folder)


@pytest.mark.parametrize("name", CHANGES)
def test_a_number_that_moved_is_named_with_its_size(
    name: str, known: tuple[Master, Slopes], tmp_path: Path
) -> None:
    """Its size within a tenth, with a probability above 0.9."""
    master, slope = known
    first, *_ = diagnose(master, changed(master, tmp_path / "new", name), slope)
    assert first.numbers == name
    assert first.probability > 0.9
    one = next(x for x in slope.numbers if x.name == name)
    size = one.step * CHANGES[name]
    size = 100.0 * (size if one.unit else np.expm1(size))
    assert float(first.size.split()[0]) == pytest.approx(size, rel=0.1)


def test_two_numbers_are_named_together(known: tuple[Master, Slopes], tmp_path: Path) -> None:
    master, slope = known
    names = ("valve gain of leg_3", "oil stiffness")
    first, *_ = diagnose(master, changed(master, tmp_path / "new", *names), slope)
    assert first.numbers == "valve gain of leg_3 and oil stiffness"


def test_what_is_not_among_the_numbers_is_none_of_these(
    known: tuple[Master, Slopes], tmp_path: Path
) -> None:
    """The oil, where only what belongs to leg 1 is tried."""
    master, slope = known
    kept = [i for i, one in enumerate(slope.numbers) if "leg_1" in one.name]
    few = slope._replace(
        numbers=tuple(slope.numbers[i] for i in kept), by_theta=slope.by_theta[:, kept]
    )
    first, *_ = diagnose(master, changed(master, tmp_path / "new", "oil stiffness"), few)
    assert first.numbers == "none of these"


def test_a_number_at_its_bound_stays_there(known: tuple[Master, Slopes]) -> None:
    """Less friction than none is asked for."""
    friction = [one for one in numbers_of(known[0].bench.plant) if one.name == "friction"]
    slope = find_slopes(known[0], numbers=friction)
    problem = _Problem(slope, -slope.by_theta[:, 0], np.ones(slope.base.size))
    with np.errstate(all="raise"):
        assert problem.fit_simulated((0,)).theta == 0.0


def test_a_machine_with_nothing_moved_is_the_machine(known: tuple[Master, Slopes]) -> None:
    plant = known[0].bench.plant
    machine = moved_machine(plant, ElectronicsSettings(), {})
    assert machine["plant"] is plant
    assert not machine["shift"].any()
