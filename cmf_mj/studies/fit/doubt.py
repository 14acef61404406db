"""What a fit does not know: numbers in doubt, residuals, held-back recordings, effects, a verdict.

**Directions.** Eigenvectors of the covariance in the prior's coordinates: along those whose
deviation is near 1 the recordings say nothing.

**Residuals.** Of a model that explains everything they do not depend on the demand, the sign of its
speed, or how fast it moves. With both whitened, of K lags of independent ones the largest
correlation is below

    Phi^-1(1 - 0.005 / K) / sqrt(N)           in 99 of 100 cases, K all that are looked at.

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
from cmf_mj.studies.fit.effects import Effect, tried
from cmf_mj.studies.fit.engine import Posterior
from cmf_mj.studies.fit.evidence import Found
from cmf_mj.studies.fit.iteration import Fitter
from cmf_mj.studies.fit.likelihood import BLOCK, coefficients
from cmf_mj.studies.fit.model import Model

Array = NDArray[np.float64]

TO = 8.0  #: Frequency to which a prediction is judged [Hz].
WITHIN_DB, WITHIN_DEG = 0.5, 3.0  #: What a prediction may be off.

FAR = 2.0  #: Deviations from which a number that is stated speaks against the model.

_SAMPLES = 128  #: Machines that the spread of what is stated is read from.
_ENDS = (0.05, 0.95)  #: Quantiles that bound it.
_LAGS = 20
_LOOKS = 18  #: Correlations of a channel: three of each leg.
_ORDER = 12
_CHANCE = 2.0  #: Correlation over its bound from which the model is said to miss something.
_POWER = 1e-4  #: Share of the largest power above which a frequency counts.


class Weak(NamedTuple):
    """A direction that the recordings leave open."""

    deviation: Annotated[float, Field(title="deviation over that before", form=".2f")]
    numbers: str  #: What changes together, with signs.


def weak(posterior: Posterior, above: float = 0.5) -> list[Weak]:
    """Directions along which more than a share `above` of the prior's width is left."""
    values, vectors = np.linalg.eigh(posterior.covariance)
    found = []
    for value, vector in sorted(zip(values, vectors.T, strict=True), key=lambda pair: -pair[0]):
        if (deviation := float(np.sqrt(value))) > above:
            vector = vector * np.sign(vector[np.argmax(np.abs(vector))])
            chosen = [i for i in np.argsort(-np.abs(vector)) if abs(vector[i]) > 0.3]
            said = [f"{posterior.names[i]} {'up' if vector[i] > 0 else 'down'}" for i in chosen]
            found.append(Weak(deviation, ", ".join(said)))
    return found


class Left(NamedTuple):
    """What is left of a channel in a recording."""

    recording: str
    channel: str
    rms: Annotated[float, Field(title="rms, SI", form=".3g")]
    share: Annotated[float, Field(title="of the channel", form=".2%")]
    correlation: Annotated[float, Field(title="with demand, over chance", form=".2f")]
    worst_at: Annotated[float, Field(title="worst at", form=".1f s")]
    worst: Annotated[float, Field(title="there, over rms", form=".1f")]


def left(posterior: Posterior, fitter: Fitter) -> list[Left]:
    """Residuals by recording and channel; the worst correlation of any leg."""
    found = []
    for one in fitter.model.pieces:
        spacing = fitter.spacing[one.name]
        zero = {name: np.zeros_like(value) for name, value in one.measured.items()}
        measured = fitter.model.compared(one, zero)
        asked = one._replace(measured={"demand": one.demand})
        demand = fitter.model.compared(asked, {"demand": 0.0 * one.since[:, None]})["demand"]
        for channel in measured:
            residual = posterior.linearised.residuals[one.name, channel]
            still = residual - residual.mean(axis=0)
            block = max(1, round(BLOCK / spacing))
            sizes = [np.std(still[i : i + block]) for i in range(0, len(still) - block + 1, block)]
            rms, worst = float(np.std(still)), int(np.argmax(sizes))
            share = rms / max(float(np.std(measured[channel])), 1e-300)
            correlation = max(map(_correlated, still.T, demand.T))
            at = one.first / one.rate + worst * block * spacing
            over = float(sizes[worst]) / max(rms, 1e-300)
            found.append(Left(one.name, channel, rms, share, correlation, at, over))
    return found


def _correlated(residual: Array, demand: Array) -> float:
    """Largest correlation of a residual's history with the motion asked for, over its bound.

    Linear effects go with the demand, friction and dead zones with the sign of its speed, and what
    is neither, with how fast it moves: e^2 against the speed squared.
    """
    e, speed = _white(residual), np.gradient(demand)
    fast = speed**2 / max(float(np.mean(speed**2)), 1e-300)
    pairs = [(e, _white(demand)), (e, _white(np.sign(speed))), (_white(e**2), _white(fast))]
    return max(_over_chance(*pair) for pair in pairs)


