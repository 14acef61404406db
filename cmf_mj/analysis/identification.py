"""Black boxes of one input and one output from records: leg velocity from the valve command.

    records -> experiment -> arx -> BlackBox -> to_continuous          (chapter 4 of the report)

A box is y = B/A u, A = 1 + a_1 q^-1 + ... + a_na q^-na, B = b_1 q^-nk + ... with nb coefficients.
ARX minimises sum e^2 of A y = B u + e (Eq 4.10), linear in theta = (a, b):

    y = phi theta + e,   cov theta = s^2 (phi^T phi)^-1,   s^2 = |e|^2 / (N - p)

It is consistent where the noise enters so. Noise of a sensor enters as y = B/A u + v; past outputs
in phi then hold it, and poles are biased towards more damping.

Along a degree of freedom leg rates are mapped by J^-1, positions by `legs_to_pose`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import interpolate, signal, stats

from cmf_mj.analysis.frequency_response import FrequencyResponse, excited_response
from cmf_mj.analysis.linear.plants import UnitTransferFunction
from cmf_mj.core import units
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.kinematics import legs_to_pose
from cmf_mj.machine.leg_motion import leg_motion_to_pose
from cmf_mj.machine.machine import recorded_machine
from cmf_mj.record.record import Record

Real = NDArray[np.float64]

RATE = 64.0  #: Least rate of series [Hz]: far above what is excited all poles crowd at 1.
RECORDER = 128.0  #: Least rate of measured responses [Hz], the facility recorder's.
BAND = (0.1, 10.0)  #: Where a box is believed [Hz]: the report's band of interest (section 4.2).

_LEAST_SAMPLES = 32  #: Behind a decimation.
_ITERATIONS = 30  #: Rounds of the fit of a response.
_FITTED_SHARE = 0.6  #: Of a single run; the rest validates.
_BROAD_SIGNALS = ("multisine", "chirp", "noise")


@dataclass(frozen=True)
class Experiment:
    """One run as an input and an output."""

    input: Real  #: (N,).
    output: Real  #: (N,).
    step: float  #: Sampling interval [s].
    names: tuple[str, str] = ("input", "output")  #: Of input and output.
    reference: Real | None = None  #: What the law followed, (N,).

    def split(self, share: float) -> "list[Experiment]":
        """The first share of the run, and the rest."""
        row = round(share * self.input.size)
        return [self._part(slice(row)), self._part(slice(row, None))]

    def _part(self, rows: slice) -> "Experiment":
        reference = None if self.reference is None else self.reference[rows]
        return replace(self, input=self.input[rows], output=self.output[rows], reference=reference)


def _check_length(samples: int, factor: int) -> None:
    least = _LEAST_SAMPLES * factor
    if samples < least:
        raise InputError(f"record: {samples} samples; allowed: {least} or more")


def decimated(values: Real, factor: int) -> Real:
    """Series (N, ...) at a `factor` times lower rate, behind SciPy's zero-phase Chebyshev filter.

    In stages by the largest divisors up to 8, where the factor has any, each of which passes all to
    0.8 of the new Nyquist frequency within 0.1 dB.
    """
    _check_length(len(values), factor)
    while factor > 1:
        divisors = [q for q in range(2, 9) if factor % q == 0]
        stage = max(divisors, default=factor)
        values, factor = np.asarray(signal.decimate(values, stage, axis=0)), factor // stage
    return values


def experiment(record: Record, axis: str, rate: float = RATE) -> Experiment:
    """Valve command and leg velocity along a leg or degree of freedom, less their means.

    `axis` is surge to yaw, or leg_1 and so on. The series have the least rate from `rate` [Hz] on
    that divides the record's. Commands are fractions of full command (rotations: times rad/m),
    velocities in m/s or rad/s.

    A command c acts d frames late and is held over a frame. It jumps at the sampling instants; its
    band-limited value there lies halfway between c[k-d-1] and c[k-d], on a cubic spline, so that a
    box contains neither the frames of delay nor the hold.
    """
    factor, machine = max(1, int(record.rate // rate)), recorded_machine(record.metadata)
    _check_length(record.time.size, factor)
    command = decimated(_acting_commands(record, machine.rate), factor)
    velocity, reference, position = (
        decimated(record[f"leg_{name}"], factor) for name in ("velocity", "reference", "position")
    )
    legs = [f"leg_{leg + 1}" for leg in range(command.shape[1])]
    check_name("axis", axis, [*DOFS, *legs])
    if axis in DOFS:
        pose, zero = legs_to_pose(position, machine), np.zeros_like(position)
        command, velocity = (
            leg_motion_to_pose(pose, values, zero, machine).velocity
            for values in (command, velocity)
        )
        reference = legs_to_pose(reference, machine)
    column = (DOFS if axis in DOFS else legs).index(axis)
    u, y, followed = (
        signal.detrend(values[:, column], type="constant")
        for values in (command, velocity, reference)
    )
    names = (f"{axis}_command", f"{axis}_velocity")
    return Experiment(u, y, factor / record.rate, names, followed)


def _acting_commands(record: Record, control_rate: int) -> Real:
    """Valve commands, (N, n), as they act: behind the delay and half a frame of hold."""
    frames = int(record.metadata.get("command_delay", 1)) + 0.5
    row = np.arange(record.time.size, dtype=float)
    spline = interpolate.make_interp_spline(row, record["valve_command"])
    return np.asarray(spline(np.clip(row - frames * record.rate / control_rate, 0.0, None)))


def plant_response(record: Record, axis: str) -> FrequencyResponse:
    """Response from valve command to leg velocity in SI, (reference to one) over (to the other).

    No law's feedback biases it. The record is of a chirp, noise or multisine along the axis.
    """
    run = experiment(record, axis, RECORDER)
    if run.reference is None or np.ptp(run.reference) < 1e-9:
        raise InputError(f"axis: the record holds no demand in {axis}")
    to_input, to_output = (
        excited_response(run.reference, series, 1.0 / run.step, record.signal)
        for series in (run.input, run.output)
    )
    response = to_output.response / to_input.response
    relative_bounds = (fit.radius / np.abs(fit.response) for fit in (to_input, to_output))
    bound = sum(relative_bounds) * np.abs(response)
    coherence = np.minimum(to_input.coherence, to_output.coherence)
    return FrequencyResponse(response, 2.0 * np.pi * to_input.frequency, coherence, bound)


class Orders(NamedTuple):
    """Orders of a box."""

    na: int  #: Coefficients of A besides its leading 1, at least 1.
    nb: int  #: Coefficients of B, at least 1.
    nk: int = 1  #: Delay from input to output [samples], at least 0.

    @property
    def lag(self) -> int:
        """Samples before the first that the box can explain."""
        return max(self.na, self.nk + self.nb - 1)


class Pole(NamedTuple):
    """A pole of z, and what s = ln z / T says of it."""

    value: complex  #: z.
    hertz: float  #: |s| / 2 pi.
    error: float  #: Standard error of `hertz`, to first order.
    damping: float  #: -Re s / |s|.


@dataclass(frozen=True)
class BlackBox:
    """A discrete model B/A, and what is known of its error."""

    orders: Orders
    parameters: Real  #: a, then b, (p,).
    covariance: Real  #: (p, p).
    step: float  #: Sampling interval [s].
    names: tuple[str, str]  #: Of input and output.

    @property
    def denominator(self) -> Real:
        """A, (na + 1,), leading 1."""
        return np.concatenate([[1.0], self.parameters[: self.orders.na]])

    @property
    def numerator(self) -> Real:
        """B with its leading zeros, (nk + nb,)."""
        return np.concatenate([np.zeros(self.orders.nk), self.parameters[self.orders.na :]])

    @property
    def stable(self) -> bool:
        """Whether no pole lies outside the unit circle."""
        return bool(np.abs(np.roots(self.denominator)).max() <= 1.0)

    def poles(self) -> list[Pole]:
        """Poles with their standard errors; dp/da_i = -p^(na - i) / A'(p) for a simple one."""
        poles, a, na = [], self.denominator, self.orders.na
        for p in np.roots(a).astype(complex):
            s = np.log(p) / self.step
            slope = -np.vander([p], na)[0] / np.polyval(np.polyder(a), p)
            # |s| changes by the part of ds = dp / (p T) along s.
            hertz_slope = (np.conj(s) / abs(s) * slope / (p * self.step)).real / (2.0 * np.pi)
            error = float(np.sqrt(hertz_slope @ self.covariance[:na, :na] @ hertz_slope))
            poles.append(Pole(complex(p), abs(s) / (2.0 * np.pi), error, float(-s.real / abs(s))))
        return poles

    def response(self, frequency: ArrayLike) -> FrequencyResponse:
        """Frequency response at lines [Hz], (K,), with a circle of at least 95 % about each."""
        f = np.atleast_1d(np.asarray(frequency, dtype=float))
        (na, nb, nk), lag = self.orders, self.orders.lag
        delays = np.exp(-2j * np.pi * np.outer(f * self.step, np.arange(lag + 1)))
        denominator = delays[:, : na + 1] @ self.denominator
        g = delays[:, : nk + nb] @ self.numerator / denominator
        slope = np.hstack([-delays[:, 1 : na + 1] * g[:, None], delays[:, nk : nk + nb]])
        slope = slope / denominator[:, None]
        components = np.stack([slope.real, slope.imag], axis=1)
        variances = np.linalg.eigvalsh(components @ self.covariance @ components.transpose(0, 2, 1))
        bound = np.sqrt(stats.chi2.ppf(0.95, 2) * variances[:, -1])
        return FrequencyResponse(g, 2.0 * np.pi * f, np.ones(f.size), bound)


