from functools import partial
from pathlib import Path
from typing import Any

import pytest

from cmf_mj.control.law import load_law
from cmf_mj.core.errors import InputError
from cmf_mj.core.settings import (
    Loader,
    Name,
    Settings,
    beside,
    merged,
    parsed_json,
    read_toml,
    validated,
)

SHIPPED = """
[common]
mass = { value = 3.0, unit = "kg" }
[light]
depth = 1
[heavy]
depth = 2
"""
NAMES = ("light", "heavy")


class Part(Settings):
    length: float
    width: float


class Ranked(Settings):
    name: str
    depth: int
    mass: dict[str, Any]


class Whole(Settings):
    size: float
    part: Part


@pytest.fixture
def sets(tmp_path: Path) -> Path:
    file = tmp_path / "sets.toml"
    file.write_text(SHIPPED)
    return file


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    file = tmp_path / "whole.toml"
    file.write_text("size = 1.0\n[part]\nlength = 2.0\nwidth = 3.0\n")
    return file


@pytest.mark.parametrize(
    ("levels", "expected"),
    [
        (0, {"a": {"b": {"d": 4}}, "e": 5}),
        (1, {"a": {"b": {"d": 4}, "f": 6}, "e": 5}),
        (2, {"a": {"b": {"c": 3, "d": 4}, "f": 6}, "e": 5}),
        (float("inf"), {"a": {"b": {"c": 3, "d": 4}, "f": 6}, "e": 5}),
    ],
)
def test_tables_are_merged_down_to_a_level(levels: float, expected: dict[str, Any]) -> None:
    base = {"a": {"b": {"c": 3}, "f": 6}, "e": 1}
    assert merged(base, {"a": {"b": {"d": 4}}, "e": 5}, levels) == expected
    assert base == {"a": {"b": {"c": 3}, "f": 6}, "e": 1}


