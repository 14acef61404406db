"""The scripts of the gallery: each begins with a question, draws what it says, within 30 s."""

import ast
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.text import Text

SCRIPTS = sorted((Path(__file__).parents[2] / "examples" / "gallery").glob("plot_*.py"))
UPDATE = runpy.run_path(str(SCRIPTS[0].parents[2] / "scripts" / "update_docs.py"))

LONGEST = 30.0  #: Processor time of a script [s], kernels compiled.

DRAW = f"""
import runpy, sys, time
sys.path.append({str(Path(__file__).parents[1])!r})
import matplotlib.pyplot as plt
from figures import check_readable
shown = []
def show():
    for number in plt.get_fignums():
        figure = plt.figure(number)
        figure.canvas.draw()
        titles = [axis.get_title() for axis in figure.axes]
        assert any([*titles, figure.get_suptitle()]), "no title"
        assert any(axis.has_data() for axis in figure.axes), "nothing drawn"
        check_readable(figure, sys.argv[1])
        shown.append(number)
plt.show = show
runpy.run_path(sys.argv[1], run_name="__main__")
assert len(shown) == 1, shown
print(time.process_time())
"""


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_a_script_begins_with_a_title_and_what_is_to_be_seen(script: Path) -> None:
    text = ast.get_docstring(ast.parse(script.read_text(encoding="utf-8")))
    assert text is not None
    title, line, empty, *rest = text.split("\n")
    assert len(line) >= len(title) and set(line) == {"="} and empty == ""
    assert 15 <= len(" ".join(rest).split()) <= 80


def test_pictures_of_the_readme_are_the_gallerys() -> None:
    """Each has its script named below it, and the script that copies it knows it."""
    text = (SCRIPTS[0].parents[2] / "README.md").read_text(encoding="utf-8")
    shown = re.findall(r"!\[[^]]*\]\(([^)]+)\)", text)
    assert shown == [f"docs/images/gallery_{name}.png" for name in UPDATE["GALLERY"]]
    for name in UPDATE["GALLERY"]:
        assert f"](examples/gallery/plot_{name}.py)" in text
        assert (SCRIPTS[0].parents[2] / f"docs/images/gallery_{name}.png").is_file()


def test_a_thumbnail_is_one_curve_without_words() -> None:
    reduce = runpy.run_path(str(SCRIPTS[0].parents[2] / "docs" / "thumbnails.py"))["reduce"]
    figure = Figure(layout="constrained")
    figure.suptitle("gain"), figure.supxlabel("x"), figure.supylabel("y")
    for axes in figure.subplots(2):
        axes.plot([0.0, 0.0, 1.0], "--", label="demand")
        axes.plot([0.0, 1.0, 5.0], label="response")
        axes.axhline(9.0)
        axes.set(title="gain", xlabel="x", ylabel="y")
        axes.text(0.0, 0.0, "here")
        axes.legend()
    figure.legend(loc="outside lower center")
    figure.draw_without_rendering()
    (axes,) = reduce(figure).axes
    (line,) = axes.lines
    assert list(line.get_ydata()) == [0.0, 1.0, 5.0] and axes.get_ylim()[1] < 6.0
    figure.draw_without_rendering()
    assert not [t for t in figure.findobj(Text) if t.get_visible() and t.get_text()]
    assert not figure.findobj(Legend)


@pytest.mark.slow
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_a_script_draws_one_readable_figure_in_time(script: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", DRAW, str(script)],
        cwd=tmp_path,
        env={**os.environ, "MPLBACKEND": "agg"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert float(done.stdout.split()[-1]) < LONGEST
