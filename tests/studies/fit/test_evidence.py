"""What is stated of a machine: how it counts, that shipped sets meet it, that numbers return."""

from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import tomlkit

import cmf_mj
from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.analysis.linear.loop import loop_response
from cmf_mj.analysis.published import published_results
from cmf_mj.analysis.step_response import step_metrics
from cmf_mj.core.errors import InputError
from cmf_mj.studies.case import make_case
from cmf_mj.studies.fit import doubt as doubts
from cmf_mj.studies.fit import engine
from cmf_mj.studies.fit import evidence as evidence_module
from cmf_mj.studies.fit.campaign import FILE, SHIPPED, Campaign, load_campaign
from cmf_mj.studies.fit.doubt import StatedNumber, compare_stated, doubt
from cmf_mj.studies.fit.engine import fit
from cmf_mj.studies.fit.evidence import Evidence, Statement
from cmf_mj.studies.fit.results import numbers, physical

SPEED = {"path": "hydraulics.leg_speed", "low": 0.6, "high": 1.6, "unit": "1", "source": "test"}
TRUE = 1.15


def shipped(name: str, laws: tuple[str, ...]) -> Campaign:
    """A shipped campaign with the evidence of these laws alone."""
    campaign = load_campaign(name)
    kept = [one for one in campaign.evidence.statements if one.law in laws]
    evidence = campaign.evidence._replace(statements=tuple(kept), shift=np.zeros(len(kept)))
    return campaign._replace(evidence=evidence)


def least(leg_speed: float) -> dict[str, tuple[float, bool]]:
    """Least damping ratio of the velocity law and its verdict by cab, at a leg speed [in/s/%]."""
    campaign = shipped("hardware", ("velocity",))
    plant = campaign.unknowns.apply({"leg_speed": leg_speed}, campaign.plant)
    found = campaign.evidence.linear_numbers({"leg_speed": leg_speed}, plant)
    rows = zip(campaign.evidence.statements, found.value, found.stable, strict=True)
    return {one.cab: (float(x), bool(ok)) for one, x, ok in rows if one.field == "least_damping"}


# -- what a statement counts ----------------------------------------------------------------------


def test_a_statement_counts_by_its_deviation() -> None:
    """Frequencies by their logarithm, ratios as they are, least ones by what they fall short."""

    def one(field: str, value: float, deviation: float) -> Statement:
        return Statement("mine", "it", field, "velocity", "heave", "", 0.0, value, deviation, False)

    assert one("phase_bandwidth_hz", 2.0, 0.1).excess(2.0 * np.exp(-0.1)) == pytest.approx(1.0)
    assert one("damping_ratio", 0.4, 0.1).excess(0.5) == pytest.approx(-1.0)
    assert one("least_damping", 0.03, 0.01).excess(0.01) == pytest.approx(2.0)
    assert one("least_damping", 0.03, 0.01).excess(0.5) == 0.0
    assert one("gain_bandwidth_hz", 2.0, 0.1).excess(np.nan) == 8.0
    assert one("gain_bandwidth_hz", 2.0, 0.1).excess(np.inf) == 8.0
    assert one("least_damping", 0.03, 0.01).excess(np.nan) == 8.0
    assert one("phase_deg", -185.0, 5.0).excess(176.0) == pytest.approx(-0.2)
    assert one("phase_deg", 175.0, 5.0).excess(-176.0) == pytest.approx(-1.8)


def test_least_damping_is_looked_for_in_the_frames_of_the_loop() -> None:
    """A mode of 13.6 Hz at 500 Hz; a stable loop without modes is damped, another is not."""
    mode = 2.0 * np.pi * 13.6 * (-0.4 + 1j * np.sqrt(1.0 - 0.16))
    poles = np.exp(np.array([mode, np.conj(mode)]) / 500.0)
    assert evidence_module._least_damping(poles, 1.0 / 500.0) == pytest.approx(0.4)
    assert evidence_module._least_damping(np.array([0.5 + 0j]), 1.0 / 500.0) == 1.0
    assert np.isnan(evidence_module._least_damping(np.array([1.5 + 0j]), 1.0 / 500.0))


