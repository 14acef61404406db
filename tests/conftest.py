"""Fixtures of several test modules, and one compilation for all workers."""

import ctypes
import gc
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from figures import check_readable, check_title
from hypothesis import settings
from lengths import LONG, WHOLE
from matplotlib.figure import Figure
from matplotlib.text import Text
from shared import FOLDER

from cmf_mj.report_2014.ledger import LedgerEntry, load_ledger
from cmf_mj.show import look

settings.register_profile(LONG)
settings.register_profile(WHOLE)


def pytest_sessionstart(session: pytest.Session) -> None:
    """What workers take over: an environment, signals, and loops compiled once, side by side."""
    config = session.config
    if hasattr(config, "workerinput") or config.option.collectonly:
        return
    # A shell that puts the tests in the background has all they start ignore SIGINT.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.environ[FOLDER] = tempfile.mkdtemp(prefix="cmf-mj-")
    os.environ.setdefault("MALLOC_ARENA_MAX", "1")  # one heap, which can be given back
    os.environ.setdefault("MALLOC_MMAP_THRESHOLD_", "1048576")  # so can large arrays, at once
    if config.getoption("numprocesses", default=None):
        warm = Path(__file__).with_name("warm.py")
        paths = (str(warm.parent), str(config.rootpath), os.environ.get("PYTHONPATH", ""))
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))}
        runs = [
            subprocess.Popen([sys.executable, warm, loop], env=environment)
            for loop in ("table", "chain")
        ]
        if any([run.wait() for run in runs]):
            raise pytest.UsageError(f"{warm.name}: the loops could not be compiled")


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Throw away what workers shared."""
    if not hasattr(session.config, "workerinput"):
        shutil.rmtree(os.environ.pop(FOLDER, ""), ignore_errors=True)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A headless Chromium that draws WebGL in software."""
    from playwright.sync_api import sync_playwright

    program = shutil.which("chromium")
    if program is None:
        pytest.fail("no Chromium to open the page in: apt-get install chromium (Debian package)")
    options = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"]
    options += ["--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
    with sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=program, args=options)
        yield running
        running.close()


@pytest.fixture(scope="module", autouse=True)
def forgotten(request: pytest.FixtureRequest) -> Iterator[None]:
    """Release what a module computed once, and give the memory back to the system."""
    yield
    for thing in vars(request.module).values():
        if getattr(thing, "__module__", "") == request.module.__name__:
            getattr(thing, "cache_clear", lambda: None)()
    gc.collect()
    if sys.platform == "linux":
        ctypes.CDLL(None).malloc_trim(0)


@pytest.fixture
def entry(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[LedgerEntry]:
    """The entry of the ledger that the test demonstrates; it must ask for every figure of it."""
    (found,) = (row for row in load_ledger() if row.demonstration == request.node.nodeid)
    asked: set[str] = set()
    figure = LedgerEntry.figure

    def tracked(row: LedgerEntry, name: str) -> float:
        asked.add(name)
        return figure(row, name)

    monkeypatch.setattr(LedgerEntry, "figure", tracked)
    yield found
    assert asked == {row.name for row in found.figures}


@pytest.fixture(scope="session", autouse=True)
def titled() -> Iterator[None]:
    """No figure of the package is saved without a quantity in its title, in whichever test."""

    def checked(figure: Figure, target: Any, **options: Any) -> None:
        check_title(figure, str(target))
        Figure.savefig(figure, target, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(look._Figure, "savefig", checked)
        yield


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, set[str]]]:
    """Texts of the figures that the test saves, by file name; each figure must be readable."""
    saved: dict[str, set[str]] = {}
    save = Figure.savefig

    def kept(figure: Figure, target: Any, **options: Any) -> None:
        save(figure, target, **options)
        if isinstance(target, Path):  # .NAME.PID.part, until it is whole
            name = target.name.removeprefix(".").rsplit(".", 2)[0]
            check_readable(figure, name)
            saved[name] = {text.get_text() for text in figure.findobj(Text)}

    monkeypatch.setattr(Figure, "savefig", kept)
    yield saved
    assert saved, "the test drew no figure"
