"""What is stated of a machine beside what the fitted one makes of it."""

from typing import Annotated, NamedTuple

import numpy as np
from scipy import stats

from cmf_mj.core.errors import InputError, RunError
from cmf_mj.core.result import Field, number
from cmf_mj.core.threads import on_threads
from cmf_mj.facility.unknowns import Unknowns, Values
from cmf_mj.plant.plant import Plant
from cmf_mj.studies.fit.engine import Posterior
from cmf_mj.studies.fit.evidence import Found

SAMPLES = 128  #: Machines that a spread is read from.
ENDS = (0.05, 0.95)  #: Quantiles that bound it.
FAR = 2.0  #: Deviations from which a number speaks against the model.


def _share(value: float) -> str:
    return number(100.0 * value, ".0f %")


class Stated(NamedTuple):
    """A number that is stated."""

    evidence: str
    what: str
    role: str  #: `fitted` or `held back`.
    stated: Annotated[float, Field(form=".3g")]
    before: Annotated[float, Field(title="data sheet", form=".3g")]
    fitted: Annotated[float, Field(form=".3g")]
    """Simulated where the campaign asks for it."""
    off: Annotated[float, Field(title="off, in deviations", form="+.2f")]
    low: Annotated[float, Field(title="5 %", form=".3g")]
    """5 % of the machines that the fit leaves open lie below; what is held is drawn too."""
    high: Annotated[float, Field(title="95 %", form=".3g")]
    unstable: Annotated[float, Field(form=_share)]
    """Share of these machines whose linear loop is unstable."""

    @property
    def close(self) -> bool:
        """Whether the fitted machine has it within two deviations."""
        return abs(self.off) <= FAR


def stated(
    posterior: Posterior, jobs: int = 2, samples: int = SAMPLES, seed: int = 0
) -> list[Stated]:
    """All statements of a campaign; the spread is of so many `samples`, at least 2."""
    if samples < 2:
        raise InputError(f"samples: {samples} must be at least 2")
    campaign, evidence = posterior.campaign, posterior.campaign.evidence
    if not evidence.statements:
        return []
    base, known = campaign.plant, campaign.unknowns
    held = Unknowns(campaign.settings.held).on(base)
    around = held.draw("latin_hypercube", samples, seed) if held else [{}] * samples
    shares = stats.norm.cdf(posterior.samples(samples, seed))
    drawn = [known.at(one) | other for one, other in zip(shares, around, strict=True)]

    def made(values: Values) -> Found | None:
        try:
            return evidence.linear(values, evidence.unknowns.apply(values, base))
        except (InputError, RunError):
            return None

    machines = [one for one in on_threads(made, drawn, jobs) if one is not None]
    open_ = np.array([one.value for one in machines])
    unstable = 1.0 - np.mean([one.stable for one in machines], axis=0)
    best = known.at(stats.norm.cdf(posterior.z))
    fitted: Plant = known.apply(best, base)
    before = evidence.linear({}, base).value
    after = evidence.linear(best, fitted).value
    if campaign.settings.simulated:
        after = evidence.simulated(best, fitted, jobs)
    rows = []
    for i, one in enumerate(evidence.statements):
        there = open_[np.isfinite(open_[:, i]), i]
        ends = np.quantile(there, ENDS) if there.size else (np.nan, np.nan)
        off = -one.excess(float(after[i])) if np.isfinite(after[i]) else np.nan
        role = "held back" if one.held_back else "fitted"
        numbers = (one.value, before[i], after[i], off, *ends, unstable[i])
        rows.append(Stated(one.evidence, one.what, role, *map(float, numbers)))
    return rows
