"""The report on one page: its tables, figures and studies."""

import base64
import re
from pathlib import Path
from typing import Any, NamedTuple

import control
import numpy as np
import pytest
from typer.testing import CliRunner

from cmf_mj import bandwidths, load_law
from cmf_mj.analysis.limit_cycle import limit_cycle
from cmf_mj.analysis.linear.assembly import linearize
from cmf_mj.analysis.linear.loop import DCL_INPUTS, closed_loop, dcl_state_space
from cmf_mj.analysis.linear.plants import FEEDBACK, leg_model, reduced
from cmf_mj.analysis.linear.poles import least_damped_mode
from cmf_mj.analysis.measures import Measures
from cmf_mj.analysis.published import published_results
from cmf_mj.cli.common import app
from cmf_mj.core.settings import read_toml
from cmf_mj.core.units import FRAME, PSI, STANDARD_GRAVITY
from cmf_mj.plant.single_legs import SingleLegs
from cmf_mj.report_2014.page import tables
from cmf_mj.report_2014.page.document import (
    Content,
    make_content,
    page_figure,
    render,
    save_page,
    sections_of,
)
from cmf_mj.report_2014.page.figures import FIGURES
from cmf_mj.report_2014.page.runs import Runs, RunSpec
from cmf_mj.report_2014.page.tables import TABLE_TITLES, PageTable, result_table
from cmf_mj.studies.case import CaseResult

GAINS = Path(__file__).with_name("gains.toml")  # as printed
SHOWN = ["2-12", "2-13", "3-20", "4-12", "4-13"]

REPORT_FIGURES = (
    "2-12 2-13 2-15 2-16 3-2 3-3 3-4 3-9 3-11 3-20 3-23 4-12 4-13 "
    "B-1 B-2 B-3 B-4 B-5 B-6 D-1 D-2 D-3 D-4 D-5"
)


@pytest.fixture(scope="module")
def content() -> Content:
    """Five figures and Table 2-4 from quick runs."""
    return make_content(SHOWN, ["2-4"], jobs=2, quick=True)


