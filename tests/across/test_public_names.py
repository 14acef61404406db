"""The public names: cheap to import, documented to the last argument, each with an example."""

import ast
import doctest
import inspect
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import is_dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import control
import mujoco
import numpy as np
import pytest
from fuzzing import commands
from typer.testing import CliRunner

import cmf_mj
from cmf_mj.cli.common import app
from cmf_mj.core.settings import Loader

STUB = ast.parse(Path(cmf_mj.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
HOMES = {
    name.name: f"cmf_mj.{node.module}"
    for node in STUB.body
    if isinstance(node, ast.ImportFrom) and node.module
    for name in node.names
}
API = Path(__file__).parents[2] / "docs" / "reference" / "api.md"
LISTED = {
    path.rsplit(".", 1)[1]: path.rsplit(".", 1)[0]
    for path in re.findall(r"^   ~?(cmf_mj\.[\w.]+)$", API.read_text(encoding="utf-8"), re.M)
}
"""What the reference lists by task, with the module of each name."""
SLOW = ("certify", "rated")
"""Names whose examples simulate for half a minute and are not run here."""
HEAVY = ("mujoco", "numba", "scipy", "control", "matplotlib", "pydantic", "pyarrow", "numpy")


def fresh(program: str) -> str:
    """What a program prints in a new interpreter."""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_stub_lists_all_names_and_they_exist() -> None:
    assert set(HOMES) | {"signals"} == set(cmf_mj.__all__)
    for name, home in HOMES.items():
        assert getattr(cmf_mj, name) is getattr(import_module(home), name)
    assert isinstance(cmf_mj.signals, ModuleType)


def test_importing_the_package_imports_nothing_heavy() -> None:
    program = "import sys, cmf_mj; print(*sorted(sys.modules))"
    assert not set(HEAVY) & set(fresh(program).split())


def test_help_imports_nothing_heavy() -> None:
    program = (
        "import sys\nfrom cmf_mj.cli import main\nsys.argv = ['cmf', '--help']\n"
        "try:\n    main()\nexcept SystemExit:\n    print('MODULES', *sorted(sys.modules))\n"
    )
    assert not set(HEAVY) & set(fresh(program).split("MODULES")[1].split())


def documented() -> Iterator[tuple[str, Any, str]]:
    """Each public function, class and public method with its docstring."""
    for name in HOMES:
        thing = getattr(cmf_mj, name)
        if not inspect.isclass(thing):
            yield name, getattr(thing, "__wrapped__", thing), inspect.getdoc(thing) or ""
            continue
        if "__init__" in vars(thing) and not is_dataclass(thing):
            text = f"{inspect.getdoc(thing)}\n{inspect.getdoc(thing.__init__)}"
            yield name, thing, text
        for part, method in inspect.getmembers(thing, callable):
            if not part.startswith("_") and str(getattr(method, "__module__", "")).startswith(
                "cmf_mj"
            ):
                yield f"{name}.{part}", method, inspect.getdoc(method) or ""


@pytest.mark.parametrize(
    ("name", "thing", "text"), [pytest.param(*case, id=case[0]) for case in documented()]
)
def test_every_argument_is_documented(name: str, thing: Any, text: str) -> None:
    if isinstance(thing, Loader):
        text = inspect.getdoc(type(thing).__call__) or ""
    missing = [
        argument
        for argument in inspect.signature(thing).parameters
        if argument != "self" and not re.search(rf"\b{argument}\b", text)
    ]
    assert not missing, f"{name}: {missing} are not documented"


@pytest.mark.parametrize("name", list(HOMES))
def test_every_field_is_documented(name: str) -> None:
    thing = getattr(cmf_mj, name)
    if not inspect.isclass(thing) or issubclass(thing, Exception):
        return
    if "__init__" in vars(thing) and not is_dataclass(thing):
        return  # arguments, asked for above
    lines = inspect.getsource(thing).splitlines()
    for number, line in enumerate(lines):
        field = re.match(r"    ([a-z]\w*): ", line)
        if field:
            after = "\n".join(lines[number : number + 12])
            text = rf"^    {field[1]}: [^\n]*(#: \S|\n(    [ )\]][^\n]*\n)*    (\"\"\"|#: ))"
            assert re.match(text, after), f"{name}.{field[1]} is not documented"


@pytest.mark.parametrize("words", [(), *commands()], ids=" ".join)
def test_help_fits_a_screen_or_is_grouped(words: tuple[str, ...]) -> None:
    said = CliRunner().invoke(app, [*words, "--help"], env={"COLUMNS": "80"}).output
    groups = [
        line for line in said.splitlines() if line.startswith("╭") and "Arguments" not in line
    ]
    assert len(groups) >= 2 or len(said.splitlines()) <= 40


@pytest.mark.parametrize(("name", "module"), (LISTED | HOMES).items(), ids=[*(LISTED | HOMES)])
def test_every_name_has_an_example_that_runs(name: str, module: str) -> None:
    home = import_module(module)
    thing = getattr(home, name)
    documented = inspect.isclass(thing) or inspect.isroutine(thing) or hasattr(thing, "__wrapped__")
    text = inspect.getdoc(thing if documented else home) or ""
    names = {"cmf_mj": cmf_mj, "np": np, "control": control, "mujoco": mujoco}
    example = doctest.DocTestParser().get_doctest(text, names, name, None, 0)
    assert example.examples, f"{name} has no example"
    said: list[str] = []
    if name not in SLOW:
        doctest.DocTestRunner().run(example, out=said.append)
    assert not said, "".join(said)
