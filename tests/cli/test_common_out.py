"""Where results go: one run a folder, nothing half-written, and nothing after a refusal."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from shared import cmf

from cmf_mj import core
from cmf_mj.core.errors import InputError
from cmf_mj.core.files import check_target, exclusive_folder
from cmf_mj.show.look import new_figure, save_figure

HOLD = """
import sys, time
from pathlib import Path
from cmf_mj.core.files import exclusive_folder
with exclusive_folder(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_folder_is_of_one_run_and_free_after_any_end_of_it(tmp_path: Path, number: int) -> None:
    out = tmp_path / "out"
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(out)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    assert holder.stdout is not None and holder.stdout.readline() == b"held\n"
    said = cmf("report", "linear", "--out", out, code=2)
    assert said.count("\n") == 1 and f"{str(out)!r} is refused: another run writes to it" in said
    (out / f".table.csv.{holder.pid}.part").write_text("half")
    holder.send_signal(number)
    holder.communicate(timeout=30)
    with exclusive_folder(out):
        assert list(out.iterdir()) == []
        with pytest.raises(InputError, match="another run writes to it"), exclusive_folder(out):
            pass
    with exclusive_folder(out):
        pass


def test_a_refused_run_leaves_no_folder(tmp_path: Path) -> None:
    assert "'fast'" in cmf("report", "linear", "--laws", "fast", "--out", tmp_path / "a/b", code=2)
    assert list(tmp_path.iterdir()) == []
    with exclusive_folder(tmp_path / "kept" / "out") as folder:
        (folder / "result").write_text("")
    assert (tmp_path / "kept" / "out" / "result").exists()


def test_what_cannot_be_written_is_refused_before_the_work(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    for arguments, said in (
        (("report", "linear", "--out", str(file)), f"out: {str(file)!r} is refused"),
        (("compare", "--out", str(file / "out")), f"out: {str(file / 'out')!r} is refused"),
        (("play", "--file", str(tmp_path)), f"file: {str(tmp_path)!r} is refused: is a folder"),
        (("tune", "--file", str(file / "x.toml")), "is not a folder that can be written to"),
        (("report", "linear", "--out", "/proc/out"), "out: '/proc/out' is refused"),
        (("report", "linear", "--out", str(tmp_path / ("n" * 300))), "File name too long"),
    ):
        begun = time.monotonic()
        output = cmf(*arguments, code=2)
        assert output.count("cmf: ") == 1, output
        assert said in output and time.monotonic() - begun < 5.0
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    assert check_target(tmp_path / "new" / "x.csv") == tmp_path / "new" / "x.csv"


@pytest.mark.parametrize("title", [r"$\\foo$", "$x$ and $", "a_b^c $1", "$$", r"\\$"])
def test_a_title_with_dollar_signs_is_no_formula(tmp_path: Path, title: str) -> None:
    """Such a title is drawn as it stands; powers of ten at the ticks stay formulas."""
    figure = new_figure(3.0, 3.0)
    figure.suptitle("gain")
    axes = figure.subplots()
    axes.set(title=title, xlabel=title, xscale="log", xlim=(1.0, 1e9))
    axes.plot([1.0, 1e9], [0.0, 1.0], label=title)
    axes.legend()
    texts = [axes.title, axes.xaxis.label, *axes.get_legend().get_texts()]
    drawn = []
    figure.clear = lambda: drawn.extend((t.get_text(), t.get_parse_math()) for t in texts)
    save_figure(figure, tmp_path / "x.png")
    assert drawn == [(title, False)] * 3
    assert any(t.get_parse_math() for t in axes.get_xticklabels())


@pytest.mark.parametrize("homeless", [False, True])
def test_a_package_that_cannot_be_written_to_keeps_its_cache_elsewhere(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    homeless: bool,
) -> None:
    """One line says where, until the folder is there; what a user has set is left alone."""
    package, home = Path(core.__file__).parents[1], tmp_path / "home"
    closed = (str(package), str(home)) if homeless else (str(package),)
    access = os.access
    monkeypatch.setattr(
        os, "access", lambda path, mode: not str(path).startswith(closed) and access(path, mode)
    )
    monkeypatch.setattr(core.tempfile, "gettempdir", lambda: str(tmp_path))
    home.mkdir()
    for name in ("XDG_CACHE_HOME", "XDG_CONFIG_HOME"):
        monkeypatch.setenv(name, str(home))
    for name in ("NUMBA_CACHE_DIR", "MPLCONFIGDIR"):
        monkeypatch.delenv(name, raising=False)
    core.place_caches()
    kept, fonts = Path(os.environ.pop("NUMBA_CACHE_DIR")), os.environ.pop("MPLCONFIGDIR", "")
    private = tmp_path / f"cmf-mj-{os.getuid()}"
    assert kept == (private if homeless else home / "cmf-mj") / "numba"
    assert fonts == (str(private / "matplotlib") if homeless else "")
    said = capsys.readouterr().err
    assert said == f"cmf: compiled code is kept in {kept}, for {package} cannot be written to\n"
    kept.mkdir(parents=True)
    monkeypatch.setenv("MPLCONFIGDIR", "mine")
    core.place_caches()
    assert os.environ.pop("NUMBA_CACHE_DIR") == str(kept) and os.environ["MPLCONFIGDIR"] == "mine"
    assert not capsys.readouterr().err
    if homeless:  # compiled code is not taken from a folder that others can write to
        private.chmod(0o777)
        core.place_caches()
        assert Path(os.environ.pop("NUMBA_CACHE_DIR")).parent != private
    monkeypatch.setenv("NUMBA_CACHE_DIR", "mine")
    core.place_caches()
    assert os.environ["NUMBA_CACHE_DIR"] == "mine"


INTERRUPTED = {
    "turned into an error": """
    try:
        os.kill(os.getpid(), NUMBER)
    except KeyboardInterrupt as error:
        raise ImportError("initialization failed") from error
""",
    "where Python cannot raise it": """
    ctypes.CFUNCTYPE(None)(lambda: os.kill(os.getpid(), NUMBER))()
    time.sleep(60.0)
""",
    "while its hook still runs": """
    begin = threading.Timer.start
    def late(timer):
        threading.Timer.start = begin
        begin(timer)
        while timer.is_alive():
            pass
    threading.Timer.start = late
    ctypes.CFUNCTYPE(None)(lambda: os.kill(os.getpid(), NUMBER))()
    time.sleep(60.0)
""",
}
"""What libraries do with an interrupt: extension modules while they are imported, engines in
functions of the user; in what they call back Python would print it and go on."""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("how", INTERRUPTED)
def test_an_interrupt_ends_the_command_whatever_a_library_does(
    how: str, number: signal.Signals
) -> None:
    body = INTERRUPTED[how].replace("NUMBER", str(int(number)))
    modules = "ctypes, os, threading, time, cmf_mj.cli as cli"
    text = f"import {modules}\ndef app(**_):{body}cli.app = app\ncli.main()"
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (130, b"")


def test_an_error_without_an_interrupt_keeps_its_traceback() -> None:
    text = "import cmf_mj.cli as cli\ncli.app = lambda **_: 1 / 0\ncli.main()\n"
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, check=False)
    assert done.returncode == 1 and b"ZeroDivisionError" in done.stderr