def _over_chance(e: Array, u: Array) -> float:
    """Largest correlation of two white histories over what chance reaches once in 100 times."""
    count = min(e.size, u.size)
    e, u = e[-count:], u[-count:]
    if not e.any() or not u.any():
        return 0.0
    e, u = (x / np.sqrt(np.mean(x**2)) for x in (e, u))
    lags = range(-_LAGS // 4, _LAGS)
    values = [
        float(np.dot(e[max(k, 0) : count + min(k, 0)], u[max(-k, 0) : count - max(k, 0)])) / count
        for k in lags
    ]
    bound = stats.norm.ppf(1.0 - 0.005 / (_LOOKS * len(lags))) / np.sqrt(count)
    return float(np.abs(values).max() / bound)


def _white(history: Array) -> Array:
    column = (history - history.mean())[:, None]
    colour = coefficients(column, _ORDER)
    return np.asarray(signal.lfilter(colour, [1.0], column[:, 0])[colour.size - 1 :])


class Prediction(NamedTuple):
    """A held-back recording against what the fit says."""

    recording: str
    gain: Annotated[float, Field(title="worst gain to 8 Hz", form="+.2f dB")]
    phase: Annotated[float, Field(title="worst phase", form="+.1f deg")]
    pressure: Annotated[float, Field(title="pressures missed", form=".2%")]

    @property
    def close(self) -> bool:
        """Whether it is as close as asked."""
        return abs(self.gain) <= WITHIN_DB and abs(self.phase) <= WITHIN_DEG


def predicted(posterior: Posterior) -> list[Prediction]:
    """The recordings held back, simulated on the fitted machine."""
    model, found = Model(posterior.campaign, held_back=True), []
    machine = model.machine(posterior.z)
    for one in model.pieces:
        simulated = model.simulated(one, posterior.z, machine)
        if posterior.campaign.settings.clocks:  # nor has the fit seen how far these are apart
            apart = _ratio(one.measured["leg_position"], simulated["leg_position"], one.rate)
            simulated = model.simulated(one, posterior.z, machine, late=_late(*apart))
        measured = {name: value[one.first :] for name, value in one.measured.items()}
        simulated = {name: value[one.first :] for name, value in simulated.items()}
        _, ratio = _ratio(measured["leg_position"], simulated["leg_position"], one.rate)
        both = 20.0 * np.log10(np.abs(ratio)), np.degrees(np.angle(ratio))
        gain, phase = (float(part[np.abs(part).argmax()]) for part in both)
        shares = [
            np.std(measured[c] - value - (measured[c] - value).mean(axis=0)) / np.std(measured[c])
            for c, value in simulated.items()
            if c != "leg_position"
        ]
        found.append(Prediction(one.name, gain, phase, float(max(shares, default=0.0))))
    return found


def _ratio(measured: Array, simulated: Array, rate: float) -> tuple[Array, NDArray[np.complex128]]:
    """Frequencies [Hz] up to `TO`, and measured over simulated histories at them."""
    length = min(int(4.0 * rate), measured.shape[0])
    how: dict[str, Any] = {"fs": rate, "nperseg": length, "axis": 0}
    frequency, cross = signal.csd(simulated, measured, **how)
    power = signal.welch(simulated, **how)[1].sum(axis=1)
    chosen = (frequency > 0.0) & (frequency <= TO)
    chosen &= power > _POWER * power[chosen].max()
    return frequency[chosen], cross.sum(axis=1)[chosen] / power[chosen]


def _late(frequency: Array, ratio: NDArray[np.complex128]) -> float:
    """Offset of the clocks [s] that a phase in proportion to frequency shows."""
    return float(frequency @ np.angle(ratio) / (2.0 * np.pi * frequency @ frequency))


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
    unstable: Annotated[float, Field(form=".0f %", unit="%")]
    """Share of these machines whose linear loop is unstable."""

    @property
    def close(self) -> bool:
        """Whether the fitted machine has it within two deviations."""
        return abs(self.off) <= FAR


def stated(posterior: Posterior, jobs: int = 2, samples: int = _SAMPLES) -> list[Stated]:
    """All statements of a campaign beside what the fitted machine makes of them."""
    campaign, evidence = posterior.campaign, posterior.campaign.evidence
    if not evidence.statements:
        return []
    base, known = campaign.plant, campaign.unknowns
    held = Unknowns(campaign.settings.held).on(base)
    around = held.draw("latin_hypercube", samples, 0) if held else [{}] * samples
    shares = stats.norm.cdf(posterior.samples(samples))
    drawn = [known.at(one) | other for one, other in zip(shares, around, strict=True)]

    def made(values: Values) -> Found | None:
        try:
            return evidence.linear(values, evidence.unknowns.apply(values, base))
        except (InputError, RunError):
            return None

    machines = [one for one in on_threads(made, drawn, jobs) if one is not None]
    open_ = np.array([one.value for one in machines])
    unstable = 1.0 - np.mean([one.stable for one in machines], axis=0)
    best, machine = known.at(stats.norm.cdf(posterior.z)), posterior.applied(base)
    before = evidence.linear({}, base).value
    after = evidence.linear(best, machine).value
    if campaign.settings.simulated:
        after = evidence.simulated(best, machine, jobs)
    rows = []
    for i, one in enumerate(evidence.statements):
        there = open_[np.isfinite(open_[:, i]), i]
        ends = np.quantile(there, _ENDS) if there.size else (np.nan, np.nan)
        off = -one.excess(float(after[i])) if np.isfinite(after[i]) else np.nan
        role = "held back" if one.held_back else "fitted"
        numbers = (one.value, before[i], after[i], off, *ends, unstable[i])
        rows.append(Stated(one.evidence, one.what, role, *map(float, numbers)))
    return rows


class Doubt(NamedTuple):
    """All that speaks against a fit."""

    open: tuple[Weak, ...]
    twins: tuple[tuple[str, str], ...]
    left: tuple[Left, ...]
    predictions: tuple[Prediction, ...]
    effects: tuple[Effect, ...]
    stated: tuple[Stated, ...]

    @property
    def missed(self) -> list[Left]:
        """What is left that goes with the demand, the worst first."""
        found = [one for one in self.left if one.correlation > _CHANCE]
        return sorted(found, key=lambda one: -one.correlation)

    @property
    def explained(self) -> bool:
        """Whether nothing that was looked at speaks against the model."""
        helping = any(one.helps for one in self.effects)
        near = all(one.close for one in self.predictions) and all(x.close for x in self.stated)
        return near and not (self.missed or helping)

    def widened(self, posterior: Posterior) -> Posterior:
        """The numbers where it is open which of the effects that help the machine has, if any."""
        shifts = [one.shift for one in self.effects if one.helps]
        return posterior._replace(shifts=np.reshape(shifts, (-1, posterior.z.size)))

    def tables(self) -> list[Table]:
        """What the recordings leave open, residuals, predictions, effects; none of them empty."""
        found: list[Result[Any]] = [
            Result(self.open, fields_of(Weak), "What the recordings leave open"),
            Result(self.left, fields_of(Left), "What is left"),
            Result(self.predictions, fields_of(Prediction), "Recordings held back"),
            Result(self.effects, fields_of(Effect)[:2], "Effects that were tried"),
            Result(self.stated, fields_of(Stated), "What is stated"),
        ]
        return [one.table for one in found if len(one)]

    @property
    def verdict(self) -> str:
        """How far the fit may be trusted, in words."""
        lines = [f"{one} and {other} cannot be separated." for one, other in self.twins]
        what = "the recordings" if self.left else "what is stated"
        if self.explained:
            text = f"The model explains {what}: "
            text += "what is left does not go with the demand" if self.left else "all is close"
            text += ", no effect tried helps" if self.effects else ""
            if self.predictions:
                text += f", and {len(self.predictions)} held back are predicted within "
                text += f"{WITHIN_DB:g} dB and {WITHIN_DEG:g} deg to {TO:g} Hz"
            return "\n".join([*lines, f"{text}."])
        lines.append(f"The model does not explain {what}.")
        lines += [
            f"{one.recording}, {one.channel}: what is left goes with the demand, "
            f"{one.correlation:.1f} times the bound of chance, most at {one.worst_at:.1f} s."
            for one in self.missed[:3]
        ]
        lines += [
            f"{one.recording}: held back, predicted {one.gain:+.2f} dB and "
            f"{one.phase:+.1f} deg off."
            for one in self.predictions
            if not one.close
        ]
        lines += [
            f"{one.evidence}, {one.what}: {one.role}, stated {one.stated:.3g}, the fitted machine "
            f"has {number(one.fitted if np.isfinite(one.fitted) else 'none', '.3g')}."
            for one in self.stated
            if not one.close
        ]
        helping = ", ".join(one.name for one in self.effects if one.helps)
        if helping:
            lines.append(f"These effects would explain more, the most first: {helping}.")
        elif self.effects:
            lines.append("None of the effects tried helps: the model lacks another.")
        return "\n".join(lines)

    def page(self, numbers: Table) -> Callable[[Path], Path]:
        """What writes the page of the fit, its numbers first."""
        parts = ["# How far this fit may be trusted", self.verdict]
        parts += [f"## {one.title}\n\n{one.markdown()}" for one in (numbers, *self.tables())]
        return lambda path: write_text(path, "\n\n".join(parts) + "\n")


@one_library_thread()
def doubt(posterior: Posterior, jobs: int = 2, *, effects: bool = True) -> Doubt:
    """Look for what speaks against a fit; with further `effects` where they are to be tried."""
    fitter = Fitter(posterior.campaign, "whole", jobs)
    rest = tuple(left(posterior, fitter)), tuple(predicted(posterior))
    more = tuple(tried(posterior.linearised, fitter)) if effects else ()
    numbers = tuple(stated(posterior, jobs))
    return Doubt(tuple(weak(posterior)), posterior.twins, *rest, more, numbers)
