#!/usr/bin/env python3
"""Change one line of physics at a time and show which test notices.

Each mutant of `mutants.toml` is applied to a copy of the tracked files, and the test files named
with it run there until one fails. A mutant that no test notices makes the script fail: what the
line says is then not tested.

    python scripts/mutate.py              all mutants, two at a time
    python scripts/mutate.py --only oil   those whose description or file holds the word
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import NamedTuple

from joblib import Parallel, delayed
from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).resolve().parents[1]


class Mutant(NamedTuple):
    """One line as a slip of the pen would have it."""

    what: str  #: In words.
    file: str  #: Where the line stands, from the root.
    line: str  #: Text that stands there exactly once.
    becomes: str  #: What replaces it.
    tests: list[str]  #: Files under `tests/` that are asked, in this order.


def copy_of_checkout(folder: Path) -> Path:
    """Copy what git tracks, as it stands in the working tree."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True)
    for name in listed.stdout.decode().split("\0"):
        if name and (ROOT / name).is_file():
            target = folder / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target)
    return folder


def noticed_by(mutant: Mutant) -> str:
    """First test that fails with the mutant in place; empty if all pass.

    Raises:
        ValueError: the line does not stand exactly once in its file.
        RuntimeError: the tests could not run.
    """
    with tempfile.TemporaryDirectory() as folder:
        tree = copy_of_checkout(Path(folder))
        source = tree / mutant.file
        text = source.read_text(encoding="utf-8")
        if text.count(mutant.line) != 1:
            raise ValueError(
                f"{mutant.file}: {mutant.line!r} stands there {text.count(mutant.line)} times"
            )
        source.write_text(text.replace(mutant.line, mutant.becomes), encoding="utf-8")
        files = [f"tests/{name}" for name in mutant.tests]
        options = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "--tb=no"]
        environment = os.environ | {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
        environment.pop("NUMBA_CACHE_DIR", None)
        result = subprocess.run(
            [sys.executable, "-m", "pytest", *options, *files],
            cwd=tree,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        failed = re.search(r"^(?:FAILED|ERROR) tests/(\S+)", result.stdout, re.MULTILINE)
        if result.returncode not in (0, 1) and failed is None:
            raise RuntimeError(f"{files}: {result.stdout[-2000:]}{result.stderr[-2000:]}")
        return failed[1] if failed else ""


def main() -> int:
    """Run the mutants and print who noticed each; 1 if one went unnoticed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--only", default="", help="word in the description or the file's name")
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    listed = tomllib.loads((ROOT / "scripts" / "mutants.toml").read_text(encoding="utf-8"))
    mutants = [Mutant(**entry) for entry in listed["mutant"]]
    chosen = [m for m in mutants if options.only in m.what or options.only in m.file]
    notices = Parallel(n_jobs=options.jobs, backend="threading")(
        delayed(noticed_by)(mutant) for mutant in chosen
    )
    table = Table("line of", "changed", "noticed by", title=f"{len(chosen)} mutants")
    for mutant, test in zip(chosen, notices, strict=True):
        table.add_row(mutant.file.removeprefix("cmf_mj/"), mutant.what, test or "NOBODY")
    Console(width=200 if not sys.stdout.isatty() else None).print(table)
    unnoticed = [m.what for m, test in zip(chosen, notices, strict=True) if not test]
    print(f"{len(chosen) - len(unnoticed)} of {len(chosen)} noticed")
    return 1 if unnoticed else 0


if __name__ == "__main__":
    sys.exit(main())
