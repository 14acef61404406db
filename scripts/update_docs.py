"""Refresh the generated tables and pictures of README and docs from finished studies.

A table stands between `<!-- table: NAME -->` and `<!-- end -->`; NAME is a folder below --results
that `cmf compare --out`, `cmf failure --out` or `scripts/electronics_effect.py --out` wrote, or
FOLDER/TABLE of a folder that `cmf study --out` wrote. Figures are copied to docs/images, numbers of
studies to docs/data.
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
    "docs/studies.md",
    "docs/acceleration_in_rotation.md",
)
TABLES = ("comparison.md", "failures.md")
COPIES = {
    "compare/bode_surge.png": "images/bode_surge.png",
    "compare/bode_heave.png": "images/bode_heave.png",
    "compare/step_surge.png": "images/step_surge.png",
    "ablation/ladder.png": "images/ladder.png",
    "ablation/measures.csv": "data/ablation_measures.csv",
    "ablation/effects.csv": "data/ablation_effects.csv",
    "mismatch/rates.png": "images/mismatch_rates.png",
    "mismatch/crosstalk_velocity.png": "images/mismatch_crosstalk_velocity.png",
    "mismatch/rates.csv": "data/mismatch_rates.csv",
    "rotation/rotation.csv": "data/rotation.csv",
    "rotation/rotation_flown.csv": "data/rotation_flown.csv",
}
"""Files of the results and where they go below docs."""

_TABLE = re.compile(r"(<!-- table: ([\w/-]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def refresh(text: str, results: Path) -> str:
    """Replace every table whose study lies below `results`."""

    def replace(match: re.Match[str]) -> str:
        for source in (results / f"{match[2]}.md", *(results / match[2] / n for n in TABLES)):
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
    for name, target in COPIES.items():
        source = options.results / name
        if source.is_file():
            place = options.root / "docs" / target
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, place)
    print(f"refreshed {', '.join(PAGES)}")


if __name__ == "__main__":
    main()
