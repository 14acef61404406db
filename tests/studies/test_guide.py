"""Guides as files, on machines, and planned."""

from pathlib import Path

import numpy as np
import pytest
from guide_files import SHORT, written

from cmf_mj.core.errors import InputError
from cmf_mj.core.tables import read_table
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.pilot.omct import cueing_responses
from cmf_mj.studies.guide import (
    FILE,
    GUIDES,
    load_guide,
    make_bench,
    make_head,
    plan_guide,
    run_guide,
    simulate_test,
)
from cmf_mj.studies.measurement import MEASURES


@pytest.mark.parametrize("name", GUIDES)
def test_a_shipped_guide_says_where_each_limit_comes_from(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(MEASURES, "cueing", cueing_responses)
    guide = load_guide(name)
    for one in guide.tests.values():
        assert one.limits or one.no_limit
        assert one.source


def test_a_guide_is_based_on_another(tmp_path: Path) -> None:
    text = 'based_on = "part60"\nrepetitions = 4\n[tests.turn_around]\nshare = 0.2\n'
    mine, base = load_guide(written(tmp_path, text)), load_guide("part60")
    assert mine.repetitions == 4
    assert mine.tests["turn_around"].share == 0.2
    assert mine.tests["leg_balance"] == base.tests["leg_balance"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (('["response"]', '["respons"]'), "tests.all.measures: 'respons' is not one of"),
        (('no_limit = "a test"', ""), "tests.all.no_limit: is missing"),
        (("share = 0.3", "share = 2.0"), "share"),
    ],
)
def test_what_a_guide_may_not_say_is_named(
    change: tuple[str, str], said: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=said):
        load_guide(written(tmp_path, SHORT.replace(*change)))
    with pytest.raises(InputError, match="'part61' is not one of"):
        load_guide("part61")


def test_sizes_use_their_share_of_any_machine_and_too_large_ones_are_impossible(
    tmp_path: Path,
) -> None:
    fixed = SHORT.replace("share = 0.3\n", "").replace("surge = 1.0", "surge = 0.5")
    for machine in ("cmf", "lab"):
        on = make_bench(load_guide(written(tmp_path, SHORT)), machine)
        assert 0.97 * 0.3 < on.used_share["all"] <= 0.3
        too_much = make_bench(load_guide(written(tmp_path, fixed)), machine)
        assert "times what the machine can" in too_much.impossible["all"]
        assert not too_much.commands


def test_what_a_position_sensor_reads_too_much_the_machine_lacks(tmp_path: Path) -> None:
    """The reading follows the same demand; the pressures are those of a machine that stands lower,
    and the difference doubles with the offset within 1 %."""
    on = make_bench(load_guide(written(tmp_path, SHORT)), "lab")
    plain, small, large = (
        simulate_test(on, "all", shift=size * np.eye(6)[2]) for size in (0.0, 5e-4, 1e-3)
    )
    np.testing.assert_allclose(small["leg_reference"], plain["leg_reference"], rtol=0, atol=1e-15)
    np.testing.assert_allclose(small["leg_position"], plain["leg_position"], atol=2e-5)
    one, two = ((r["cap_pressure"] - plain["cap_pressure"]).mean(axis=0) for r in (small, large))
    assert np.abs(one).max() > 100.0
    np.testing.assert_allclose(two, 2.0 * one, atol=0.02 * np.abs(two).max())


def test_a_plan_has_the_host_s_frames_and_the_time_it_takes(tmp_path: Path) -> None:
    on = make_bench(load_guide(written(tmp_path, SHORT)), "lab")
    head = make_head(on, machine="lab")
    table = plan_guide(on, head, tmp_path / "plan")
    ((_, name, length, again, _, minutes, files),) = table.rows
    assert (name, length, again, files) == ("all", 9.0, 3, "all.1.csv to all.3.csv")
    assert minutes == pytest.approx(3 * (9.0 + 10.0) / 60.0)
    host = read_table(tmp_path / "plan/host/all.csv")
    assert host.num_rows == pytest.approx(9.0 * 128, abs=2)
    assert (tmp_path / "plan" / FILE).is_file()
    with pytest.raises(InputError, match="holds a guide's master, which is kept"):
        run_guide(on, head, tmp_path / "plan")


def test_repetitions_differ_by_their_noise_alone(tmp_path: Path) -> None:
    on = make_bench(load_guide(written(tmp_path, SHORT)), "lab")
    first, again, other = (
        simulate_test(on, "all", electronics=ElectronicsSettings(), seed=seed) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first["leg_position"], again["leg_position"])
    off = first["leg_position"] - other["leg_position"]
    assert 0.0 < off.std() < 1e-4
