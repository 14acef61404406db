"""Install the lowest, newest or pre-release versions that pyproject.toml allows, and run the tests.

    python scripts/check_versions.py lowest newest --pythons 3.11 3.12 3.13

Each pair of versions and Python gets a virtual environment of its own below `--folder`. The lowest
are those that pyproject.toml names, of the package and its extras; what these need in turn, and
the tools of the tests, are as new as goes with them. A failure ends with status 1; one of
`pre` is only reported.
"""

import argparse
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

EXTRAS = (
    *("report", "cluster", "flight", "rl"),
    *("verification", "docs"),
)
"""Extras that the tests of the package import."""

TOOLS = (
    *("pytest", "pytest-xdist", "hypothesis", "sybil", "playwright"),
    *("fmpy", "libcosimpy", "pandas", "pin", "hatchling"),
)
"""What runs the tests, as new as goes with the rest."""

BY_NAME = ("mujoco", "numba")
"""Packages whose pre-releases are tried, by `pre`."""

_NEEDED = re.compile(r"([A-Za-z0-9_.-]+)(?:\[[^]]*\])?>=([0-9.]+)")


def lowest(text: str) -> list[str]:
    """Lowest versions that the text of a pyproject.toml allows, as pins."""
    project = tomllib.loads(text)["project"]
    lists = [project["dependencies"], *(project["optional-dependencies"][e] for e in EXTRAS)]
    found = [_NEEDED.match(needed) for each in lists for needed in each]
    return [f"{match[1]}=={match[2]}" for match in found if match is not None]


def install(python: str, kind: str, folder: Path) -> Path:
    """An environment with the versions of a kind; its interpreter."""
    here = folder / f"{kind}-{python}"
    subprocess.run([f"python{python}", "-m", "venv", "--clear", here], check=True)
    interpreter = here / "bin" / "python"
    pins = lowest((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    (here / "pins.txt").write_text("\n".join(pins) + "\n", encoding="utf-8")
    pip = [str(interpreter), "-m", "pip", "install", "--quiet"]
    subprocess.run([*pip, "--upgrade", "pip"], check=True)
    limits = ["--constraint", str(here / "pins.txt")] if kind == "lowest" else []
    package = f"{ROOT}[{','.join(EXTRAS)}]"
    subprocess.run([*pip, *limits, package, *TOOLS], check=True)
    if kind == "pre":
        subprocess.run([*pip, "--pre", "--upgrade", *BY_NAME], check=True)
    return interpreter


def tested(python: Path, tests: list[str], workers: str) -> bool:
    """Whether the tests pass on the sources of this checkout.

    What newer packages warn of in older ones is no error here.
    """
    cache = str(python.parents[1] / "compiled")
    environment = os.environ | {"PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": cache}
    command = [str(python), "-m", "pytest", "-n", workers, "-o", "filterwarnings=default"]
    command += ["-m", "not slow", *tests]
    return subprocess.run(command, cwd=ROOT, env=environment, check=False).returncode == 0


def main() -> int:
    """Install and test each kind on each Python."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("kinds", nargs="+", choices=("lowest", "newest", "pre"))
    parser.add_argument("--pythons", nargs="+", default=["3.11", "3.12", "3.13"])
    parser.add_argument("--folder", type=Path, default=ROOT / "build" / "versions")
    parser.add_argument("--tests", nargs="+", default=["tests"], help="files and folders")
    parser.add_argument("--workers", default="auto", help="processes of pytest-xdist")
    options = parser.parse_args()
    failed = []
    for kind in options.kinds:
        for python in options.pythons:
            name = f"{kind} on Python {python}"
            print(f"== {name}", flush=True)
            try:
                interpreter = install(python, kind, options.folder)
                good = tested(interpreter, options.tests, options.workers)
            except (OSError, subprocess.CalledProcessError) as error:
                print(error)
                good = False
            print(f"== {name}: {'passed' if good else 'FAILED'}", flush=True)
            failed += [] if good or kind == "pre" else [name]
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
