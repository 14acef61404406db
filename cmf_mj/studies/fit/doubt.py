"""What a fit does not know: numbers in doubt, residuals, held-back recordings, effects, a verdict.

**Open directions and residuals.** What recordings leave open, and what is left: see `likelihood`.

**Held back.** Recordings the fit never saw: ratio of measured to simulated leg positions over
frequency, R = S_ms / S_ss, where the simulated ones have power; gain in dB and phase in deg.
Of two clocks the offset that is best is taken out.

**Stated.** Numbers of `evidence` beside those of the fitted machine, fitted or held back.

**Effects.** Of what the machine may have beside its numbers each is tried (`effects`).
"""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import signal, stats

from cmf_mj.core.errors import InputError, RunError
from cmf_mj.core.files import write_text
from cmf_mj.core.result import Field, Result, Table, fields_of, number
from cmf_mj.core.threads import on_threads
from cmf_mj.facility.unknowns import Unknowns, Values
from cmf_mj.studies.engine import one_library_thread
from cmf_mj.studies.fit import likelihood
from cmf_mj.studies.fit.effects import Effect, try_effects
from cmf_mj.studies.fit.engine import Posterior
from cmf_mj.studies.fit.evidence import LoopNumbers
from cmf_mj.studies.fit.iteration import Fitter
from cmf_mj.studies.fit.likelihood import BLOCK, OpenDirection
from cmf_mj.studies.fit.model import Model

Array = NDArray[np.float64]

JUDGED_TO = 8.0  #: Frequency to which a prediction is judged [Hz].
WITHIN_DB, WITHIN_DEG = 0.5, 3.0  #: What a prediction may be off.

FAR = 2.0  #: Deviations from which a number that is stated speaks against the model.

_SAMPLES = 128  #: Machines that the spread of what is stated is read from.
_QUANTILES = (0.05, 0.95)  #: Quantiles that bound this spread.
_CORRELATED = 2.0  #: Correlation over its bound from which on the model misses something.
_POWER_SHARE = 1e-4  #: Share of the largest power above which a frequency counts.


class ChannelResidual(NamedTuple):
    """What the fit does not explain of a channel in a recording."""

    recording: str
    channel: str
    rms: Annotated[float, Field(title="rms, SI", form=".3g")]
    share: Annotated[float, Field(title="of the channel", form=".2%")]
    correlation: Annotated[float, Field(title="with demand, over chance", form=".2f")]
    worst_at: Annotated[float, Field(title="worst at", form=".1f s")]
    worst: Annotated[float, Field(title="there, over rms", form=".1f")]


def measure_residuals(posterior: Posterior, fitter: Fitter) -> list[ChannelResidual]:
    """Residuals by recording and channel; the worst correlation of any leg."""
    rows = []
    for piece in fitter.model.pieces:
        spacing = fitter.spacing[piece.name]
        block = max(1, round(BLOCK / spacing))
        measured = fitter.model.low_passed(piece, piece.measured)
        demand = fitter.model.low_passed(piece, {"demand": piece.demand})["demand"]
        for channel, values in measured.items():
            residual = posterior.linearised.residuals[piece.name, channel]
            residual = residual - residual.mean(axis=0)
            begins = range(0, len(residual) - block + 1, block)
            block_rms = [np.std(residual[begin : begin + block]) for begin in begins]
            rms, worst_block = float(np.std(residual)), int(np.argmax(block_rms))
            share = rms / max(float(np.std(values)), 1e-300)
            correlation = max(map(likelihood.demand_correlation, residual.T, demand.T))
            worst_at = piece.first_sample / piece.rate + worst_block * block * spacing
            worst = float(block_rms[worst_block]) / max(rms, 1e-300)
            row = ChannelResidual(piece.name, channel, rms, share, correlation, worst_at, worst)
            rows.append(row)
    return rows


class Prediction(NamedTuple):
    """A held-back recording against what the fit says."""

    recording: str
    gain: Annotated[float, Field(title="worst gain to 8 Hz", form="+.2f dB")]
    phase: Annotated[float, Field(title="worst phase", form="+.1f deg")]
    pressure: Annotated[float, Field(title="pressures missed", form=".2%")]

    @property
    def is_close(self) -> bool:
        """Whether gain and phase are within `WITHIN_DB` and `WITHIN_DEG`."""
        return abs(self.gain) <= WITHIN_DB and abs(self.phase) <= WITHIN_DEG