def test_a_simulation_binds_its_law_to_the_cab_of_the_statement(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A law in hydraulic modes on another cab; what is shifted is not shifted again."""
    stated = {"source": "a", "law": "modal_feedback", "cabs": ["rfd"], "damping_ratio": 0.4}
    made = load_campaign(written(tmp_path, {"mine": stated}, machine="cmf", cab="gfd")).evidence

    def no_runs(_: Any, cases: list[Any], __: int) -> list[Any]:
        measures = SimpleNamespace(damping_ratio=0.9)
        return [SimpleNamespace(measures=measures, response=None) for _ in cases]

    monkeypatch.setattr(evidence_module, "on_threads", no_runs)
    once = made.with_shift(1)
    assert once.shift[0] != 0.0
    assert once.with_shift(1).shift[0] == once.shift[0]


def test_a_campaign_changes_its_base_inside_evidence(tmp_path: Path) -> None:
    """One number of one piece of evidence, with all others as shipped."""
    changed = {"base": "hardware", "evidence": {"velocity": {"phase_bandwidth_hz": 3.1}}}
    (tmp_path / FILE).write_text(tomlkit.dumps(changed), encoding="utf-8")
    base, own = (load_campaign(x).evidence.statements for x in ("hardware", tmp_path))
    differ = [(a.evidence, a.field, b.value) for a, b in zip(base, own, strict=True) if a != b]
    assert differ == [("velocity", "phase_bandwidth_hz", 3.1)]


def test_an_unknown_is_named_once(tmp_path: Path) -> None:
    stated = {"mine": {"source": "a", "damping_ratio": 0.4}}
    for name, path in (("speed", "hydraulics.leak_rate"), ("again", SPEED["path"])):
        held = {name: SPEED | {"path": path}}
        with pytest.raises(InputError, match="is unknown or held twice"):
            load_campaign(written(tmp_path, stated, held=held))


def test_single_legs_carry_no_cabs(tmp_path: Path) -> None:
    stated = {"mine": {"source": "a", "damping_ratio": 0.4, "cabs": ["gfd"]}}
    with pytest.raises(InputError, match="cabs: is refused: single legs carry none"):
        load_campaign(written(tmp_path, stated, machine="cmf", plant="single_legs"))


def test_shipped_campaigns_state_what_is_published() -> None:
    """Every number of a law is one of its published results in heave."""
    for name, of in (("report", "nonlinear"), ("hardware", None), ("hardware_lag", None)):
        for one in load_campaign(name).evidence.statements:
            if one.field == "least_damping":
                continue
            printed = {
                getattr(row, one.field)
                for row in published_results()
                if (row.law, row.dof) == (one.law, "heave") and of in (None, row.of)
            }
            assert one.value in printed, (name, one)


def test_shipped_values_lie_within_their_ranges() -> None:
    for name in SHIPPED:
        campaign = load_campaign(name)
        for known in (*campaign.unknowns.values(), *campaign.settings.held.values()):
            root, field = known.path.split(".")
            if root == "hydraulics":
                value = getattr(campaign.plant.parameters, field).si
                ends = [known.number(1.0, known.at(share)) for share in (0.0, 1.0)]
                assert ends[0] <= value * (1.0 + 1e-12) and value <= ends[1] * (1.0 + 1e-12)


# -- what the shipped sets must meet --------------------------------------------------------------


def test_report_set_meets_the_non_linear_rows() -> None:
    """-90 deg within 10 %, -3 dB within 12 %, damping within 0.1, by the simulation. Velocity error
    feedback rings on after a step: of it the sweep alone is compared."""
    laws = ("original", "velocity", "velocity_integral", "position_error_rate", "velocity_error")
    campaign = shipped("report", (*laws, "acceleration"))
    found = campaign.evidence.simulated_numbers({}, campaign.plant, 2)
    for one, value in zip(campaign.evidence.statements, found, strict=True):
        if (one.law, one.field) != ("velocity_error", "damping_ratio"):
            assert abs(one.excess(float(value))) <= 1.0, (one, value)


def test_hardware_set_meets_the_hardware_rows_and_linear_loops_predict_it() -> None:
    """Tables 2-4 and 2-6: bandwidths within 10 %, damping within 0.1; linear widths within 5 %."""
    campaign = shipped("hardware", ("original", "velocity"))
    found = campaign.evidence.simulated_numbers({}, campaign.plant, 2)
    linear = campaign.evidence.linear_numbers({}, campaign.plant).value
    for one, value, other in zip(campaign.evidence.statements, found, linear, strict=True):
        assert abs(one.excess(float(value))) <= 1.0, (one, value)
        if one.field.endswith("bandwidth_hz"):
            assert other == pytest.approx(value, rel=0.05)


def test_velocity_law_is_damped_with_every_cab() -> None:
    assert min(ratio for ratio, _ in least(0.35).values()) > 0.03
    ratio, stable = least(0.4)["ifd"]  # why the leg speed cannot be higher
    assert ratio < 0.0 and not stable


def test_step_runs_judge_as_the_linear_loop() -> None:
    """IFD in sway: stable as shipped, unstable at 0.42 in/s per %."""
    unknowns = load_campaign("hardware").unknowns
    for speed, verdict in ((0.35, True), (0.42, False)):
        oil = unknowns.apply({"leg_speed": speed}, cmf_mj.load_hydraulics("hardware"))
        case = make_case("velocity", "sway", cab="ifd", hydraulics=oil)
        assert step_metrics(case.run(case.step(), rate=256)).stable == verdict
        assert least(speed)["ifd"][1] == verdict


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few machines are drawn."""
    monkeypatch.setattr(engine, "_DRAWS", 16)
    monkeypatch.setattr(doubts, "compare_stated", partial(compare_stated, samples=24))


# -- fits to evidence -----------------------------------------------------------------------------


def written(folder: Path, evidence: dict[str, Any], **more: Any) -> Path:
    """A campaign of evidence alone on the laboratory hexapod."""
    folder.mkdir(exist_ok=True)
    table = {"machine": "lab", "unknowns": {"speed": SPEED}, "evidence": evidence} | more
    (folder / FILE).write_text(tomlkit.dumps(table), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def response() -> list[list[float]]:
    """Surge under the laboratory hexapod's law at `TRUE` of its leg speed: [Hz, dB, deg]."""
    base = cmf_mj.Hexapod(machine="lab")
    oil = base.parameters
    speed = oil.leg_speed.model_copy(update={"value": TRUE * oil.leg_speed.value})
    plant = cmf_mj.Hexapod(None, oil.model_copy(update={"leg_speed": speed}), machine="lab")
    frequency = np.array([0.5, 1.0, 2.0, 4.0])
    loop = Linear(plant, friction="none").loop(base.machine.law, "surge")
    found = loop_response(loop, frequency).frdata[0, 0]
    rows = np.column_stack([frequency, 20.0 * np.log10(np.abs(found)), np.degrees(np.angle(found))])
    return [[float(x) for x in row] for row in rows]


def test_a_response_gives_the_speed_of_another_machine(
    response: list[list[float]], tmp_path: Path
) -> None:
    """A stated response of the laboratory hexapod: its leg speed returns, the interval holds it."""
    stated_ = {"surge": {"source": "test", "dof": "surge", "response": response}}
    posterior = fit(written(tmp_path / "campaign", stated_), tmp_path / "out")
    nominal = posterior.campaign.plant.parameters.leg_speed.si
    low, high = physical(posterior, posterior.bounds())[:, 0]
    assert low < TRUE * nominal < high
    assert physical(posterior, posterior.z)[0] == pytest.approx(TRUE * nominal, rel=0.01)
    assert numbers(posterior).rows[0][-1] == "yes"
    again = fit(tmp_path / "campaign", tmp_path / "out", progress=lambda _: None)
    assert np.array_equal(again.z, posterior.z)  # from its journal
    found = doubt(posterior, effects=False)
    assert found.is_explained, found.verdict
    assert found.verdict == "The model explains what is stated: all is close."
    assert {one.role for one in found.stated} == {"fitted"}
    assert all(one.low <= one.fitted <= one.high for one in found.stated)


def test_what_is_held_back_speaks_against_the_model(
    response: list[list[float]], tmp_path: Path
) -> None:
    """A damping ratio that no such machine has is not fitted, and the verdict names it."""
    wrong = {"source": "test", "dof": "surge", "peak_gain_db": 20.0, "held_back": ["peak_gain_db"]}
    right = {"source": "test", "dof": "surge", "response": response}
    path = written(tmp_path / "campaign", {"right": right, "wrong": wrong})
    found = doubt(fit(path, tmp_path / "out"), effects=False)
    assert not found.is_explained
    assert "The model does not explain what is stated." in found.verdict
    assert "wrong, peak [dB]: held back, stated 20, the fitted machine has" in found.verdict


@pytest.mark.slow
def test_fit_finds_known_numbers_through_a_biased_linear_model(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """ "Simulations" that are linear results 4 % up, and stated values made at known numbers."""
    campaign = shipped("report", ("velocity", "position_error_rate"))
    truth = {"leg_speed": 0.3, "derivative_pole": 80.0}

    def biased(self: Evidence, values: Any, plant: Any, jobs: int) -> Any:
        del jobs
        found = (
            self._replace(shift=np.zeros(len(self.statements))).linear_numbers(values, plant).value
        )
        return np.where(
            [one.field == "damping_ratio" for one in self.statements], found, 1.04 * found
        )

    # Its gain is so flat that -3 dB jumps from 6 to 11 Hz between neighbouring machines.
    kept = [
        one
        for one in campaign.evidence.statements
        if (one.law, one.field) != ("position_error_rate", "gain_bandwidth_hz")
    ]
    evidence = campaign.evidence._replace(statements=tuple(kept), shift=np.zeros(len(kept)))
    campaign = campaign._replace(evidence=evidence)
    made = biased(campaign.evidence, truth, campaign.unknowns.apply(truth, campaign.plant), 1)
    monkeypatch.setattr(Evidence, "simulated_numbers", biased)
    moved = tuple(
        one._replace(value=float(value), deviation=0.01)
        for one, value in zip(campaign.evidence.statements, made, strict=True)
    )
    campaign = campaign._replace(evidence=campaign.evidence._replace(statements=moved))
    posterior = fit(campaign, tmp_path)
    speed, pole = physical(posterior, posterior.z)
    per_second = cmf_mj.load_hydraulics("report").leg_speed.si / 0.28
    assert speed == pytest.approx(0.3 * per_second, rel=5e-3)
    assert pole == pytest.approx(80.0, rel=0.05)


@pytest.mark.slow
def test_flown_holds_the_leg_speed_back(tmp_path: Path) -> None:
    """Asked for bandwidths out of reach, the fit stops where the loop with the IFD would ring."""
    campaign = shipped("hardware", ("velocity",))
    settings = campaign.settings.model_copy(update={"simulated": False})
    asked = {"phase_bandwidth_hz": 3.3, "gain_bandwidth_hz": 4.8}
    found = {}
    for flown in (True, False):
        kept = [
            one._replace(value=asked.get(one.field, one.value))
            for one in campaign.evidence.statements
            if one.field in asked or (flown and one.field == "least_damping")
        ]
        evidence = campaign.evidence._replace(statements=tuple(kept), shift=np.zeros(len(kept)))
        one = campaign._replace(settings=settings, evidence=evidence)
        posterior = fit(one, tmp_path / str(flown))
        speed = physical(posterior, posterior.z)[0] / 2.54  # in/s/%
        found[flown] = speed, least(speed)["ifd"][0]
    assert found[True][0] < found[False][0] - 0.002
    assert found[True][1] > found[False][1]


# -- spread and files -----------------------------------------------------------------------------


@pytest.mark.slow
def test_spread_holds_what_is_fitted_and_repeats(tmp_path: Path) -> None:
    """Numbers that are held widen it; same seed, same numbers."""
    known = {"source": "test", "dof": "heave", "phase_bandwidth_hz": 8.0}
    lag = {"path": "hydraulics.drive_lag", "low": 0.5, "high": 2.0, "unit": "1", "source": "test"}
    rows: dict[bool, list[StatedNumber]] = {}
    for held in (False, True):
        more = {"held": {"lag": lag}} if held else {}
        path = written(tmp_path / f"{held}", {"heave": known}, **more)
        posterior = fit(path, tmp_path / f"{held}.out")
        rows[held] = compare_stated(posterior, samples=16)
    assert rows[True] == compare_stated(posterior, samples=16)
    (narrow,), (wide,) = rows[False], rows[True]
    assert wide.high - wide.low > 1.2 * (narrow.high - narrow.low)


@pytest.mark.parametrize(
    ("evidence", "message"),
    [
        ({"source": "a"}, "evidence.mine: states nothing; allowed: phase_bandwidth_hz"),
        (
            {"source": "a", "damping_ratio": 0.4, "held_back": ["peak_gain_db"]},
            "held_back: 'peak_gain_db' is not stated; allowed: damping_ratio",
        ),
        ({"source": "a", "damping_ratio": 1.4}, "damping_ratio"),
        ({"source": "a", "damping_ratio": 0.4, "law": "moon"}, "'moon' is not one of"),
        (
            {"source": "a", "damping_ratio": 0.4, "held_back": ["damping_ratio"]},
            "has nothing to fit; allowed: recordings or evidence, one of them not held back",
        ),
    ],
)
def test_evidence_that_cannot_be_used_is_named(
    evidence: dict[str, Any], message: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=message):
        load_campaign(written(tmp_path, {"mine": evidence}))
