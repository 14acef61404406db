"""Maps of a study of the unknown: smooth limits, with "stable" on their side."""

from itertools import product
from typing import Any, cast

import numpy as np
import pyarrow as pa
import pytest

from cmf_mj.report_2014.posterior import answers
from cmf_mj.report_2014.posterior.run import MAPS, Results, load_posterior
from cmf_mj.report_2014.posterior.tables import limits_figure


class Made:
    """What maps read of results: a damping ratio in closed form over the range of two unknowns."""

    study = load_posterior("rotation")

    def __init__(self) -> None:
        """Rows at the points of the study's grid."""
        unknowns, sides = self.study.settings.unknowns, np.linspace(0.0, 1.0, 13)
        rows: list[dict[str, Any]] = [
            {"law": law.name, "about": f"{x} {y}"}
            | {x: float(unknowns[x].at(p)), y: float(unknowns[y].at(q))}
            | dict.fromkeys(("roll", "pitch", "yaw"), ratio(p, q, number))
            for number, law in enumerate(self.study.laws)
            for x, y in MAPS
            for p, q in product(sides, sides)
        ]
        names = {name for row in rows for name in row}
        self.points = pa.table({name: [row.get(name) for row in rows] for name in names})


def ratio(p: Any, q: Any, number: int) -> Any:
    """A cubic, whose limits are parabolas one beside the other."""
    return 0.3 * (q - 0.5) ** 2 + 0.2 * (p - 0.1) - 0.01 * number + 0.1 * p**3


@pytest.fixture(scope="module")
def results() -> Results:
    return cast(Results, Made())


def test_a_map_between_its_points_is_the_cubic_that_they_lie_on(results: Results) -> None:
    law, (x, y) = results.study.laws[2].name, MAPS[2]
    across, up, found = answers.stability_map(results, x, y, law, "pitch")
    fine = np.linspace(0.0, 1.0, across.size)
    assert across.size > 2 * results.study.settings.grid
    assert up == pytest.approx(results.study.settings.unknowns[y].at(fine))
    assert found == pytest.approx(ratio(fine[:, None], fine, 2), abs=1e-12)


def test_stable_is_written_where_the_damping_ratio_is_positive(results: Results) -> None:
    figure = limits_figure(results)
    figure.draw_without_rendering()
    words = [(axes, text) for axes in figure.axes for text in axes.texts]
    assert len(words) > 2 * len(figure.axes)
    laws = {line.get_label(): line.get_color() for line in figure.axes[0].lines}
    colours = list(laws.values())
    for axes, text in words:
        step = 0.04 if text.get_va() == "bottom" else -0.04
        at = axes.transAxes.inverted().transform(
            text.get_transform().transform(text.get_position())
        )
        assert text.get_text() == "stable"
        assert ratio(at[0], at[1] + step, colours.index(text.get_color())) > 0.0
