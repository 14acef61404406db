"""Numbers of the pages come from the data files, which are those of their commits."""

import hashlib
import re
import runpy
from pathlib import Path
from types import SimpleNamespace

import pytest

ROOT = Path(__file__).resolve().parents[2]
RESULTS = (
    "README.md",
    *(
        f"docs/explanation/{name}.md"
        for name in ("results", "laws", "acceleration_in_rotation", "certificate", "ladder")
    ),
    "docs/explanation/speed.md",
    "docs/explanation/paper.md",
)
"""Pages of results, in whose sentences no result is typed by hand."""
_MADE = re.compile(r"<!-- (?:table|data|is): .*?<!-- end -->", re.DOTALL)
_CODE = re.compile(r"^```.*?^```$|`[^`\n]*`|\$[^$]+\$|!\[.*?\]\(.*?\)", re.DOTALL | re.MULTILINE)
_RESULT = re.compile(r"[\d.]*\d\.\d+ (?:Hz|dB|us|ms)\b|(?<![-\d.])\d+ dB\b")
GIVEN = {
    "docs/explanation/results.md": {"0.1 Hz"},
    "docs/explanation/laws.md": {"0.4 Hz", "4.4 Hz", "4.6 dB", "0.8 dB", "58.9 ms"},
    "docs/explanation/acceleration_in_rotation.md": {
        "4.7 Hz",  # Table D-2
        "4.8 Hz",
        "15.9 Hz",  # 10 ms as a corner
    },
    "docs/explanation/speed.md": {"0.49 ms"},
}
"""Numbers that are no results of a study: settings, the report's, what a test holds."""


@pytest.fixture(scope="module")
def script() -> SimpleNamespace:
    return SimpleNamespace(**runpy.run_path(str(ROOT / "scripts" / "update_docs.py")))


def test_every_data_file_is_listed_with_its_commit_and_unchanged_since(
    script: SimpleNamespace,
) -> None:
    """Who edits a number by hand changes a digest, which `update_docs.py` alone writes."""
    listed = script.listed(ROOT)
    assert {path.stem for path in (ROOT / "docs" / "data").glob("*.csv")} == set(listed)
    for name, one in listed.items():
        data = (ROOT / "docs" / "data" / f"{name}.csv").read_bytes()
        assert hashlib.sha256(data).hexdigest() == one["sha256"], name
        assert re.fullmatch("[0-9a-f]{10}", one["commit"]) or name == "modes_neutral", name


def test_modes_at_neutral_are_those_of_the_models(script: SimpleNamespace) -> None:
    path = ROOT / "docs" / "data" / "modes_neutral.csv"
    assert script.modes_neutral() == path.read_text(encoding="utf-8")


@pytest.mark.parametrize("page", RESULTS)
def test_no_result_in_a_sentence_is_typed_by_hand(page: str) -> None:
    text = _CODE.sub("", _MADE.sub("", (ROOT / page).read_text(encoding="utf-8")))
    prose = "\n".join(line for line in text.splitlines() if not line.startswith("|"))
    assert set(_RESULT.findall(prose)) <= GIVEN.get(page, set())


def test_no_line_begins_with_a_number_of_the_data(script: SimpleNamespace) -> None:
    """Markdown would take the comment for the begin of a block, and end the sentence."""
    for page in script.pages(ROOT):
        text = page.read_text(encoding="utf-8")
        assert not re.findall(r"^\s*<!-- is: .*", text, re.MULTILINE), page.name


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("sample / velocity; heave / -90", "2.69"),
        ("sample / velocity; surge / -90", "2.55 [2.75]"),
        ("sample / velocity; surge / -90 / #2", "2.75"),
        ("sample / velocity / -90 / least .1f down", "2.5"),
        ("sample / velocity / -90 / most .1f up", "2.7"),
        ("sample / *; surge / peak / most", "9.5"),
        ("sample / velocity; surge / -90; peak / most", "9.5"),
        ("sample / velocity; surge / * / least", "2.55"),
        ("sample / force; surge / peak / abs", "3.5"),
    ],
)
def test_a_number_is_a_cell_of_its_file(
    text: str, shown: str, script: SimpleNamespace, tmp_path: Path
) -> None:
    (tmp_path / "docs" / "data").mkdir(parents=True)
    rows = "law,dof,-90,peak\nvelocity,heave,2.69,2.0\nvelocity,surge,2.55 [2.75],9.5\n"
    file = tmp_path / "docs" / "data" / "sample.csv"
    file.write_text(rows + "force,surge,1.99,-3.5\n", encoding="utf-8")
    assert script.shown(text, tmp_path) == shown
    page = f"at <!-- is: {text} -->0<!-- end --> Hz"
    assert (
        script._NUMBER.sub(lambda match: script.shown(match[2], tmp_path), page) == f"at {shown} Hz"
    )
    for wrong in (
        "sample / velocity / -90",
        "sample / nobody / -90",
        "sample / velocity; heave / x",
    ):
        with pytest.raises((ValueError, KeyError)):
            script.shown(wrong, tmp_path)
