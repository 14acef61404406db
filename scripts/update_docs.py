"""Refresh the generated tables and pictures of README and docs from finished studies.

A table stands between `<!-- table: NAME -->` and `<!-- end -->`; NAME is a folder below --results
that `cmf compare --out`, `cmf failure --out` or `scripts/electronics_effect.py --out` wrote.
Figures of the folder `compare` are copied to docs/images.
"""

import argparse
import re
import shutil
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGES = (
    "README.md",
    "docs/model.md",
    "docs/failures.md",
    "docs/operation.md",
    "docs/omct.md",
)
TABLES = ("comparison.md", "failures.md", "share.md")
FIGURES = (
    "compare/bode_surge.png",
    "compare/bode_heave.png",
    "compare/step_surge.png",
    "omct/omct.png",
)
_TABLE = re.compile(r"(<!-- table: ([\w-]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def refresh(text: str, results: Path) -> str:
    """Replace every table whose study lies below `results`."""

    def replace(match: re.Match[str]) -> str:
        for name in TABLES:
            source = results / match[2] / name
            if source.is_file():
                return f"{match[1]}\n{source.read_text(encoding='utf-8')}\n{match[3]}"
        return match[0]

    return _TABLE.sub(replace, text)


def main() -> None:
    """Parse the arguments and rewrite the pages."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--results", type=Path, default=Path("out"))
    parser.add_argument("--root", type=Path, default=ROOT, help="checkout to rewrite")
    options = parser.parse_args()
    for name in PAGES:
        page = options.root / name
        page.write_text(refresh(page.read_text(encoding="utf-8"), options.results), "utf-8")
    for figure in FIGURES:
        source = options.results / figure
        if source.is_file():
            shutil.copyfile(source, options.root / "docs" / "images" / source.name)
    print(f"refreshed {', '.join(PAGES)}")


if __name__ == "__main__":
    main()
