"""The runs behind figures and tables: chirp and step of a law, each made once, shared by all.

Two plants stand for the report's two sources. The `model` is its non-linear model, six single legs
with the `report` hydraulics; the `machine` is a stand-in for the hardware, the hexapod with the GFD
and the `hardware` hydraulics. Runs share nothing and go on threads; results do not depend on how
many there are.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Literal, NamedTuple

from cmf_mj.core.threads import on_threads
from cmf_mj.studies.case import CaseResult, make_case, run_case

PlantName = Literal["model", "machine"]

HYDRAULICS: Mapping[PlantName, str] = {"model": "report", "machine": "hardware"}
"""Hydraulic sets of the two plants."""

PLANT_KINDS: Mapping[PlantName, str] = {"model": "single_legs", "machine": "hexapod"}

CAB = "gfd"  #: Cab of the machine.


class RunSpec(NamedTuple):
    """Chirp and step of a law along one degree of freedom."""

    plant: PlantName
    law: str
    dof: str = "heave"


def specs(*lines: str) -> tuple[RunSpec, ...]:
    """Runs from lines of `plant law dof`: commas between several; the last is heave by default."""
    return tuple(
        RunSpec(*fields)  # type: ignore[arg-type]
        for line in lines
        for fields in product(*(part.split(",") for part in line.split()))
    )


@dataclass(frozen=True)
class Runs:
    """Results of all runs asked for."""

    results: Mapping[RunSpec, CaseResult]
    quick: bool

    def case(self, plant: PlantName, law: str, dof: str = "heave") -> CaseResult:
        """Chirp and step."""
        return self.results[RunSpec(plant, law, dof)]


def perform(
    needs: Iterable[RunSpec],
    *,
    jobs: int | None = None,
    quick: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Runs:
    """Make all runs, each once; `progress` is called with (done, in all).

    Results do not depend on the number of threads, `jobs`; `quick` sweeps 30 s for 100 s.
    """

    def run(spec: RunSpec) -> CaseResult:
        kind, hydraulics = PLANT_KINDS[spec.plant], HYDRAULICS[spec.plant]
        return run_case(make_case(spec.law, spec.dof, kind, CAB, hydraulics, quick=quick))

    # The longest first, so that no thread is left with one at the end.
    order = sorted(set(needs), key=lambda spec: (spec.plant != "machine", spec))
    return Runs(dict(zip(order, on_threads(run, order, jobs, progress), strict=True)), quick)
