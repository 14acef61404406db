"""Frequency responses from sampled inputs and outputs: the arithmetic, without records.

All estimators weigh spectra X_k of the input and Y_k of the output over segments, periods or runs
k = 1..S. With S_xy = mean(conj(X_k) Y_k), and so on,

    H1 = S_xy / S_xx    H2 = S_yy / S_yx = H1 / c    Hv = H1 / sqrt(c)    report = (H1 + H2) / 2
    c = |S_xy|^2 / (S_xx S_yy)    (coherence)

H1 is free of bias under noise on the output, H2 under noise on the input, Hv under noise on both
in proportion to their power. The demand of a simulator is free of noise: H1.

The bound is the radius r of the circle in the complex plane that holds the true response with
95 % probability, for noise on the output that is Gaussian and flat across a line,

    r^2 = F(2, 2 n) var,    F = n (0.05^(-1/n) - 1),
    var = e^H R e / |X|^2 sum |Y_k - H X_k|^2 / (tr R - e^H R e),    e = X / |X|

where F is the 95 % point of Fisher's distribution, R the correlation between segments that share
samples, and n = (tr (I-P)R)^2 / tr ((I-P)R)^2 with P = e e^H (Satterthwaite) the averages left for
the noise. Without overlap R = I, n = S - 1, and this is the bound of Bendat and Piersol, Random
Data: r^2 = F / (S - 1) (1 - c) S_yy / S_xx. It covers random error only, neither the bias of H2, Hv
and report under output noise nor leakage. Frequencies in Hz, a response in the output's unit per
the input's.
"""

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

Estimator = Literal["h1", "h2", "hv", "report"]
Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
SEGMENT = 20.0
"""Length of Welch's segments [s]: lines every 0.05 Hz."""
CONFIDENCE = 0.95
"""Probability that the true response lies within the bound."""
DRIVEN = 1e-6
"""Amplitude over the largest one from which on a line of a periodic input counts as driven."""
NEIGHBOURS = 16
"""Lines about a sine from which its noise is taken."""


class Estimate(NamedTuple):
    """A frequency response with what is known about its error; arrays are read-only."""

    frequency: Real  #: Lines [Hz], (K,), ascending.
    response: Complex
    """Complex response, (K,), or (K, ny, nu) for a matrix; NaN where an input had no line."""
    coherence: Real
    """Share of the output's power that the inputs explain, 0 to 1, (K,), or (K, ny)."""
    radius: Real
    """Radius of the 95 % circle about `response`, its shape; infinite where nothing is known."""
    averages: Real
    """Effective number of independent averages behind the noise estimate, n + 1, (K,)."""

    @property
    def gain_db(self) -> Real:
        """Gain [dB], the response's shape."""
        return np.asarray(20.0 * np.log10(np.abs(self.response)))
