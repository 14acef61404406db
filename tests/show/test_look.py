"""The look of figures: formats, ticks of frequencies, text that can be read."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

from cmf_mj.analysis.frequency_response import FrequencyResponse
from cmf_mj.core.errors import InputError
from cmf_mj.show import look


def figure_of(width: float, height: float, letters: float = 8.0) -> Figure:
    """A figure with a line, a title and a legend."""
    figure = look.new_figure(width, height)
    axes = figure.subplots()
    axes.plot([0.0, 1.0, 2.0], label="a line")
    axes.set_title("gain", fontsize=letters)
    axes.set_xlabel("gain")
    look.legend(figure)
    return figure


@pytest.mark.parametrize("form", look.FORMATS)
def test_a_figure_has_the_format_it_is_asked_for(form: str, tmp_path: Path) -> None:
    with look.write_figures_as(form):
        (path,) = look.save_files({"gain.png": figure_of(4.0, 3.0)}, tmp_path)
    begins = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}[form]
    assert path.name == f"gain.{form}" and path.read_bytes().startswith(begins)
    assert look.save_figure(figure_of(4.0, 3.0), tmp_path / "after.png").suffix == ".png"
    with pytest.raises(InputError, match="figure_format"), look.write_figures_as("gif"):
        pass


@pytest.mark.parametrize(
    ("width", "points"),
    [
        (30.0, 9.0 * 72.0 * 30.0 / 1280.0),  # 9 px of 1280
        (4.0, 5.0),  # 22 px, as it is made
    ],
)
def test_no_text_is_too_small(width: float, points: float, tmp_path: Path) -> None:
    figure, found = figure_of(width, 3.0 * width / 4.0, letters=5.0), list[float]()
    figure.clear = lambda: found.extend(text.get_fontsize() for text in figure.findobj(Text))  # type: ignore[method-assign]
    look.save_figure(figure, tmp_path / "gain.png", dpi=20)
    assert min(found) == pytest.approx(points)


@pytest.mark.parametrize(
    ("ends", "expected"),
    [
        ((0.3, 30.0), "0.5 1 2 5 10 20"),
        ((0.1, 10.0), "0.1 0.2 0.5 1 2 5 10"),
        ((4.0, 50.0), "5 10 20 50"),
    ],
)
def test_frequencies_have_ticks_of_decades(ends: tuple[float, float], expected: str) -> None:
    figure = look.new_figure(8.0, 4.0)
    axes = figure.subplots()
    axes.plot(np.geomspace(*ends, 5), np.zeros(5))
    look.frequency_axis(axes.xaxis)
    axes.set_xlim(*ends)
    figure.draw_without_rendering()
    shown = [
        label.get_text()
        for at, label in zip(axes.get_xticks(), axes.get_xticklabels(), strict=True)
        if ends[0] * 0.999 <= at <= ends[1] * 1.001
    ]
    assert " ".join(shown) == expected and not axes.get_xticks(minor=True).size
    assert axes.get_xlabel() == "frequency [Hz]"


@pytest.mark.parametrize("stable", [True, False])
def test_a_legend_is_as_pale_as_its_curve(stable: bool) -> None:
    """Of a loop that is not stable all is pale; where coherence is low only the curve is."""
    omega, coherence = 2.0 * np.pi * np.arange(1.0, 5.0), np.array([1.0, 1.0, 0.1, 1.0])
    response = FrequencyResponse(1.0 / (1.0 + 1j * omega), omega, coherence, 0.0 * omega)
    _, gain, phase = look.bode_figure("", {"a law": response}, stable=stable)
    (line,), names = gain.get_legend_handles_labels()
    assert names == ["a law"]
    assert line.get_alpha() == (1.0 if stable else look.FAINT)
    for axis in (gain, phase):
        shown = [one for one in axis.lines if np.isfinite(one.get_ydata()).sum() > 1]  # type: ignore[arg-type]
        assert [one.get_alpha() for one in shown][:2] == ([1.0, 0.3] if stable else [0.3])


def test_a_legend_lies_beside_its_axes() -> None:
    figure = look.new_figure(6.0, 4.0)
    axes = figure.subplots()
    axes.plot([0.0, 1.0, 2.0], label="a line")
    look.legend(axes)
    figure.draw_without_rendering()
    legend = axes.get_legend()
    assert legend is not None
    box, inside = legend.get_window_extent(), axes.get_window_extent()
    assert inside.x1 <= box.x0 and box.x1 <= figure.bbox.x1