def predict_held_back(posterior: Posterior) -> list[Prediction]:
    """Simulate the recordings held back on the fitted machine, and compare."""
    model, rows = Model(posterior.campaign, held_back=True), []
    plant = model.plant_at(posterior.z)
    for piece in model.pieces:
        measured, rate = piece.measured, piece.rate
        simulated = model.simulate(piece, posterior.z, plant)
        if posterior.campaign.settings.clocks:  # nor has the fit seen how far these are apart
            ratios = _ratios(measured["leg_position"], simulated["leg_position"], rate)
            offset = _clock_offset(*ratios)
            simulated = model.simulate(piece, posterior.z, plant, offset)
        measured = {name: values[piece.first_sample :] for name, values in measured.items()}
        simulated = {name: values[piece.first_sample :] for name, values in simulated.items()}
        _, ratio = _ratios(measured["leg_position"], simulated["leg_position"], rate)
        gains, phases = 20.0 * np.log10(np.abs(ratio)), np.degrees(np.angle(ratio))
        missed_share = 0.0
        for channel in simulated.keys() - {"leg_position"}:
            error = measured[channel] - simulated[channel]
            share = np.std(error - error.mean(axis=0)) / np.std(measured[channel])
            missed_share = max(missed_share, float(share))
        gain, phase = (float(x[np.abs(x).argmax()]) for x in (gains, phases))
        rows.append(Prediction(piece.name, gain, phase, missed_share))
    return rows


def _ratios(measured: Array, simulated: Array, rate: float) -> tuple[Array, NDArray[np.complex128]]:
    """Frequencies [Hz] up to `JUDGED_TO`, and measured over simulated histories at them."""
    length = min(int(4.0 * rate), measured.shape[0])
    settings: dict[str, Any] = {"fs": rate, "nperseg": length, "axis": 0}
    frequency, cross = signal.csd(simulated, measured, **settings)
    _, power = signal.welch(simulated, **settings)
    power = power.sum(axis=1)
    in_band = (frequency > 0.0) & (frequency <= JUDGED_TO)
    lines = in_band & (power > _POWER_SHARE * power[in_band].max())
    return frequency[lines], cross.sum(axis=1)[lines] / power[lines]


def _clock_offset(frequency: Array, ratio: NDArray[np.complex128]) -> float:
    """Offset of the clocks [s] that a phase in proportion to frequency shows."""
    return float(frequency @ np.angle(ratio) / (2.0 * np.pi * frequency @ frequency))


class StatedNumber(NamedTuple):
    """A number that is stated, and what the machine before and after the fit has."""

    evidence: str
    quantity: Annotated[str, Field(title="what")]
    role: str  #: `fitted` or `held back`.
    stated: Annotated[float, Field(form=".3g")]
    before: Annotated[float, Field(title="data sheet", form=".3g")]
    fitted: Annotated[float, Field(form=".3g")]
    """Simulated where the campaign asks for it."""
    error: Annotated[float, Field(title="off, in deviations", form="+.2f")]
    low: Annotated[float, Field(title="5 %", form=".3g")]
    """5 % of the machines that the fit leaves open lie below; what is held is drawn too."""
    high: Annotated[float, Field(title="95 %", form=".3g")]
    unstable: Annotated[float, Field(form=".0f %", unit="%")]
    """Share of these machines whose linear loop is unstable."""

    @property
    def is_close(self) -> bool:
        """Whether the fitted machine has it within `FAR` deviations."""
        return abs(self.error) <= FAR


def compare_stated(
    posterior: Posterior, jobs: int = 2, samples: int = _SAMPLES
) -> list[StatedNumber]:
    """All statements of a campaign beside those numbers of the fitted machine."""
    campaign, evidence = posterior.campaign, posterior.campaign.evidence
    if not evidence.statements:
        return []
    sheet, unknowns = campaign.plant, campaign.unknowns
    samples_of_loops = _sample_loops(posterior, jobs, samples)
    sampled_values = np.array([loops.value for loops in samples_of_loops])
    unstable = 1.0 - np.mean([loops.stable for loops in samples_of_loops], axis=0)
    fitted_values, plant = unknowns.at(stats.norm.cdf(posterior.z)), posterior.applied(sheet)
    before = evidence.linear_numbers({}, sheet).value
    fitted = evidence.linear_numbers(fitted_values, plant).value
    if campaign.settings.simulated:
        fitted = evidence.simulated_numbers(fitted_values, plant, jobs)
    rows = []
    for i, statement in enumerate(evidence.statements):
        finite = sampled_values[np.isfinite(sampled_values[:, i]), i]
        low, high = np.quantile(finite, _QUANTILES) if finite.size else (np.nan, np.nan)
        error = -statement.excess(float(fitted[i])) if np.isfinite(fitted[i]) else np.nan
        role = "held back" if statement.held_back else "fitted"
        numbers = (statement.value, before[i], fitted[i], error, low, high, unstable[i])
        row = StatedNumber(statement.evidence, statement.quantity, role, *map(float, numbers))
        rows.append(row)
    return rows


def _sample_loops(posterior: Posterior, jobs: int, samples: int) -> list[LoopNumbers]:
    """Draw machines that the fit leaves open, and compute the statements' numbers of each."""
    campaign, evidence = posterior.campaign, posterior.campaign.evidence
    held = Unknowns(campaign.settings.held).on(campaign.plant)
    held_values = held.draw("latin_hypercube", samples, 0) if held else [{}] * samples
    points = zip(stats.norm.cdf(posterior.samples(samples)), held_values, strict=True)
    drawn_values = [campaign.unknowns.at(shares) | others for shares, others in points]

    def loop_numbers(values: Values) -> LoopNumbers | None:
        try:
            return evidence.linear_numbers(values, evidence.unknowns.apply(values, campaign.plant))
        except (InputError, RunError):
            return None

    loops = on_threads(loop_numbers, drawn_values, jobs)
    return [numbers for numbers in loops if numbers is not None]


