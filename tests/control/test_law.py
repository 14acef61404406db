"""Laws as data: the published tables, a user's own file, and every way to get one wrong."""

from pathlib import Path

import numpy as np
import pytest

from cmf_mj import InputError, law_names, load_law
from cmf_mj.control.law import SIGNALS

NAMES = (
    "original",
    "original_as_printed",
    "velocity",
    "velocity_integral",
    "position_error_rate",
    "velocity_error",
    "combined_rate",
    "combined_rate_1_8",
    "acceleration",
    "acceleration_eq_3_6",
    "acceleration_opposing",
    "acceleration_d2",
    "force",
)

PRESSURES = {"cap_pressure": -1.949e-7, "rod_pressure": 9.816e-8}

INTEGRAL = {"error_integral": 50.0}
"""Gain on the integral: 50 in Table 3-4; section 3.3 has all laws of section 3.3 and later
run with it."""

REPORT = (0.914, -37.1759, 1.0)  #: A, C and B on position from Table 2-5 on.
BASE = {"reference": 49.0, "position": 381.8}
RATE = BASE | {"position_error_rate": 2.2}
FIELD = {"acceleration_eq_3_6": 0.01, "acceleration": 0.01, "acceleration_opposing": -0.01}
"""Table 3-3: + as printed, - as Eq 3.4."""

TABLES = {
    # Table 2-2: A, C, B on position, D; B is 0.1079 (two digits transposed in print).
    "original": ((0.914, -149.8, 0.1079), {"reference": 21.91, "position": 166.0}),
    "original_as_printed": ((0.914, -149.8, 0.1709), {"reference": 21.91, "position": 166.0}),
    # Table 2-5
    "velocity": (REPORT, BASE | {"reference": 47.0, "velocity": -2.3}),
    "velocity_integral": (REPORT, BASE | {"reference": 47.0, "velocity": -2.3} | INTEGRAL),
    # Table 3-1, three sets
    "position_error_rate": (REPORT, RATE | INTEGRAL),
    "velocity_error": (REPORT, BASE | {"velocity_error": 2.8} | INTEGRAL),
    "combined_rate": (REPORT, RATE | {"velocity": -0.5} | INTEGRAL),
    "combined_rate_1_8": (
        REPORT,
        BASE | {"position_error_rate": 1.8, "velocity": -0.5} | INTEGRAL,
    ),
    **{name: (REPORT, RATE | {"acceleration": gain} | INTEGRAL) for name, gain in FIELD.items()},
    # 0.06 derived from Table D-2
    "acceleration_d2": (REPORT, RATE | {"acceleration": 0.06} | INTEGRAL),
    # Table 3-4; force opposing
    "force": (
        REPORT,
        BASE | {"reference": 48.8, "position_error_rate": 6.0, "force": -0.01} | INTEGRAL,
    ),
}

OWN = """
[mine]
title = "My law"
state_gain = 0.5
output_gain = -2.0
input_gain = { velocity = 0.25 }
direct_gain = { reference = 30, position = -30.0 }
derivative_pole = 60
integrator_limit = 10.0
integrator_trigger = -30.0
accelerometer_pole = 0.9
accelerometer_gain = 0.1
"""


