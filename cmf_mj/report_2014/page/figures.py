"""The report's figures as ours: laws on the two plants, and around the report's linear models."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from matplotlib.figure import Figure

from cmf_mj.core.result import number
from cmf_mj.report_2014.model_tables import law_loops, loop_figures
from cmf_mj.report_2014.page.runs import Runs, RunSpec, specs
from cmf_mj.report_2014.page.tables import CONTENTS
from cmf_mj.show.comparison import responses_figure, step_figure
from cmf_mj.studies.case import CaseResult


def _step_text(one: CaseResult) -> str:
    """What the step of a law shows."""
    measures, name = one.measures, f"{one.case.law.title}, {one.case.plant.replace('_', ' ')}"
    if not measures.stable:
        return f"{name}: rings on"
    error = number(100.0 * measures.steady_state_error, ".2f %")
    return (
        f"{name}: overshoot {100.0 * measures.overshoot:.0f} %, damping ratio "
        f"{measures.damping_ratio:.2f}, steady-state error {error}"
    )


_DRAWN: Mapping[str, Callable[[Sequence[CaseResult]], Figure]] = {
    "responses": responses_figure,
    "steps": step_figure,
    "linear_responses": lambda _: loop_figures(law_loops("velocity"))[0],
    "linear_steps": lambda _: loop_figures(law_loops("velocity"))[1],
}


class ReportFigure(NamedTuple):
    """A figure of the report, and how ours is made."""

    number: str
    title: str
    kind: str  #: One of `_DRAWN`, and its caption.
    needs: tuple[RunSpec, ...]  #: Runs it is drawn from.
    note: str = ""  #: At the end of its caption.

    def draw(self, runs: Runs) -> tuple[Figure, str]:
        """The figure and its caption."""
        cases = [runs.results[need] for need in self.needs]
        figure = _DRAWN[self.kind](cases)
        figure.axes[0].set_title(self.title)
        dof = self.needs[0].dof if self.needs else "heave"
        values: dict[str, Any] = {
            "axis": dof.capitalize(),
            "size": "0.33 in" if dof in ("surge", "sway", "heave") else "0.2 deg",
            "steps": "; ".join(map(_step_text, cases)) if self.kind == "steps" else "",
        }
        plants = dict.fromkeys(need.on for need in self.needs)
        caption = CONTENTS["caption"][self.kind].format(**values)
        parts = [caption, *(CONTENTS["words"][on] for on in plants), self.note]
        return figure, " ".join(filter(None, parts))


FIGURES = tuple(
    ReportFigure(
        *(entry["number"], entry["title"], entry["draw"]),
        *(specs(*entry.get("runs", ())), entry.get("note", "")),
    )
    for entry in CONTENTS["figure"]
)
"""All figures that are made here, in the report's order."""