def _inverse(table: Real) -> Real:
    """Pseudo-inverse (p, N) of regressors or a Jacobian (N, p), refused if columns depend."""
    size = np.linalg.norm(table, axis=0)
    if not size.all():
        raise InputError("runs: an input or output is zero all the time")
    u, singular_values, v_transposed = np.linalg.svd(table / size, full_matrices=False)
    if singular_values[-1] < 1e-13 * singular_values[0]:
        raise InputError("orders: the runs do not tell these parameters apart; lower them")
    return np.asarray((v_transposed.T / singular_values) @ u.T / size[:, None])


def arx(runs: Sequence[Experiment], orders: Orders | tuple[int, int, int]) -> BlackBox:
    """Fit an ARX model to runs of the same signals and rate; poles outside the unit circle stay.

    Raises `InputError` for orders out of range, runs of several steps, too few samples or an input
    that does not excite the model.
    """
    orders = Orders(*orders)
    for name, least in (("na", 1), ("nb", 1), ("nk", 0)):
        if getattr(orders, name) < least:
            raise InputError(f"{name}: {getattr(orders, name)} must be at least {least}")
    steps = sorted({run.step for run in runs})
    if len(steps) != 1:
        raise InputError(f"runs: have steps of {steps} s; one or more of the same step are needed")
    samples, count = min(run.output.size for run in runs), orders.na + orders.nb
    if samples <= orders.lag + count:
        raise InputError(f"orders: {tuple(orders)} are too high for {samples} samples")
    phi = np.concatenate([_regressors(run, orders) for run in runs])
    y = np.concatenate([run.output[orders.lag :] for run in runs])
    inverse = _inverse(phi)
    theta = inverse @ y
    variance = float(np.sum((y - phi @ theta) ** 2)) / (y.size - count)
    covariance = variance * (inverse @ inverse.T)
    return BlackBox(orders, theta, covariance, runs[0].step, runs[0].names)


