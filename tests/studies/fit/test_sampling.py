"""Weights of machines: effective sizes against what they are counted to be, and what is refused."""

import numpy as np
import pytest

from cmf_mj.core.errors import InputError
from cmf_mj.studies.fit import sampling


@pytest.mark.parametrize(
    ("log_weights", "count", "size"),
    [
        (np.linspace(0.0, -50.0, 100), 8.0, 8.0),
        (np.append(0.0, np.full(99, -1e9)), 8.0, 8.0),
        (np.append(np.linspace(0.0, -1e8, 50), np.full(50, -np.inf)), 8.0, 8.0),
        (np.array([0.0, -1.0, *[-np.inf] * 8]), 5.0, 2.0),
        (np.full(10, -3.0), 5.0, 10.0),
        (np.array([0.0, *[-np.inf] * 9]), 5.0, 1.0),
    ],
)
def test_tempered_weights_have_the_effective_size(
    log_weights: np.ndarray, count: float, size: float
) -> None:
    """Where so many machines are possible at all; the others stay impossible, the order stays."""
    weights = sampling.tempered(log_weights, count)
    assert weights.sum() == pytest.approx(1.0)
    assert sampling.effective_size(weights) == pytest.approx(size, rel=1e-6)
    assert (weights[np.isinf(log_weights)] == 0.0).all()
    assert (np.diff(weights[np.argsort(log_weights)]) >= 0.0).all()


@pytest.mark.parametrize("log_weights", [np.full(3, -np.inf), np.array([0.0, np.nan])])
def test_no_machine_that_fits_is_refused(log_weights: np.ndarray) -> None:
    with pytest.raises(InputError, match="no machine fits"):
        sampling.normalised(log_weights)


@pytest.mark.parametrize(("count", "rounds"), [(8, 0), (12, 2)])
def test_rounds_that_cannot_be_drawn_are_refused(count: int, rounds: int) -> None:
    with pytest.raises(InputError, match="allowed: at least 1"):
        sampling.importance(lambda _, points: np.zeros(len(points)), 2, count, rounds, 1)


def test_the_last_draw_is_a_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rounded sums of weights may stay below the last point; impossible machines are not drawn."""

    class Late:
        def random(self) -> float:
            return 1.0 - 1e-16

    monkeypatch.setattr(np.random, "default_rng", lambda _: Late())
    weights = np.append(np.full(10, 0.1 - 1e-10), 0.0)
    assert sampling.resampled(weights, 10**6, 0).max() == 9