@pytest.fixture(scope="module")
def page(content: Content, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_page(content, tmp_path_factory.mktemp("report"))


def test_every_result_table_of_the_report_is_there() -> None:
    assert " ".join(figure.number for figure in FIGURES) == REPORT_FIGURES
    assert set(TABLE_TITLES) == {row.table for row in published_results()}


def test_figures_are_readable_and_say_where_the_machine_is_a_stand_in(
    content: Content, drawn: dict[str, set[str]]
) -> None:
    for figure in content.figures:
        caption = page_figure(figure, content.runs).caption
        on_machine = any(need.plant == "machine" for need in figure.needs)
        assert ("stand-in" in caption) == on_machine, figure.number
        assert figure.title in drawn["figure.svg"]


@pytest.mark.slow
def test_page_is_the_same_for_any_number_of_jobs() -> None:
    chosen: Any = (["2-12", "2-13"], [])
    first, second = (render(make_content(*chosen, jobs=jobs, quick=True)) for jobs in (1, 2))
    assert first == second


def test_the_page_needs_no_network_and_stays_small(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert page.stat().st_size < 0.6e6
    assert not re.search(r'<(script|img|link|iframe)[^>]*(src|href)="(?!data:)', text)
    images = re.findall(r'<img src="data:image/svg\+xml;base64,([^"]+)"', text)
    assert len(images) == len(SHOWN)
    assert all(b"<svg" in base64.b64decode(image) for image in images)


def test_contents_lead_to_every_figure_and_table(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    anchors = re.findall(r' id="([^"]+)"', text)
    assert len(anchors) == len(set(anchors))
    links = re.findall(r'<a href="#([^"]+)"', text)
    assert set(links) <= set(anchors)
    assert {f"figure-{number}" for number in SHOWN} <= set(links)


def test_table_2_4_judges_each_row_by_its_tolerance(content: Content) -> None:
    rows = tables.result_rows(content.runs, "2-4")
    assert [(row.source, row.quantity) for row in rows] == [
        (of, quantity)
        for of in ("hardware", "model")
        for quantity in ("-90 deg", "-3 dB", "damping ratio")
    ]
    allowed = {"-90 deg": 0.1, "-3 dB": 0.12, "damping ratio": 0.1}
    for row in rows:
        limit = 0.1 if row.source == "hardware" else allowed[row.quantity]
        off = row.computed - row.printed
        expected = abs(off if row.quantity == "damping ratio" else off / row.printed) <= limit
        assert row.within == expected


def altered(runs: Runs, factor: float) -> Runs:
    """The same runs with other -90 deg bandwidths."""
    results: dict[RunSpec, Any] = {}
    for key, result in runs.results.items():
        if isinstance(result, CaseResult):
            phase = factor * result.measures.phase_bandwidth_hz
            measures = result.measures._replace(phase_bandwidth_hz=phase)
            result = result._replace(measures=measures)
        results[key] = result
    return Runs(results, runs.quick)


def test_a_slower_model_falls_outside_and_is_coloured(content: Content) -> None:
    before = tables.result_rows(content.runs, "2-4")
    after = tables.result_rows(altered(content.runs, 0.6), "2-4")
    assert all(row.within for row in before if row.quantity == "-90 deg")
    assert [row.quantity for row in after if row.within is False].count("-90 deg") == 2
    slow = Content(altered(content.runs, 0.6), (), ("2-4",))
    chapter = next(s for s in sections_of(slow) if s.anchor == "chapter-2")
    judged = next(b for b in chapter.blocks if isinstance(b, PageTable) and b.anchor == "table-2-4")
    verdict = judged.table.header.index("verdict")
    assert [row[verdict] for row in judged.table.cells[::3]] == ["outside", "outside"]
    assert render(slow).count('<td class="outside">') == 2


def test_the_summary_is_left_out_of_a_part(content: Content) -> None:
    anchors = {section.anchor for section in sections_of(content)}
    assert "summary" not in anchors
    assert "provenance" in anchors


@pytest.mark.parametrize("printed", read_toml(GAINS)["gains"], ids=lambda one: one["law"])
def test_shipped_gains_are_the_printed_ones_but_for_two_readings(printed: dict[str, Any]) -> None:
    """Digits of B exchanged in print, which would not track, and a force without its sign."""
    law, signals = load_law(printed["law"]), printed["signals"]
    ours = {
        "a": law.state_gain,
        "b": [getattr(law.input_gain, name) for name in signals],
        "c": law.output_gain,
        "d": [getattr(law.direct_gain, name) for name in signals],
    }
    differs = {name for name, value in ours.items() if value != printed[name]}
    assert differs == {"original": {"b"}, "force": {"d"}}.get(law.name, set())


@pytest.mark.parametrize(
    ("law", "expected"),
    [("velocity", 47.0 / 50.48), ("original", 0.998), ("original_as_printed", 0.166)],
)
def test_steady_state_of_a_law_follows_from_its_gains(law: str, expected: float) -> None:
    """The gain of the demand over the net gain of the position, D_p + C B_p / (1 - A)."""
    gains = load_law(law)
    through = gains.output_gain * float(gains.input_gain.position) / (1.0 - gains.state_gain)
    net = float(gains.direct_gain.position) + through
    assert -float(gains.direct_gain.reference) / net == pytest.approx(expected, abs=5e-4)
    leg = reduced(leg_model(linearize(SingleLegs("report")), 1), outputs=FEEDBACK[:3])
    loop = closed_loop(law, leg)  # pressures zero
    assert float(np.real(control.dcgain(loop)).item()) == pytest.approx(expected, abs=5e-4)


class Oscillation(NamedTuple):
    """Least damped pair of force feedback around a leg, and where its open loop turns whole."""

    pole_hz: float
    pole_damping: float  #: Negative where it grows.
    crossover_hz: float
    crossover_gain: float  #: Above 1 the loop oscillates.


@pytest.fixture(scope="module")
def oscillation() -> Oscillation:
    law, leg = load_law("force"), leg_model(linearize(SingleLegs("report")), 1)
    # Slower pairs belong to the law's integrator, not to an oscillation.
    poles = closed_loop(law, leg).poles()
    damping, hertz = least_damped_mode(poles, 200.0, lowest_hz=4.0, frame=law.frame)
    line = np.geomspace(2.0, 100.0, 4000)
    omega, sampled = 2.0 * np.pi * line, control.sample_system(leg, law.frame, copy_names=True)
    plant = control.frequency_response(sampled, omega).frdata[:, 0, :]
    dcl = control.frequency_response(dcl_state_space(law), omega).frdata[0]
    rows = {name: plant[sampled.output_labels.index(name)] for name in FEEDBACK}
    loop = sum(dcl[DCL_INPUTS.index(name)] * rows[name] for name in FEEDBACK)
    loop = loop * np.exp(-1j * omega * law.frame)
    turns = np.flatnonzero((loop.imag[1:] * loop.imag[:-1] < 0.0) & (loop.real[1:] > 0.0))
    at = turns[np.argmax(np.abs(loop[turns]))]
    return Oscillation(hertz, damping, float(line[at]), float(np.abs(loop[at])))


def test_the_loop_at_its_crossover_and_unit_gain_has_poles_on_the_circle(
    oscillation: Oscillation,
) -> None:
    """Scaled by one over its gain there, the law keeps an undamped oscillation."""
    law, unstable = load_law("force"), oscillation
    assert unstable.crossover_gain > 1.0 > 0.0 > unstable.pole_damping
    gains = law.direct_gain.model_dump()
    scaled = law.model_copy(
        update={
            "direct_gain": law.direct_gain.model_copy(
                update={name: value / unstable.crossover_gain for name, value in gains.items()}
            ),
            "output_gain": law.output_gain / unstable.crossover_gain,
        }
    )
    leg = leg_model(linearize(SingleLegs("report")), 1)
    poles = np.log(closed_loop(scaled, leg).poles().astype(complex)) / FRAME
    near = poles[np.argmin(np.abs(poles - 2j * np.pi * unstable.crossover_hz))]
    assert near.imag / (2.0 * np.pi) == pytest.approx(unstable.crossover_hz, rel=2e-3)
    assert abs(near.real) / abs(near) < 2e-3


def test_the_leg_rings_between_crossover_and_poles_and_not_at_25_hz(
    content: Content, oscillation: Oscillation
) -> None:
    linear = oscillation
    frequency, amplitude, acceleration = limit_cycle(content.runs.case("model", "force").step)
    assert linear.crossover_hz < frequency < 1.01 * linear.pole_hz + 0.25
    assert frequency < 0.6 * 25.0
    assert amplitude > 500.0 * PSI
    assert acceleration > STANDARD_GRAVITY
    result = content.runs.case("model", "force")
    assert result.response is not None
    swept = bandwidths(result.response)
    assert swept.phase_hz == pytest.approx(5.5, rel=0.1)
    assert swept.peak_db == pytest.approx(1.0, abs=0.5)
    assert not result.measures.stable
    assert np.isnan(result.measures.phase_bandwidth_hz)


def test_what_rings_on_shows_its_mark_and_does_not_agree(content: Content) -> None:
    """The same runs, the steps of the stand-in called unstable."""
    results: dict[RunSpec, Any] = dict(content.runs.results)
    for key, result in results.items():
        if isinstance(result, CaseResult) and key.plant == "machine":
            results[key] = result._replace(measures=Measures())
    ringing = Runs(results, content.runs.quick)
    table = result_table(ringing, "2-4").table
    columns = [table.header.index(name) for name in ("source", "computed", "deviation", "verdict")]
    shown = [[row[column] for column in columns] for row in table.cells]
    hardware = [row[1:] for row in shown if row[0] == "hardware"]
    assert hardware == [["unstable", "-", "outside"]] * 3
    assert all(row[1] != "unstable" for row in shown if row[0] != "hardware")


@pytest.mark.slow
def test_report_command_writes_the_page_and_counts_verdicts(tmp_path: Path) -> None:
    arguments = ["report", "--quick", "--figures", "2-13", "--tables", "section 3.2.2"]
    result = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    assert "1 figures" in result.output
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Figure 2-13" in text
    assert "section 3.2.2" in result.output
