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


def _step_text(result: CaseResult) -> str:
    """What the step of a law shows."""
    measures, case = result.measures, result.case
    name = f"{case.law.title}, {case.plant.replace('_', ' ')}"
    if not measures.stable:
        return f"{name}: rings on"
    error = number(100.0 * measures.steady_state_error, ".2f %")
    return (
        f"{name}: overshoot {100.0 * measures.overshoot:.0f} %, damping ratio "
        f"{measures.damping_ratio:.2f}, steady-state error {error}"
    )


_DRAW: Mapping[str, Callable[[Sequence[CaseResult]], Figure]] = {
    "responses": responses_figure,
    "steps": step_figure,
    "linear_responses": lambda _: loop_figures(law_loops("velocity")).bode,
    "linear_steps": lambda _: loop_figures(law_loops("velocity")).step,
}


class ReportFigure(NamedTuple):
    """A figure of the report, and how ours is made."""

    number: str
    title: str
    kind: str  #: Key of `_DRAW` and of the captions.
    needs: tuple[RunSpec, ...]  #: Runs it is drawn from.
    note: str = ""  #: At the end of its caption.

    def draw(self, runs: Runs) -> tuple[Figure, str]:
        """The figure and its caption."""
        results = [runs.results[need] for need in self.needs]
        figure = _DRAW[self.kind](results)
        figure.axes[0].set_title(self.title)
        dof = self.needs[0].dof if self.needs else "heave"
        values: dict[str, Any] = {
            "axis": dof.capitalize(),
            "size": "0.33 in" if dof in ("surge", "sway", "heave") else "0.2 deg",
            "steps": "; ".join(map(_step_text, results)) if self.kind == "steps" else "",
        }
        caption = CONTENTS["caption"][self.kind].format(**values)
        plants = dict.fromkeys(need.plant for need in self.needs)
        sentences = [caption, *(CONTENTS["words"][plant] for plant in plants), self.note]
        return figure, " ".join(filter(None, sentences))


FIGURES = tuple(
    ReportFigure(
        number=entry["number"],
        title=entry["title"],
        kind=entry["draw"],
        needs=specs(*entry.get("runs", ())),
        note=entry.get("note", ""),
    )
    for entry in CONTENTS["figure"]
)
"""All figures that are made here, in the report's order."""
