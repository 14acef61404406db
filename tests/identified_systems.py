"""Known systems and noisy experiments on them, shared by the identification tests."""

from typing import Any

import control
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import signal

from cmf_mj.analysis.identification import Experiment
from cmf_mj.record.record import Record
from cmf_mj.signals import multisine
from cmf_mj.studies.case import Case

RATE = 64.0


def excited(case: Case) -> list[Record]:
    """A run to fit and one to validate: multisines of the case's size up to 16 Hz."""
    how: dict[str, Any] = {"stop": 16.0, "spectrum": "acceleration", "fade": 1.0}
    return [case.run(multisine(case.dof, case.size, seed=seed, **how)) for seed in (0, 1)]


def pair(frequency: float, damping: float) -> control.TransferFunction:
    """A second-order mode of unit static gain [Hz]."""
    w = 2.0 * np.pi * frequency
    return control.tf([w * w], [1.0, 2.0 * damping * w, w * w])


def lag(frequency: float) -> control.TransferFunction:
    w = 2.0 * np.pi * frequency
    return control.tf([w], [1.0, w])


def sampled(system: control.TransferFunction) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """B and A in powers of the delay, of the zero-order hold at `RATE`; B[0] = 0."""
    discrete = control.tf(control.sample_system(control.ss(system), 1.0 / RATE, method="zoh"))
    a = np.asarray(discrete.den[0][0])
    b = np.asarray(discrete.num[0][0])
    return np.concatenate([np.zeros(a.size - b.size), b]) / a[0], a / a[0]


SIXTH = lag(3.0) * lag(12.0) * pair(5.0, 0.13) * pair(11.0, 0.11)
"""Two lags and two modes, like surge of the hexapod."""


def driven(seed: int, samples: int) -> NDArray[np.float64]:
    return np.random.default_rng([seed, 1]).standard_normal(samples)


def series(u: ArrayLike, y: ArrayLike) -> Experiment:
    """An input u [1] and an output y [m/s]."""
    return Experiment(np.asarray(u, dtype=float), np.asarray(y, dtype=float), 1.0 / RATE)


def noisy(
    system: control.TransferFunction,
    seed: int,
    *,
    samples: int = 4000,
    noise: float = 0.05,
    where: str = "output",
) -> Experiment:
    """White input, white noise of a share of the output's rms, on the output or the equation."""
    b, a = sampled(system)
    u = driven(seed, samples)
    y = signal.lfilter(b, a, u)
    e = noise * float(np.std(y)) * np.random.default_rng([seed, 2]).standard_normal(samples)
    if where == "equation":
        coloured = signal.lfilter([1.0], a, e)
        e = coloured * noise * float(np.std(y)) / float(np.std(coloured))
    return series(u, y + e)
