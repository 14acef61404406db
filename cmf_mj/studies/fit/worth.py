"""What to record next: how much narrower each planned recording would make what is not known.

A recording is simulated on the fitted machine and its derivatives by all numbers give the
information H_c it would add, in noise as large and coloured as what the fit left. For a number, or
the least damping of a law, with the gradient g in coordinates of the prior,

    s^2 = g' (H + 1)^-1 g          before, and with H + H_c in the stead of H after.
"""

from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.control.law import load_law
from cmf_mj.core.errors import check_name
from cmf_mj.core.result import Field
from cmf_mj.core.settings import beside, read_toml, validated
from cmf_mj.facility.scenario import load_scenario
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.record.record import Record
from cmf_mj.studies.fit.campaign import FILE, MEASURED, CampaignSettings, Recording
from cmf_mj.studies.fit.engine import Posterior
from cmf_mj.studies.fit.iteration import WIDTH, Fitter
from cmf_mj.studies.fit.likelihood import information
from cmf_mj.studies.fit.model import piece
from cmf_mj.studies.fit.plan import demand

Array = NDArray[np.float64]

DAMPING = "damping"  #: Stands for the law's least damping ratio.

_STEP = 0.1  #: Of the coordinates, for the gradient of the damping.


class Worth(NamedTuple):
    """What a planned recording would give."""

    recording: str
    sought: Annotated[float, Field(title="deviation of it, after over before", form=".3f")]
    mean: Annotated[float, Field(title="geometric mean of all", form=".3f")]


def worth(posterior: Posterior, plan: str | Path, sought: str, jobs: int = 2) -> list[Worth]:
    """Recordings of a plan's folder, the best first.

    `sought` is one of the posterior's names, or `damping`: the least of the campaign's law.
    """
    check_name("number", sought, (*posterior.names, DAMPING))
    gradient = _gradient(posterior, sought)
    mine = slice(posterior.z.size)  # without clocks
    before = posterior.linearised.information.matrix[mine, mine] + np.eye(posterior.z.size)
    here = np.linalg.inv(before)
    found = []
    for one in _planned(posterior, Path(plan)):
        after = np.linalg.inv(before + _information(posterior, one, jobs))
        ratio = np.sqrt(np.diag(after) / np.diag(here))
        narrower = np.sqrt(gradient @ after @ gradient / (gradient @ here @ gradient))
        found.append(Worth(one.name, float(narrower), float(np.exp(np.log(ratio).mean()))))
    return sorted(found, key=lambda one: one.sought)


def _gradient(posterior: Posterior, sought: str) -> Array:
    """Of a number, or of the least damping, by the coordinates."""
    unit = np.eye(posterior.z.size)
    if sought != DAMPING:
        return np.asarray(unit[posterior.names.index(sought)])
    known, base = posterior.campaign.unknowns, posterior.campaign.plant
    law = posterior.campaign.of(held_back=False)[0].law or load_law(base.machine.law)

    def least(z: Array) -> float:
        return Linear(known.apply(known.at(stats.norm.cdf(z)), base)).damping(law)["least"]

    steps = _STEP * posterior.deviation[:, None] * unit
    ends = [(least(posterior.z + step), least(posterior.z - step)) for step in steps]
    return np.array([high - low for high, low in ends]) / (2.0 * _STEP * posterior.deviation)


def _planned(posterior: Posterior, folder: Path) -> list[Recording]:
    """Recordings of a plan with their demands, as far as they have scenarios."""
    table = read_toml(folder / FILE)
    made = {name: {"file": "", **said} for name, said in table.get("recordings", {}).items()}
    settings = validated(CampaignSettings, table | {"recordings": made}, str(folder / FILE))
    plant = posterior.campaign.plant
    rate = posterior.campaign.recordings[0].record.rate
    found = []
    for name, said in settings.recordings.items():
        if said.source is None:
            continue
        run = load_scenario(folder / said.source)
        every = max(1, round(plant.machine.rate / rate))
        legs = pose_to_legs(demand(run)[::every], plant.machine)
        time = np.arange(legs.shape[0]) * every / plant.machine.rate
        channels = {"leg_reference": legs} | dict.fromkeys(MEASURED, legs)
        units = {"leg_reference": "m", "leg_position": "m"}
        units |= {"cap_pressure": "Pa", "rod_pressure": "Pa"}
        record = Record(time, channels, units, {"sample_rate": plant.machine.rate / every})
        law = load_law(beside(folder, said.law or settings.law or plant.machine.law))
        found.append(Recording(name, said, record, law))
    return found


def _information(posterior: Posterior, planned: Recording, jobs: int) -> Array:
    """What a recording would add, (n, n)."""
    kept = planned.settings.model_copy(update={"held_back": False})
    one_clock = posterior.campaign.settings.model_copy(update={"clocks": False})
    recordings = (planned._replace(settings=kept),)
    alone = posterior.campaign._replace(settings=one_clock, recordings=recordings)
    fitter = Fitter(alone, "whole", jobs)
    plant = fitter.model.machine(posterior.z)
    one = piece(planned, posterior.campaign.plant)
    made = one._replace(measured=one.simulated(plant, fitter.model.electronics(posterior.z)))
    fitter.model.pieces = (made,)
    here = fitter.model.residuals(posterior.z)
    width = np.clip(posterior.deviation, *WIDTH)
    derivatives = fitter.derivatives(posterior.z, here, width)
    # What the fit left of each channel, repeated to the length.
    noise, left = {}, posterior.linearised.residuals
    for channel in made.measured:
        parts = [one - one.mean(axis=0) for (_, of), one in left.items() if of == channel]
        key = planned.name, channel
        noise[key] = np.resize(np.concatenate(parts), here[key].shape)
    spacing = {planned.name: fitter.model.spacing(made)}
    return information(noise, derivatives, fitter.stage.order, spacing).matrix
