"""The pages keep the house's style: plain words, an answer first, a way on, one sitting long."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "docs").glob("[!_]*/*.md"))
READ = [page for page in PAGES if page.parent.name != "reference"]
TEXTS = [*PAGES, *(ROOT / name for name in ("README.md", "models/README.md", "CONTRIBUTING.md"))]
LONGEST = 1500  # words beside code, tables included
SITTING = 1200  # words of prose
PAGES_AT_MOST = 55
BUDGET = {
    "docs": 500,
    "docs/tutorials": 4762,
    "docs/how_to": 19360,
    "docs/explanation": 16080,
    "docs/reference": 4298,
}
"""Words of the pages in a folder, code included; what is made from data is left out."""
DOCS = 45_000
ALONE = {"README.md": 600, "CONTRIBUTING.md": 2620, "CHANGELOG.md": 900, "models/README.md": 2400}
"""Words of a page outside `docs`."""

BANNED = {
    r"told|tells": "says, shows, reports",
    r"heads with|headed with": "is documented in",
    r"stands? in \[": "see [",
    r"buys?": "gains, raises, costs",
    r"(is|are) worth": "gains, its effect is",
    r"feigns?": "imitates",
    r"no way": "does not help",
    r"borne out": "confirmed",
    r"go(es)? on with|gone on with": "continues",
    r"hang(s|ing)? on": "depends on",
    r"hardly": "little, almost never",
    r"anew|afresh": "again",
    r"nothing else": "say what",
    r"wanted|the asked": "demanded, sought",
    r"taken for": "treated as",
    r"left behind": "skipped",
    r"governors?": "rate limiter",
    r"pictures a second": "frame rate, frames a second",
    r"some \d[\d.]* (s|ms|minutes) each": "about",
    r"whence|thereof|betwixt|heretofore": "plain English",
    r"simply|obviously|of course|basically": "nothing",
    r"utili[sz]e[sd]?|leverag(e|es|ed|ing)|seamless(ly)?|cutting-edge": "use, or the fact",
    r"in order to": "to",
    r"as is well known|it should be noted": "nothing",
}
"""Words that a reader must decode, or that say nothing, with what to write instead."""
_CODE = re.compile(r"^```.*?^```$|`[^`\n]*`", re.DOTALL | re.MULTILINE)
_MADE = re.compile(r"<!-- (table|data|is): .*?<!-- end -->", re.DOTALL)


def named(page: Path) -> str:
    return str(page.relative_to(ROOT))


def written(page: Path) -> str:
    """What a person wrote: neither code nor what a command makes."""
    return _CODE.sub("", _MADE.sub("", page.read_text(encoding="utf-8")))


def includes(page: Path) -> bool:
    """Whether the site fills this page from a file of the repository's root."""
    return page.read_text(encoding="utf-8").startswith("<!-- The text of ")


def to_decode(text: str) -> list[str]:
    """Banned words of a text, each with what is around it and what to write instead."""
    text = re.sub(r"\s+", " ", text)
    return [
        f"{match[0]!r} in '...{text[max(0, match.start() - 40) : match.end() + 30]}...': {instead}"
        for words, instead in BANNED.items()
        for match in re.finditer(rf"\b({words})(?!\w)", text, re.IGNORECASE)
    ]


@pytest.mark.parametrize("page", TEXTS, ids=named)
def test_no_word_needs_decoding(page: Path) -> None:
    found = to_decode(written(page))
    assert not found, "\n".join(found)


def test_no_word_of_the_code_needs_decoding() -> None:
    """Names, comments, docstrings and messages; keys of files, `"taken_for"`, may be old."""
    found = []
    modules = [*(ROOT / "cmf_mj").rglob("*.py"), *(ROOT / "examples").rglob("*.py")]
    for module in sorted([*modules, ROOT / "docs" / "conf.py"]):
        text = re.sub(r'"\w+"', "", module.read_text(encoding="utf-8")).replace("_", " ")
        found += [f"{module.relative_to(ROOT)}: {word}" for word in to_decode(text)]
    assert not found, "\n".join(found)


def test_a_banned_word_is_found() -> None:
    words = "|".join(BANNED)
    assert re.search(rf"\b({words})(?!\w)", "the folder is told; it stands in [here]")
    assert not re.search(rf"\b({words})(?!\w)", "a bold claim understands in [here]")


@pytest.mark.parametrize("page", [p for p in PAGES if not includes(p)], ids=named)
def test_a_page_opens_with_its_question_and_ends_with_a_way_on(page: Path) -> None:
    paragraphs = page.read_text(encoding="utf-8").strip().split("\n\n")
    assert paragraphs[0].startswith("# ")
    assert "?" in paragraphs[1], "the first paragraph asks what the page answers"
    assert paragraphs[-1].startswith("Read next: ["), "the last paragraph says what to read next"


def length(page: Path) -> int:
    """Words that somebody wrote, code included."""
    return len(_MADE.sub("", page.read_text(encoding="utf-8")).split())


@pytest.mark.parametrize("folder", BUDGET)
def test_a_folder_keeps_its_budget_of_words(folder: str) -> None:
    assert sum(length(page) for page in (ROOT / folder).glob("*.md")) <= BUDGET[folder]


@pytest.mark.parametrize("page", ALONE)
def test_a_page_beside_the_docs_keeps_its_budget_of_words(page: str) -> None:
    assert length(ROOT / page) <= ALONE[page]


def test_there_are_few_pages_and_the_budgets_add_up() -> None:
    assert len([*(ROOT / "docs").glob("*.md"), *PAGES]) <= PAGES_AT_MOST
    assert sum(BUDGET.values()) <= DOCS


@pytest.mark.parametrize("page", READ, ids=named)
def test_a_page_is_one_sitting_long(page: Path) -> None:
    """Listings and full tables belong into the reference."""
    text = re.sub(r"<!--.*?-->", "", page.read_text(encoding="utf-8"), flags=re.S)
    text = re.sub(r"^```.*?^```$", "", text, flags=re.S | re.M)
    prose = [line for line in text.splitlines() if not line.startswith("|")]
    assert len(" ".join(prose).split()) <= SITTING
    assert len(text.split()) <= LONGEST