class Doubt(NamedTuple):
    """All that speaks against a fit."""

    open_directions: tuple[OpenDirection, ...]
    twins: tuple[tuple[str, str], ...]  #: Numbers that can be exchanged.
    residuals: tuple[ChannelResidual, ...]
    predictions: tuple[Prediction, ...]
    effects: tuple[Effect, ...]
    stated: tuple[StatedNumber, ...]

    @property
    def missed(self) -> list[ChannelResidual]:
        """Residuals that go with the demand, the worst first."""
        rows = [row for row in self.residuals if row.correlation > _CORRELATED]
        return sorted(rows, key=lambda row: -row.correlation)

    @property
    def is_explained(self) -> bool:
        """Whether nothing that was looked at speaks against the model."""
        rows: list[Prediction | StatedNumber] = [*self.predictions, *self.stated]
        return all(row.is_close for row in rows) and not (self.missed or self.helpful_effects)

    @property
    def helpful_effects(self) -> list[Effect]:
        """Effects that would explain more than chance, the most first."""
        return [effect for effect in self.effects if effect.helps]

    def widened(self, posterior: Posterior) -> Posterior:
        """The posterior where the machine may have each of the effects that help, or none."""
        shifts = [effect.shift for effect in self.helpful_effects]
        return posterior._replace(shifts=np.reshape(shifts, (-1, posterior.z.size)))

    def tables(self) -> list[Table]:
        """What the recordings leave open, residuals, predictions, effects; none of them empty."""
        results: list[Result[Any]] = [
            Result(
                self.open_directions, fields_of(OpenDirection), "What the recordings leave open"
            ),
            Result(self.residuals, fields_of(ChannelResidual), "What is left"),
            Result(self.predictions, fields_of(Prediction), "Recordings held back"),
            Result(self.effects, fields_of(Effect)[:2], "Effects that were tried"),
            Result(self.stated, fields_of(StatedNumber), "What is stated"),
        ]
        return [result.table for result in results if len(result)]

    @property
    def verdict(self) -> str:
        """How far the fit may be trusted, in words."""
        lines = [f"{first} and {second} cannot be separated." for first, second in self.twins]
        data = "the recordings" if self.residuals else "what is stated"
        if self.is_explained:
            text = f"The model explains {data}: "
            text += "what is left does not go with the demand" if self.residuals else "all is close"
            text += ", no effect tried helps" if self.effects else ""
            if self.predictions:
                text += f", and {len(self.predictions)} held back are predicted within "
                text += f"{WITHIN_DB:g} dB and {WITHIN_DEG:g} deg to {JUDGED_TO:g} Hz"
            return "\n".join([*lines, f"{text}."])
        lines.append(f"The model does not explain {data}.")
        lines += [
            f"{row.recording}, {row.channel}: what is left goes with the demand, "
            f"{row.correlation:.1f} times the bound of chance, most at {row.worst_at:.1f} s."
            for row in self.missed[:3]
        ]
        lines += [
            f"{row.recording}: held back, predicted {row.gain:+.2f} dB and "
            f"{row.phase:+.1f} deg off."
            for row in self.predictions
            if not row.is_close
        ]
        lines += [
            f"{row.evidence}, {row.quantity}: {row.role}, stated {row.stated:.3g}, the fitted "
            f"machine has {number(row.fitted if np.isfinite(row.fitted) else 'none', '.3g')}."
            for row in self.stated
            if not row.is_close
        ]
        if self.helpful_effects:
            names = ", ".join(effect.name for effect in self.helpful_effects)
            lines.append(f"These effects would explain more, the most first: {names}.")
        elif self.effects:
            lines.append("None of the effects tried helps: the model lacks another.")
        return "\n".join(lines)

    def page_writer(self, numbers: Table) -> Callable[[Path], Path]:
        """A function that writes the page of the fit to a path, its `numbers` first."""
        parts = ["# How far this fit may be trusted", self.verdict]
        tables = (numbers, *self.tables())
        parts += [f"## {table.title}\n\n{table.markdown()}" for table in tables]
        return lambda path: write_text(path, "\n\n".join(parts) + "\n")


@one_library_thread()
def doubt(posterior: Posterior, jobs: int = 2, *, effects: bool = True) -> Doubt:
    """Look for what speaks against a fit; with further `effects` where they are to be tried."""
    fitter = Fitter(posterior.campaign, "whole", jobs)
    directions = likelihood.open_directions(posterior.covariance, posterior.names)
    return Doubt(
        open_directions=tuple(directions),
        twins=posterior.twins,
        residuals=tuple(measure_residuals(posterior, fitter)),
        predictions=tuple(predict_held_back(posterior)),
        effects=tuple(try_effects(posterior.linearised, fitter)) if effects else (),
        stated=tuple(compare_stated(posterior, jobs)),
    )
