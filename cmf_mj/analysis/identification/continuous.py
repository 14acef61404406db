"""From discrete models to continuous ones.

What a discrete model means between the samples depends on its data. Series that were decimated are
band-limited: there the model's response on the unit circle is the continuous one,
G(j w) = G_d(e^(j w T)) within the excited band, and `to_continuous` finds the rational function of
s that has this response. Where the input was held between the samples, as the valve command is
between control frames at 2048 Hz, `from_zero_order_hold` inverts the hold exactly.
"""

import warnings

import control
import numpy as np
from scipy import linalg

from cmf_mj.analysis.identification.model import PolynomialModel
from cmf_mj.analysis.identification.response_fit import ResponseFit, fit_response
from cmf_mj.analysis.linear.transfer import UnitTransferFunction
from cmf_mj.core import units
from cmf_mj.core.errors import InputError

BAND = (0.1, 10.0)
"""Band in which a band-limited model is believed [Hz]: the report's of interest (section 4.2)."""

_LINES = 200

_LOST = 1e-8
"""Relative error of a matrix logarithm from which on it is refused."""


def to_continuous(
    model: PolynomialModel,
    row: int = 0,
    column: int = 0,
    *,
    band: tuple[float, float] = BAND,
    poles: int | None = None,
    zeros: int | None = None,
) -> ResponseFit:
    """Continuous transfer function with the response of a discrete model over a band.

    Args:
        model: identified from band-limited series.
        row: output.
        column: input.
        band: from and to [Hz], below half the model's rate.
        poles: default the discrete model's.
        zeros: default one less than poles.

    Returns:
        The fit, relative over 200 lines evenly spaced in log frequency; look at its `misfit`.

    Raises:
        InputError: a band or orders out of range.
    """
    low, high = band
    nyquist = 0.5 / model.step
    if not 0.0 < low < high < nyquist:
        raise InputError(f"band: {low} to {high} Hz; allowed: rising, above 0, below {nyquist} Hz")
    frequency = np.geomspace(low, high, _LINES)
    count = model.orders.na if poles is None else poles
    return fit_response(
        frequency,
        model.response(frequency)[:, row, column],
        count,
        count - 1 if zeros is None else zeros,
        input_name=model.input_names[column],
        output_name=model.output_names[row],
        input_unit=model.input_units[column],
        output_unit=model.output_units[row],
    )


def in_field_units(velocity: control.TransferFunction) -> UnitTransferFunction:
    """Leg velocity per command in in/s per %, of one in m/s per full command.

    Its output is named `leg_velocity`, as `linear.loop.closed_loop` wants it: a degree of freedom
    is closed with the law like a leg.
    """
    return UnitTransferFunction(
        units.from_si("in/s/%", velocity.num[0][0]),
        velocity.den[0][0],
        input_unit="%",
        output_unit="in/s",
        inputs=velocity.input_labels,
        outputs=["leg_velocity"],
        name=velocity.name,
    )


def from_zero_order_hold(model: control.StateSpace) -> control.StateSpace:
    """Continuous system whose zero-order hold at the model's step is the discrete model.

    [A B; 0 I] = expm([Ac Bc; 0 0] T), by the matrix logarithm.

    Raises:
        InputError: the model is continuous, or has a pole on the negative real axis or at 0, for
            which there is no such system of the same order.
    """
    step = model.dt
    if not step or step is True:
        raise InputError("model: has no sampling interval")
    a, b = np.asarray(model.A), np.asarray(model.B)
    poles = np.linalg.eigvals(a)
    bad = poles[(np.abs(poles.imag) < 1e-12) & (poles.real <= 0.0)]
    if bad.size:
        raise InputError(f"model: pole {bad[0].real:.4f} has no continuous counterpart")
    order, inputs = b.shape
    whole = np.block([[a, b], [np.zeros((inputs, order)), np.eye(inputs)]])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # it judges by a bound; we check
        log = np.real(linalg.logm(whole))
    lost = float(np.abs(linalg.expm(log) - whole).max() / np.abs(whole).max())
    if lost > _LOST:
        raise InputError(f"model: its hold cannot be inverted; the logarithm is off by {lost:.1e}")
    log = log / step
    return control.ss(
        log[:order, :order],
        log[:order, order:],
        model.C,
        model.D,
        inputs=model.input_labels,
        outputs=model.output_labels,
        name=model.name,
    )
