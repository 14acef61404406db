"""Low-pass filters: SciPy's filter, the analogue Butterworth filter, and rest."""

import numpy as np
import pytest
from scipy import signal

from cmf_mj.core.filters import filter_value, low_pass, settled_filter_state

RATE = 2048.0


def run(sections: np.ndarray, values: np.ndarray, state: np.ndarray) -> np.ndarray:
    return np.array([filter_value(sections, state, value) for value in values])


@pytest.mark.parametrize("order", [1, 2, 3, 4, 7])
def test_the_compiled_filter_is_scipys(order: int) -> None:
    sections = low_pass(order, 200.0, RATE)
    values = np.random.default_rng(order).normal(size=400)
    mine = run(sections, values, np.zeros((sections.shape[0], 2)))
    np.testing.assert_allclose(mine, signal.sosfilt(sections, values), rtol=0.0, atol=1e-13)


@pytest.mark.parametrize(("order", "corner"), [(1, 300.0), (2, 500.0), (4, 120.0)])
def test_gain_and_phase_are_the_analogue_filters_at_the_warped_frequency(
    order: int, corner: float
) -> None:
    frequency = np.array([1.0, 20.0, corner, 700.0])
    _, found = signal.sosfreqz(low_pass(order, corner, RATE), frequency, fs=RATE)
    warped = corner * np.tan(np.pi * frequency / RATE) / np.tan(np.pi * corner / RATE)
    b, a = signal.butter(order, 2 * np.pi * corner, analog=True)
    _, analogue = signal.freqs(b, a, 2 * np.pi * warped)
    np.testing.assert_allclose(found, analogue, rtol=1e-9)
    assert abs(found[2]) == pytest.approx(np.sqrt(0.5), rel=1e-9)  # warping leaves the corner


def test_a_settled_filter_stays_at_rest() -> None:
    sections = low_pass(3, 100.0, RATE)
    values = np.array([0.0, -2.5, 7e6])
    state = settled_filter_state(sections, values)
    for leg, value in enumerate(values):
        np.testing.assert_allclose(run(sections, np.full(50, value), state[leg]), value, rtol=1e-12)


def test_no_filter_passes_bits() -> None:
    sections = low_pass(0, 100.0, RATE)
    state = settled_filter_state(sections, np.zeros(1))
    for value in (0.1, -0.0, np.inf):
        assert np.float64(filter_value(sections, state[0], value)).tobytes() == (
            np.float64(value).tobytes()
        )


@pytest.mark.parametrize(
    ("order", "corner", "message"),
    [(-1, 10.0, "order: -1"), (1, 1024.0, "corner: 1024"), (2, 0.0, "corner: 0")],
)
def test_refusals(order: int, corner: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        low_pass(order, corner, RATE)