def _regressors(run: Experiment, orders: Orders) -> Real:
    """Rows -y[k-1] .. -y[k-na], u[k-nk] .. u[k-nk-nb+1] from sample `orders.lag` on."""
    (na, nb, nk), lag, end = orders, orders.lag, run.output.size
    past_outputs = [-run.output[lag - i : end - i] for i in range(1, na + 1)]
    past_inputs = [run.input[lag - i : end - i] for i in range(nk, nk + nb)]
    return np.column_stack(past_outputs + past_inputs)


def simulated(box: BlackBox, run: Experiment) -> Real:
    """Output (N,) of a stable box, driven by the input alone from the best initial state."""
    if not box.stable:
        raise InputError(f"orders: {tuple(box.orders)} make an unstable model; allowed: others")
    y = signal.lfilter(box.numerator, box.denominator, run.input)
    free = signal.lfilter([1.0], box.denominator, np.eye(box.orders.na, y.size)).T
    return np.asarray(y + free @ np.linalg.lstsq(free, run.output - y, rcond=None)[0])


def fit_percentage(measured: ArrayLike, modelled: ArrayLike) -> float:
    """100 (1 - |y - model| / |y - mean y|): 100 is perfect, 0 no better than the mean."""
    y = np.asarray(measured, dtype=float)
    spread = float(np.linalg.norm(y - y.mean()))
    if spread == 0.0:
        raise InputError("measured: the output does not move; a fit to it is not defined")
    return 100.0 * (1.0 - float(np.linalg.norm(y - modelled)) / spread)