def test_a_set_has_the_common_entries_and_its_name(sets: Path, tmp_path: Path) -> None:
    mass = {"value": 3.0, "unit": "kg"}
    load = partial(Loader, Ranked, sets, what="sets", names=NAMES)
    table, where = load().table("heavy")
    assert table == {"mass": mass, "depth": 2, "name": "heavy"}
    assert where == "sets.toml: heavy"
    file = tmp_path / "mine.toml"
    file.write_text('base = "light"\n[own]\nmass = { value = 4.0 }\n')
    table, where = load().table(file)
    assert table == {"mass": mass | {"value": 4.0}, "depth": 1, "name": "own"}
    assert where == f"{file}: own"
    assert load(levels=0).table(file)[0]["mass"] == {"value": 4.0}
    file.write_text("[own]\ndepth = 7\n")
    assert load(based=False).table(file)[0] == {"depth": 7, "name": "own"}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[own]\n", "base: None is not one of light, heavy"),
        ('base = ["light"]\n[own]\n', "base: ['light'] is not one of light, heavy"),
        (
            'base = "light"\n[own]\n[other]\n',
            "has the entries ['other', 'own']; exactly one table is",
        ),
        ('base = "light"\n[own]\ndepth = = 3\n', "is not valid TOML: "),
        ("\udcff", "is not valid TOML: "),
        ('base = "common"\n[own]\n', "base: 'common' is not one of light, heavy"),
        ('base = "light"\nown = 1\n', "has the entries ['own']; exactly one table is allowed"),
        (
            'base = "light"\n[own]\nname = "x"\n',
            "own: name: is taken from the table; leave it out",
        ),
        ('base = "light"\n[own]\ndepth = 3\n', "own: depth: is taken from the base; leave it out"),
    ],
)
def test_own_sets_are_refused_by_field(sets: Path, tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(text, errors="surrogateescape")
    with pytest.raises(ValueError) as raised:
        Loader(Ranked, sets, what="sets", names=NAMES, fixed=("depth",)).table(file)
    assert str(raised.value).startswith(f"{file}: {message}")


def test_a_name_that_is_no_set_lists_the_sets(sets: Path, whole: Path) -> None:
    with pytest.raises(ValueError, match="sets: 'common' is not one of light, heavy nor a .toml"):
        Loader(Ranked, sets, what="sets", names=NAMES).table("common")
    with pytest.raises(ValueError, match="whole: 'odd' is not one of default nor a .toml file"):
        Loader(Whole, whole, what="whole")("odd")


def test_a_file_overlays_what_it_repeats(whole: Path, tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text("[part]\nwidth = 5.0\n")
    load = Loader(Whole, whole)
    shipped = load()
    assert load("default") == shipped
    assert load(shipped) is shipped
    mine = load(file)
    assert (mine.size, mine.part.length, mine.part.width) == (1.0, 2.0, 5.0)
    with pytest.raises(ValueError, match="mine.toml: part.length: is missing"):
        Loader(Whole, whole, levels=0)(file)


def test_a_byte_order_mark_is_no_part_of_a_file(whole: Path) -> None:
    before = Loader(Whole, whole)()
    whole.write_bytes(b"\xef\xbb\xbf" + whole.read_bytes().replace(b"\n", b"\r\n"))
    assert Loader(Whole, whole)() == before


@pytest.mark.parametrize(
    "text",
    ["x = " + "[" * 40 + "]" * 40, "x = " + "[" * 100_000, "a" + ".a" * 5000 + " = 1"],
    ids=["lists", "open", "keys"],
)
def test_nested_tables_end_before_the_stack_does(tmp_path: Path, text: str) -> None:
    file = tmp_path / "deep.toml"
    file.write_text(text)
    with pytest.raises(InputError, match="deep.toml: .* nested too deep; allowed: 16 levels"):
        read_toml(file)


def test_a_refused_value_is_not_shown_at_any_length(tmp_path: Path) -> None:
    with pytest.raises(InputError) as raised:
        validated(Part, {"length": "x" * 10**6, "width": 1.0}, "my.toml")
    assert len(str(raised.value)) < 600


@pytest.mark.parametrize("text", ["5", "null", "true", '"text"'])
def test_json_without_tables_is_read(text: str) -> None:
    assert parsed_json(text, "my.json") in (5, None, True, "text")


@pytest.mark.parametrize(("levels", "allowed"), [(16, True), (17, False)])
def test_levels_are_counted_from_the_file(levels: int, allowed: bool) -> None:
    text = "[" * levels + "]" * levels
    if allowed:
        assert parsed_json(text, "my.json")
    else:
        said = "^my.json: tables and lists are nested too deep; allowed: 16 levels$"
        with pytest.raises(InputError, match=said):
            parsed_json(text, "my.json")


class Keyed(Settings):
    parts: dict[Name, Part]


def test_a_fault_is_found_under_a_key_with_a_hyphen() -> None:
    with pytest.raises(InputError) as raised:
        validated(Keyed, {"parts": {"my-run": {"length": "x", "width": 1.0}}}, "my.toml")
    assert "my.toml: parts.my-run.length: 'x' is refused" in str(raised.value)
    assert "[" not in str(raised.value)


def test_all_keys_that_are_not_known_are_named_whatever_their_kind() -> None:
    with pytest.raises(InputError) as raised:
        validated(Part, {1: 2, "a": 3, "lenth": 1.0}, "my.toml")
    said = "is not a known field; allowed: length, width"
    assert str(raised.value).splitlines() == [
        f"my.toml: {key}: {said}{guess}"
        for key, guess in (("1", ""), ("a", ""), ("lenth", "; did you mean length?"))
    ]


def test_a_name_with_a_null_character_is_no_file() -> None:
    with pytest.raises(InputError, match="cannot be read: no name has a null character"):
        load_law("a\0.toml")


def test_files_are_told_by_their_ending() -> None:
    folder = Path("here")
    for name in ("my.toml", "laws.toml:mine"):
        assert beside(folder, name) == folder / name
    for name in ("my.toml.old", "my.tomlaw", "velocity"):
        assert beside(folder, name) == name


def test_a_shipped_name_with_other_numbers_is_refused(sets: Path, tmp_path: Path) -> None:
    file, load = tmp_path / "mine.toml", Loader(Ranked, sets, what="sets", names=NAMES)
    file.write_text('base = "light"\n[light]\n')
    assert load(file) == load("light")
    file.write_text('base = "light"\n[heavy]\ndepth = 9\n')
    with pytest.raises(InputError, match="mine.toml: 'heavy' is the name of a shipped set"):
        load(file)