def write(folder: Path, text: str, name: str = "mine.toml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_all_laws_of_the_report_are_shipped_in_its_order() -> None:
    assert law_names()[: len(NAMES)] == NAMES


def test_laws_of_this_project_follow_and_say_so() -> None:
    own = law_names()[len(NAMES) :]
    assert own == ("model_following", "model_reference_adaptive")
    for name in own:
        law = load_law(name)
        assert law.source.startswith("this project")
        assert law.reference_model is not None
    assert all(load_law(name).reference_model is None for name in NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_gains_are_the_published_ones(name: str) -> None:
    law = load_law(name)
    (state_gain, output_gain, input_gain), direct = TABLES[name]
    assert (law.name, law.state_gain, law.output_gain) == (name, state_gain, output_gain)
    assert law.input_gain.model_dump() == dict.fromkeys(SIGNALS, 0.0) | {"position": input_gain}
    assert law.direct_gain.model_dump() == dict.fromkeys(SIGNALS, 0.0) | PRESSURES | direct
    assert np.any(law.direct_gain.error_integral) == ("error_integral" in direct)


@pytest.mark.parametrize("name", NAMES)
def test_filters_are_those_of_the_report(name: str) -> None:
    """Eq 3.6: 0.007588 / (z - 0.9924); the hold of 1 / (0.01 s + 1) for the text's 10 ms; none.
    Section 3.2.1: integral within +-50, enabled half an inch above the bottom stop at -37.5 in.
    Derivative pole: 80 to 90 rad/s fits.
    """
    law = load_law(name)
    if name == "acceleration":
        assert law.accelerometer_pole == pytest.approx(np.exp(-1.0 / 20.48), abs=5e-7)
        assert law.accelerometer_gain == pytest.approx(1.0 - law.accelerometer_pole, rel=1e-12)
    else:
        expected = (1.0, 0.0) if name == "acceleration_d2" else (0.007588, 0.9924)
        assert (law.accelerometer_gain, law.accelerometer_pole) == expected
    assert law.integrator_limit == 50.0
    assert law.integrator_trigger == -37.5 + 0.5
    assert 80.0 <= law.derivative_pole <= 90.0


@pytest.mark.parametrize("name", NAMES)
def test_titles_and_sources_are_there_and_differ(name: str) -> None:
    law = load_law(name)
    assert law.source
    assert [load_law(other).title for other in NAMES].count(law.title) == 1


def test_a_law_of_ones_own(tmp_path: Path) -> None:
    law = load_law(write(tmp_path, OWN))
    assert (law.name, law.title, law.source) == ("mine", "My law", "")
    assert (law.state_gain, law.output_gain, law.derivative_pole) == (0.5, -2.0, 60.0)
    assert law.input_gain.model_dump() == dict.fromkeys(SIGNALS, 0.0) | {"velocity": 0.25}
    assert law.direct_gain.reference == 30.0
    assert (law.integrator_limit, law.integrator_trigger) == (10.0, -30.0)
    assert (law.accelerometer_pole, law.accelerometer_gain) == (0.9, 0.1)
    assert not np.any(law.direct_gain.error_integral)
    assert load_law(str(tmp_path / "mine.toml")) == law
    assert load_law(law) is law


def test_one_law_of_several_is_chosen_by_name(tmp_path: Path) -> None:
    path = write(tmp_path, OWN + OWN.replace("mine", "other").replace("-2.0", "-3.0"))
    assert load_law(f"{path}:other").output_gain == -3.0
    assert load_law(f"{path}:mine").output_gain == -2.0


def test_a_derivative_filter_that_is_unstable_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, OWN.replace("derivative_pole = 60", "derivative_pole = 4096"))
    with pytest.raises(InputError, match="mine.toml.*derivative_pole: 4096 .* twice the control"):
        load_law(path)


@pytest.mark.parametrize("gain", ["40 %/in", [1.0, 2.0], [["a"] * 6], True])
def test_a_gain_that_is_no_number_is_refused_in_one_line(gain: object) -> None:
    with pytest.raises(InputError) as caught:
        load_law({"title": "A", "direct_gain": {"reference": gain}})
    (line,) = str(caught.value).splitlines()
    assert line.startswith("law custom: direct_gain.reference: ")
    assert line.endswith(" is refused: must be a number, or a list of 6")


TWO = OWN + OWN.replace("mine", "other")


@pytest.mark.parametrize(
    ("text", "choice", "parts"),
    [
        ("[mine\n", "", ["not valid TOML", "line 1"]),
        ("", "", ["holds no law"]),
        ("gain = 3\n" + OWN, "", ["gain", "3", "a law is a table"]),
        (OWN + OWN, "", ["not valid TOML"]),
        (TWO, "", ["mine, other", "mine.toml:mine"]),
        (TWO, ":third", ["'third' is not in", "; it has mine, other"]),
    ],
)
def test_a_file_without_the_law_asked_for_is_refused(
    tmp_path: Path, text: str, choice: str, parts: list[str]
) -> None:
    path = write(tmp_path, text)
    with pytest.raises(InputError) as caught:
        load_law(f"{path}{choice}")
    for part in (path.name, *parts):
        assert part in str(caught.value)


@pytest.mark.parametrize("name", ["PERFB", "", "velocity.txt", "velocity ", "a.tomlx"])
def test_an_unknown_name_lists_the_shipped_ones(name: str) -> None:
    with pytest.raises(ValueError) as caught:
        load_law(name)
    for part in (repr(name), *NAMES):
        assert part in str(caught.value)


def test_a_law_based_on_another_holds_only_what_differs(tmp_path: Path) -> None:
    """The other law is of the file or shipped; its title and source are not taken over."""
    path = tmp_path / "laws.toml"
    path.write_text(
        OWN + '[again]\nbased_on = "mine"\ntitle = "Again"\n[again.direct_gain]\nposition = -20.0\n'
        '[quick]\nbased_on = "velocity"\ntitle = "Quick"\nderivative_pole = 200.0\n',
        encoding="utf-8",
    )
    mine, again, quick = (load_law(f"{path}:{name}") for name in ("mine", "again", "quick"))
    assert (again.name, again.title, again.source) == ("again", "Again", "")
    assert again.direct_gain.position == -20.0
    kept = {"name", "title", "source", "direct_gain"}
    assert again.model_dump(exclude=kept) == mine.model_dump(exclude=kept)
    assert again.direct_gain.reference == mine.direct_gain.reference
    assert quick.direct_gain == load_law("velocity").direct_gain and quick.derivative_pole == 200.0


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ('based_on = "none"\ntitle = "A"', "mine.toml: a: based_on: 'none' is refused: allowed: "),
        ('based_on = ["velocity"]\ntitle = "A"', r"based_on: \['velocity'\] is refused"),
        ('based_on = "b"\ntitle = "A"\n[b]\nbased_on = "velocity"', "laws which are based on none"),
    ],
)
def test_a_base_that_is_none_is_refused(table: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(f"[a]\n{table}\n", encoding="utf-8")
    with pytest.raises(ValueError, match=said):
        load_law(path)


def test_a_law_is_loaded_from_a_dictionary_as_from_a_file() -> None:
    law = load_law({"title": "Mine", "direct_gain": {"reference": 40.0, "position": -40.0}})
    assert (law.name, law.direct_gain.position) == ("custom", -40.0)
    based = load_law({"name": "soft", "title": "Soft", "based_on": "velocity", "output_gain": 0.0})
    expected = load_law("velocity").model_copy(
        update={"name": "soft", "title": "Soft", "source": "", "output_gain": 0.0}
    )
    assert based == expected
    modal = load_law({"title": "Modal", "based_on": "modal_plan"})
    assert modal.modes == load_law("modal_plan").modes
    for table, message in (
        ({"title": "Mine", "direct_gain": {"speed": 1.0}}, "direct_gain.speed: is not a known"),
        ({}, "law custom: direct_gain: is missing"),
        ({"name": "a", "title": "A", "based_on": "b", "direct_gain": {}}, "law a: based_on: 'b'"),
    ):
        with pytest.raises(ValueError, match=message):
            load_law(table)
