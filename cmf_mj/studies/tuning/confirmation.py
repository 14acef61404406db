"""What a law does in the simulation: the report's chirp and step for any cab, valves and pose.

Each case is measured as `studies.compare` measures it; at neutral with nominal valves it gives the
same numbers. Cross-talk comes from one run of orthogonal multisines in all degrees of freedom,

    share_ij(f) = |H_ij(f)| a_j / a_i,    i driven by j,

a the chirp's amplitudes, so that 0.33 in and 0.2 deg count alike; the largest between 0.5 and 6 Hz.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmf_mj import signals
from cmf_mj.analysis.frequency_response import (
    Bandwidths,
    bandwidths,
    frequency_response,
    matrix_frequency_response,
)
from cmf_mj.analysis.step_response import StepMetrics, step_metrics
from cmf_mj.control.law import Law
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.facility.simulation import simulate
from cmf_mj.machine.kinematics import DOFS
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters.loading import load_hydraulics
from cmf_mj.signals import composite as excitations
from cmf_mj.signals.single import Command
from cmf_mj.studies.comparison import STEP_PER_AMPLITUDE
from cmf_mj.studies.tuning.evaluation import CHIRP
from cmf_mj.studies.tuning.nominal import mismatched

CROSSTALK_BAND = (0.5, 6.0)
"""Frequencies of the cross-talk [Hz]."""


@dataclass(frozen=True)
class Trial:
    """One law in one degree of freedom of one machine."""

    law: Law
    cab: str
    dof: str
    seed: int | None = None  #: Of the valve gains; None for the nominal ones.
    pose: tuple[float, ...] = (0.0,) * 6  #: About which it moves [m, rad], z down.
    scale: float = 1.0  #: Of the report's amplitudes.
    quick: bool = False  #: Sweep in 30 s instead of 100 s.
    electronics: ElectronicsSettings | None = None

    def plant(self) -> Hexapod:
        """A machine of its own."""
        return Hexapod(self.cab, mismatched(load_hydraulics("hardware"), self.seed))

    @property
    def amplitude(self) -> float:
        """Of the chirp [m or rad]."""
        return float(CHIRP[DOFS.index(self.dof)]) * self.scale


class Outcome(NamedTuple):
    """What a trial gave."""

    trial: Trial
    bandwidths: Bandwidths
    step: StepMetrics
    clamped: float
    """Part of the sweep's frames, up to the -90 deg bandwidth, in which a leg's command is
    clamped."""


def _about(command: Command, pose: tuple[float, ...]) -> Command:
    return Command(command.pose + np.array(pose), command.description, command.seed)


def run_trial(trial: Trial) -> Outcome:
    """Run chirp and step of a trial."""
    plant, size = trial.plant(), trial.amplitude
    chirp = signals.chirp(trial.dof, size, duration=30.0 if trial.quick else 100.0)
    step = signals.step(trial.dof, size * STEP_PER_AMPLITUDE)
    sweep, stepped = (
        simulate(
            plant,
            trial.law,
            _about(command, trial.pose),
            electronics=trial.electronics,
            record_every=every,
        )
        for command, every in ((chirp, 16), (step, 8))
    )
    found = bandwidths(frequency_response(sweep, segment=10.0 if trial.quick else 20.0))
    rate = sweep.metadata["command"]["stop"] / sweep.metadata["command"]["duration"]
    until = 2.0 + np.nan_to_num(found.phase_hz, nan=10.0) / rate
    full = np.any(np.abs(sweep["valve_command"]) >= 1.0, axis=1)[sweep.time < until]
    return Outcome(trial, found, step_metrics(stepped), float(full.mean()))


def crosstalk(law: Law, cab: str, seed: int | None = None) -> NDArray[np.float64]:
    """Largest shares in 0.5 to 6 Hz, (6, 6), rows moved by columns; 0 on the diagonal."""
    trial = Trial(law, cab, "heave", seed)
    sizes = (0.5 * CHIRP).tolist()
    command = excitations.orthogonal_multisines(
        sizes, stop=10.0, period=30.0, spectrum="acceleration", periods=2, seed=1
    )
    response = matrix_frequency_response(simulate(trial.plant(), law, command, record_every=16))
    frequency = np.asarray(response.omega) / (2.0 * np.pi)
    band = (frequency >= CROSSTALK_BAND[0]) & (frequency <= CROSSTALK_BAND[1])
    gains = np.abs(np.asarray(response.frdata))[..., band]
    shares = np.nanmax(gains * (CHIRP[None, :] / CHIRP[:, None])[..., None], axis=-1)
    np.fill_diagonal(shares, 0.0)
    return np.asarray(shares)
