"""One plant and law, measured in every way the project has: the figures agree."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest
from shared import cmf

from cmf_mj import Hexapod, SingleLegs, bandwidths, frequency_response, signals, simulate
from cmf_mj.analysis.frequency_response import matrix_frequency_response, rounds_response
from cmf_mj.core.threads import on_threads
from cmf_mj.plant.plant import Plant
from cmf_mj.record.columns import read_mapped, write_facility_csv
from cmf_mj.record.record import Record
from cmf_mj.signals import composite
from cmf_mj.studies.case import AMPLITUDE, RECORDER, make_case


def written(plant: str, folder: Path) -> list[Path]:
    """The five files of a session; its records, which are large, are gone."""
    rounds = [composite.seven_sines("heave", AMPLITUDE, number) for number in range(1, 6)]
    session = on_threads(make_case("velocity", "heave", plant).run, rounds)
    return [write_facility_csv(r, folder / f"{i}of5.csv") for i, r in enumerate(session, start=1)]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return written("single_legs", tmp_path_factory.mktemp("session"))


@pytest.mark.parametrize("build", [SingleLegs, pytest.param(Hexapod, marks=pytest.mark.slow)])
def test_four_excitations_agree_on_the_phase_bandwidth_within_3_percent(
    build: type[Plant], tmp_path: Path
) -> None:
    """Multisine, chirp, stepped sines and the five stitched files, all of 0.33 in peak."""
    plant = build()

    def run(command: signals.Command) -> Record:
        return simulate(plant, "velocity", command, record_every=plant.machine.rate // RECORDER)

    steps = np.arange(1.8, 3.7, 0.3)
    read = [read_mapped(path) for path in written(plant.name, tmp_path)]
    responses = {
        "multisine": frequency_response(run(signals.multisine("heave", AMPLITUDE))),
        "chirp": frequency_response(run(signals.chirp("heave", AMPLITUDE))),
        "stepped sines": rounds_response(
            [run(composite.stepped_sines("heave", steps, [AMPLITUDE]))]
        ),
        "five files": rounds_response(read, "heave"),
    }
    phase = {name: bandwidths(response).phase_hz for name, response in responses.items()}
    middle = float(np.median(list(phase.values())))
    for name, value in phase.items():
        assert value == pytest.approx(middle, rel=0.015), (name, phase)  # so 3 % end to end


def test_rounds_read_the_35_frequencies_of_table_2_3(files: list[Path]) -> None:
    response = rounds_response([read_mapped(path) for path in files], "heave")
    expected = sorted(f for row in composite.ROUNDS for f in row)
    np.testing.assert_allclose(response.frequency, expected, rtol=1e-12)
    assert response.coherence.min() > 0.99


def test_files_without_their_own_metadata_read_alike(files: list[Path], tmp_path: Path) -> None:
    """As files of others come: no comment line, so no dwells. -90 deg within 3 %."""
    bare = []
    for path in files:
        kept = [line for line in path.read_text().splitlines() if not line.startswith("#")]
        target = tmp_path / path.name
        target.write_text("\n".join(kept) + "\n")
        bare.append(read_mapped(target))
    with_dwells = bandwidths(rounds_response([read_mapped(p) for p in files], "heave"))
    without = bandwidths(rounds_response(bare, "heave"))
    assert without.phase_hz == pytest.approx(with_dwells.phase_hz, rel=0.03)


def test_the_report_joins_its_files_and_finds_the_same_bandwidths(files: list[Path]) -> None:
    """Appendix A's estimator over the five files end to end, against fits over the whole cycles of
    each sine: 1 % of both bandwidths. The rests between do not spoil it."""
    read = [read_mapped(path) for path in files]
    fitted = bandwidths(rounds_response(read, "heave"))
    joined = rounds_response(read, "heave", estimator="report")
    spacing = read[0].rate / sum(record.time.size for record in read)
    np.testing.assert_allclose(np.diff(joined.frequency), spacing, rtol=1e-9)
    found = bandwidths(joined)
    assert found.phase_hz == pytest.approx(fitted.phase_hz, rel=0.01)
    assert found.gain_hz == pytest.approx(fitted.gain_hz, rel=0.01)
    with pytest.raises(ValueError, match="estimator: 'h2' is not one of h1, report"):
        rounds_response(read, "heave", estimator="h2")


def test_the_matrix_of_one_run_has_the_single_axis_responses_on_its_diagonal() -> None:
    """Six degrees of freedom at once at a tenth of the report's amplitudes, single legs: 3 % of
    the small-signal response between 0.5 and 5 Hz, and heave is driven by heave alone."""
    plant = SingleLegs()
    sizes = np.array([1.0, 1.0, 1.0, 0.4, 0.4, 0.4]) * 0.1 * AMPLITUDE
    command = composite.orthogonal_multisines(sizes, period=40.0)
    matrix = matrix_frequency_response(simulate(plant, "velocity", command, record_every=16))
    frequency = np.asarray(matrix.omega) / (2.0 * np.pi)
    inside = (frequency > 0.5) & (frequency < 5.0)
    small = signals.multisine("heave", 0.1 * AMPLITUDE)
    single = frequency_response(simulate(plant, "velocity", small, record_every=16))
    expected = np.interp(frequency[inside], single.frequency, np.abs(single.response))
    np.testing.assert_allclose(np.abs(matrix.frdata[2, 2, inside]), expected, rtol=0.03)
    for column in (0, 1):
        assert np.abs(matrix.frdata[2, column, inside]).max() < 0.02
    with pytest.raises(ValueError, match="orthogonal multisines are needed"):
        matrix_frequency_response(simulate(plant, "velocity", signals.sine("heave", 0.01, 2.0)))


def test_rounds_of_different_rates_or_without_demand_are_refused() -> None:
    sine = signals.sine("heave", 0.01, 2.0)
    coarse, fine = (
        simulate(SingleLegs(), "velocity", sine, record_every=every) for every in (16, 8)
    )
    with pytest.raises(ValueError, match="records: none given"):
        rounds_response([])
    with pytest.raises(ValueError, match="dof: the records hold no demand in yaw"):
        rounds_response([coarse], "yaw")
    with pytest.raises(ValueError, match=r"records: rates are 128\.0, 256\.0 Hz"):
        rounds_response([coarse, fine])


def test_files_are_measured_from_the_command_line(files: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "m"
    assert re.search(r"-90 deg bandwidth +2\.7", cmf("measure", *files, "--out", out))
    cmf("measure", *files, "--estimator", "report", "--out", tmp_path / "j")
    with (tmp_path / "j" / "measures.csv").open() as file:
        found = {row["measure"]: row["value"] for row in csv.DictReader(file)}
    assert float(found["-90 deg bandwidth"].removesuffix(" Hz")) == pytest.approx(2.7, abs=0.05)
    written = ["measures.csv", "response.csv", "response.png"]
    assert sorted(path.name for path in out.iterdir()) == written
