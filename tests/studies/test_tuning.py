"""The search of gains, its files and commands, and what the shipped law keeps in the simulation."""

import runpy
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from shared import cmf

from cmf_mj import Cab, Law, Linear, load_cab, load_hydraulics, load_law, load_machine
from cmf_mj.analysis.modes import nominal_modes
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.facility.unknowns import with_valve_gains
from cmf_mj.machine.geometry import DOFS
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.plant import Plant
from cmf_mj.studies.case import AMPLITUDE, make_case, run_case
from cmf_mj.studies.tuning.evaluation import evaluate, least_damping, linear_cab
from cmf_mj.studies.tuning.forms import FORMS, Form, candidate_law, make_template
from cmf_mj.studies.tuning.search import Requirements, SearchResult, judge, save_law, search

SCRIPTS = Path(__file__).parents[2] / "scripts"


@pytest.mark.parametrize(("cab", "dof"), [("ifd", "sway"), ("ifd", "pitch"), ("gfd", "heave")])
@pytest.mark.parametrize("electronics", [None, ElectronicsSettings()], ids=["ideal", "noisy"])
def test_the_shipped_law_keeps_the_targets_with_valves_off(
    cab: str, dof: str, electronics: ElectronicsSettings | None
) -> None:
    """-90 deg >= 5.6 Hz, peak <= 1 dB, damping ratio >= 0.5, valve gains within 10 % at random."""
    hydraulics = with_valve_gains(load_hydraulics("hardware"), 1)
    machine = {"cab": cab, "hydraulics": hydraulics, "electronics": electronics}
    measures = run_case(make_case("modal_plan", dof, quick=True, **machine)).measures
    assert measures.stable
    assert measures.phase_bandwidth_hz >= 5.6
    assert measures.peak_gain_db <= 1.0
    assert measures.overshoot <= 0.1
    assert not measures.damping_ratio < 0.5  # NaN without an overshoot


def test_the_shipped_law_is_where_its_form_starts() -> None:
    form, law = FORMS["modal_plan"], load_law("modal_plan")
    begun = candidate_law(form, make_template("modal_plan", law.title), form.start)
    assert (begun.plan, begun.load_feedback) == (law.plan, law.load_feedback)
    assert begun.direct_gain == law.direct_gain


def test_the_linear_plants_say_what_the_simulation_does() -> None:
    """Sway with the heaviest cab at a tenth of the amplitude, where neither the rate limit acts nor
    the valves' mean opening damps: -90 deg within 5 %, peak within 0.5 dB."""
    law = load_law("modal_plan")
    performance = evaluate(law, [linear_cab(Hexapod("ifd"))], (1,))
    hydraulics = with_valve_gains(load_hydraulics("hardware"), 1)
    machine = {"cab": "ifd", "hydraulics": hydraulics, "amplitude": 0.1 * AMPLITUDE}
    measures = run_case(make_case(law, "sway", quick=True, **machine)).measures
    sway = DOFS.index("sway")
    assert measures.phase_bandwidth_hz == pytest.approx(performance.phase_hz[0, 0, sway], rel=0.05)
    assert measures.peak_gain_db == pytest.approx(performance.peak_db[0, 0, sway], abs=0.5)


def test_a_search_repeats_and_its_file_is_the_law(tmp_path: Path) -> None:
    template = make_template("mine", "Mine", ("gfd",))
    first, second = (search(template, seeds=(None,), evaluations=1) for _ in range(2))
    assert first.law == second.law and first.evaluations == 12
    form = FORMS["modal_plan"]
    begun = evaluate(candidate_law(form, template, form.start), template.cabs, (None,))
    assert first.performance.phase_hz.min() > 0.95 * begun.phase_hz.min()
    path = save_law(first.law, tmp_path / "laws" / "mine.toml", "By a test.")
    back = load_law(path)
    assert back.plan == first.law.plan and back.load_feedback == first.law.load_feedback
    text = path.read_text()
    assert save_law(back, path, "By a test.").read_text() == text
    assert [p.name for p in path.parent.iterdir()] == ["mine.toml"]


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
def test_every_form_starts_within_its_bounds_and_makes_a_law_that_is_stable(form: Form) -> None:
    for number in form.free.values():
        assert number.low <= number.start <= number.high
    template = make_template("mine", "Mine", ("gfd",))
    performance = evaluate(candidate_law(form, template, form.start), template.cabs, (None,))
    assert performance.tail.max() < 0.2
    assert performance.phase_hz.min() > 1.0


@pytest.mark.slow
def test_limits_cost() -> None:
    """A law that breaks the limits costs more than the same with wider ones."""
    template = make_template("mine", "Mine", ("ifd",))
    tight = search(
        template, Requirements(peak_db=-1.0, overshoot=-0.2), seeds=(None,), evaluations=1
    )
    wide = search(template, Requirements(9.0, 9.0, 9.0, 9.0, 99.0), seeds=(None,), evaluations=1)
    assert tight.cost > 0.0 > wide.cost


def test_bad_requests_are_named() -> None:
    template = make_template("mine", "Mine", ("gfd",))
    with pytest.raises(ValueError, match="form: 'magic' is not one of modal_plan, velocity"):
        search(template, form="magic")
    with pytest.raises(ValueError, match="evaluations: 0 must be at least 1"):
        search(template, evaluations=0)
    excavator = Plant.__new__(Plant)
    excavator.name, excavator.actuators = "excavator", ("boom", "stick")
    with pytest.raises(ValueError, match="excavator has 2 legs; hydraulic modes need 6"):
        nominal_modes(excavator)