class Continuous(NamedTuple):
    """A box as a transfer function of s."""

    velocity: UnitTransferFunction  #: Leg velocity per command [in/s per %], for `closed_loop`.
    misfit: float  #: Root of the mean of |H - H_k|^2 / |H_k|^2 over `BAND`.


def to_continuous(box: BlackBox) -> Continuous:
    """Fit N(s) / D(s) of one zero less than poles to the response of a box over `BAND`.

    Decimated series are band-limited, so that this response is the continuous one. Least squares of
    D H = N, repeated with the weight 1 / |D H| of the time before (C. Sanathanan and J. Koerner,
    IEEE Trans. Automatic Control 8 (1963) 56-58), need no start.
    """
    lowest, highest = BAND
    if not highest < 0.5 / box.step:
        raise InputError(f"step: {box.step} s; allowed: below {0.5 / highest} s")
    f, na = np.geomspace(*BAND, 200), box.orders.na
    h, scale = box.response(f).response, 2.0 * np.pi * float(np.sqrt(lowest * highest))
    powers = np.vander(2j * np.pi * f / scale, na + 1)
    regressors = np.hstack([powers[:, 1:], -h[:, None] * powers[:, 1:]])
    numerator, denominator = np.zeros(na), np.eye(1, na + 1)[0]
    for _ in range(_ITERATIONS):
        weight = 1.0 / np.abs(h * (powers @ denominator))
        rows, values = regressors * weight[:, None], h * powers[:, 0] * weight
        system, target = (np.concatenate([part.real, part.imag]) for part in (rows, values))
        norms = np.linalg.norm(system, axis=0)
        solution = np.linalg.lstsq(system / norms, target)[0] / norms
        numerator, denominator[1:] = np.split(solution, 2)
    deviation = (powers[:, 1:] @ numerator) / (powers @ denominator) / h - 1.0
    scales = scale ** np.arange(na + 1.0)
    numerator = units.from_si("in/s/%", numerator * scales[1:])
    denominator = denominator * scales
    names: dict[str, Any] = {"input_unit": "%", "output_unit": "in/s", "outputs": ["leg_velocity"]}
    velocity = UnitTransferFunction(numerator.tolist(), denominator.tolist(), **names)
    return Continuous(velocity, float(np.sqrt(np.mean(np.abs(deviation) ** 2))))


@dataclass(frozen=True)
class Identified:
    """A box of one axis with everything that judges it."""

    axis: str
    box: BlackBox
    estimation_fit: float  #: Of the simulated box to the fitted runs, the least [%].
    validation_fit: float  #: To the run that was not fitted [%].
    continuous: Continuous
    response: FrequencyResponse | None  #: Measured, of the last broad run; None without one.


def identify(
    records: Sequence[Record], axis: str, orders: tuple[int, int, int] = (4, 3, 1)
) -> Identified:
    """Identify leg velocity from valve command along an `axis`, surge to yaw or leg_1 and so on.

    The last record validates, the others are fitted jointly; of a single one the first 0.6 are
    fitted. `orders` are na, nb, nk, by default of a drive lag, an oil mode and its leakage.
    """
    if not records:
        raise InputError("records: none given; at least one is needed")
    runs = [experiment(record, axis) for record in records]
    *fitted, validation = runs if len(runs) > 1 else runs[0].split(_FITTED_SHARE)
    box = arx(fitted, orders)
    broad = [record for record in records if record.signal.kind in _BROAD_SIGNALS]
    estimation_fit = min(fit_percentage(run.output, simulated(box, run)) for run in fitted)
    validation_fit = fit_percentage(validation.output, simulated(box, validation))
    response = plant_response(broad[-1], axis) if broad else None
    return Identified(axis, box, estimation_fit, validation_fit, to_continuous(box), response)
