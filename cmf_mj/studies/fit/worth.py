"""What to record next: how much narrower each planned recording would make what is not known.

A recording is simulated on the fitted machine, with the channels and at the rate of most recordings
that were fitted, and its derivatives by all numbers give the information H_c it would add, in noise
as large and coloured as what the fit left of those. One of valve commands has those with which the
machine follows its scenario under the law. For a number, or the least damping of a law, with the
gradient g in coordinates of the prior,

    s^2 = g' (H + 1)^-1 g          before, and with H + H_c in the stead of H after.
"""

import statistics
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.control.law import load_law
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.result import Field
from cmf_mj.core.settings import beside, read_toml, validated
from cmf_mj.facility.scenario import load_scenario
from cmf_mj.facility.simulate import simulate
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.record.record import Record
from cmf_mj.studies.fit.campaign import FILE, CampaignSettings, Recording
from cmf_mj.studies.fit.engine import Posterior
from cmf_mj.studies.fit.iteration import WIDTH, Fitter
from cmf_mj.studies.fit.likelihood import information
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

    `sought` is one of the posterior's names, or `damping`: the least of the campaign's law. Raises
    `InputError` for a fit without recordings, which leaves no noise.
    """
    check_name("number", sought, (*posterior.names, DAMPING))
    recorded = posterior.campaign.of(held_back=False)
    if not recorded:
        raise InputError("campaign: has no recordings that are fitted; allowed: one at least")
    rate = statistics.mode(one.record.rate for one in recorded)
    alike = [one.name for one in recorded if one.record.rate == rate]
    left: dict[str, Array] = {}  # what the fit left of each channel, one recording after the other
    for (name, channel), residual in posterior.linearised.residuals.items():
        if name in alike:
            rest = residual - residual.mean(axis=0)
            left[channel] = np.concatenate([left[channel], rest]) if channel in left else rest
    gradient = _gradient(posterior, sought)
    mine = slice(posterior.z.size)  # without clocks
    before = posterior.linearised.information.matrix[mine, mine] + np.eye(posterior.z.size)
    here = np.linalg.inv(before)
    found = []
    for one in _planned(posterior, Path(plan), rate, left):
        after = np.linalg.inv(before + _information(posterior, one, left, jobs))
        ratio = np.sqrt(np.diag(after) / np.diag(here))
        narrower = np.sqrt(gradient @ after @ gradient / (gradient @ here @ gradient))
        found.append(Worth(one.name, float(narrower), float(np.exp(np.log(ratio).mean()))))
    return sorted(found, key=lambda one: one.sought)


def _gradient(posterior: Posterior, sought: str) -> Array:
    """Of a number, or of the least damping, by the coordinates."""
    unit = np.eye(posterior.z.size)
    if sought != DAMPING:
        return np.asarray(unit[posterior.names.index(sought)])
    campaign = posterior.campaign

    def least(z: Array) -> float:
        there = posterior._replace(z=z)
        law = there.applied(campaign.law)
        return Linear(there.applied(campaign.plant)).damping(law)["least"]

    steps = _STEP * posterior.deviation[:, None] * unit
    ends = [(least(posterior.z + step), least(posterior.z - step)) for step in steps]
    return np.array([high - low for high, low in ends]) / (2.0 * _STEP * posterior.deviation)


def _planned(
    posterior: Posterior, folder: Path, rate: float, channels: Iterable[str]
) -> Iterator[Recording]:
    """Recordings of a plan with what they demand, as far as they have scenarios."""
    table = read_toml(folder / FILE)
    made = {name: {"file": "", **said} for name, said in table.get("recordings", {}).items()}
    settings = validated(CampaignSettings, table | {"recordings": made}, str(folder / FILE))
    plant = posterior.campaign.plant
    every = max(1, round(plant.machine.rate / rate))
    for name, said in settings.recordings.items():
        if said.source is None:
            continue
        run = load_scenario(folder / said.source)
        law = load_law(beside(folder, said.law or settings.law or plant.machine.law))
        driven = said.kind == "valves"
        legs = pose_to_legs(demand(run), plant.machine)
        known = {"leg_reference": legs[::every]} | dict.fromkeys(channels, legs[::every])
        if driven:
            machine = posterior.applied(plant)
            closed = simulate(machine, posterior.applied(law), legs, legs=True, record_every=every)
            known |= {key: closed[key] for key in ("valve_command", "leg_position")}
        time = np.arange(len(known["leg_position"])) * every / plant.machine.rate
        units = {key: "Pa" if key.endswith("pressure") else "m" for key in known}
        units |= {"valve_command": "1"} if driven else {}
        record = Record(time, known, units, {"sample_rate": plant.machine.rate / every})
        kept = said.model_copy(update={"held_back": False})
        yield Recording(name, kept, record, None if driven else law)


def _information(
    posterior: Posterior, planned: Recording, left: Mapping[str, Array], jobs: int
) -> Array:
    """What a recording would add, (n, n), in the noise that is `left` of each channel."""
    campaign = posterior.campaign
    alone = campaign._replace(
        settings=campaign.settings.model_copy(update={"clocks": False}),
        recordings=(planned,),
        evidence=campaign.evidence._replace(statements=(), shift=np.empty(0)),
    )
    fitter = Fitter(alone, "whole", jobs)
    model, z = fitter.model, posterior.z
    (one,) = model.pieces
    made = one._replace(measured=model.simulated(one, z, model.machine(z)))
    model.pieces = (made,)
    here = model.residuals(z)
    derivatives = fitter.derivatives(z, here, np.clip(posterior.deviation, *WIDTH))
    noise = {key: np.resize(left[key[1]], residual.shape) for key, residual in here.items()}
    return information(noise, derivatives, fitter.stage.order, fitter.spacing).matrix