def rubbing(force: float) -> Cab:
    """The payload of the laboratory machine with dry friction in its legs [N]."""
    machine, number = load_machine("lab"), {"value": force, "unit": "N", "status": "assumed"}
    dry = dict.fromkeys(("coulomb_friction", "breakaway_friction"), number | {"source": "a test"})
    assert isinstance(machine.hydraulics, Mapping)
    changes = {"name": "rubbing", "mjcf": None, "hydraulics": {**machine.hydraulics, **dry}}
    return load_cab(None, machine.model_copy(update=changes))


def with_load_gain(share: float) -> Law:
    """The laboratory machine's law with another share of load feedback in its light modes."""
    law = load_law(load_machine("lab").law)
    assert law.load_feedback is not None
    gain = np.array(law.load_feedback.gain) * ([1.0] * 2 + [share] * 4)
    feedback = law.load_feedback.model_copy(update={"gain": tuple(gain.tolist())})
    return law.model_copy(update={"load_feedback": feedback})


def test_plants_without_friction_are_those_of_the_machine_that_has_none() -> None:
    template = make_template("mine", "Mine", [rubbing(60.0)], 0.02)
    (without,), (smooth,) = template.frictionless, make_template("mine", "", [rubbing(0.0)]).cabs
    for one, other in zip(without.matrices, smooth.matrices, strict=True):
        np.testing.assert_array_equal(one, other)
    assert np.abs(template.cabs[0].matrices[0] - smooth.matrices[0]).max() > 1e-3
    chosen = make_template("mine", "Mine", [rubbing(60.0)], "none")
    assert chosen.frictionless is chosen.cabs


@pytest.mark.parametrize("name", ["velocity", "modal_plan"])
def test_the_least_damping_is_that_of_the_poles(name: str) -> None:
    plant, law = Hexapod("gfd"), load_law(name)
    poles = Linear(plant).loop(law).poles()
    growth = np.log(poles[poles.imag > 1e-9])
    expected = float((-growth.real / np.abs(growth)).min())
    assert least_damping(law, [linear_cab(plant)]) == pytest.approx(expected, rel=1e-6)


def test_a_law_that_only_friction_damps_breaks_the_limit_by_as_much_as_it_lacks() -> None:
    template, law = make_template("mine", "Mine", [rubbing(60.0)], 0.02), with_load_gain(-0.5)
    grows = least_damping(law, template.frictionless)
    assert grows < 0.0 < 0.05 < least_damping(law, template.cabs)
    done, beyond = judge(law, template, Requirements(), (None,))
    assert beyond[:3] == (0.0, 0.0, 0.0) and beyond.margin_db == 0.0
    assert beyond.damping == pytest.approx(0.02 - grows, rel=1e-12)
    assert beyond.tail > 0.0 and done.tail.max() < 0.05  # it rings with faster valves
    tight = Requirements(done.peak_db.max() - 0.25, done.overshoot[..., :-1].max() - 0.125)
    _, beyond = judge(law, template, tight, (None,))
    assert beyond[:3] == pytest.approx((0.25, 0.125, 0.0), abs=1e-12)
    found = SearchResult(law, done, Requirements(0.25, 0.125, 0.0, 0.0, 0.0, 0.03), 0.0, 1)
    said = "limits not kept: peak by 0.25 dB, overshoot by 12.5 %, damping ratio by 0.030"
    assert found.verdict == said
    assert found._replace(excess=Requirements(*[0.0] * 6)).verdict.startswith(
        "all limits kept: peak, overshoot, "
    )


@pytest.mark.slow
def test_a_law_is_found_with_friction() -> None:
    """On the laboratory machine with 60 N in each leg."""
    cab = rubbing(60.0)
    template = make_template("mine", "Mine", [cab], 0.05)
    found = search(template, evaluations=96)
    assert found.verdict.startswith("all limits kept: ")
    assert least_damping(found.law, template.frictionless) >= Requirements().damping


@pytest.mark.slow
def test_tune_command(tmp_path: Path) -> None:
    out = tmp_path / "law.toml"
    said = cmf("tune", "--cabs", "gfd", "--evaluations", 1, "--peak", -9, "--file", out)
    assert "limits not kept: peak by " in said and "cmf compare --laws" in said
    assert "--evaluations 1 --seed 1" in load_law(out).source


@pytest.mark.slow
@pytest.mark.parametrize(
    ("table", "arguments", "written"),
    [
        (
            "confirm",
            "--cabs gfd --dofs heave --seeds 0 --quick --crosstalk --jobs 1 --out",
            ("trials.csv", "worst.md", "summary.md", "crosstalk.csv"),
        ),
        ("stiffness", "--out", ("laws.csv", "gains.md", "stiffness.png")),
    ],
)
def test_smoke_of_tables_of_laws(
    table: str,
    arguments: str,
    written: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(SCRIPTS)
    monkeypatch.setattr(sys, "argv", ["laws.py", table, *arguments.split(), str(tmp_path)])
    runpy.run_path(str(SCRIPTS / "laws.py"), run_name="__main__")
    for name in written:
        assert (tmp_path / name).stat().st_size > 50
