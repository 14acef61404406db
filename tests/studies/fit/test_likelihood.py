"""The likelihood of coloured residuals against closed forms."""

import numpy as np
import pytest
from scipy import signal

from cmf_mj.studies.fit.likelihood import autoregression, cost, information, spread

SPACING = {"a": 0.01, "b": 0.01, "c": 0.01, "d": 0.01}


def noise(colour: list[float], size: tuple[int, int], seed: int) -> np.ndarray:
    white = np.random.default_rng(seed).standard_normal(size)
    return np.asarray(signal.lfilter([1.0], colour, white, axis=0))


def test_colour_of_an_autoregression_is_found() -> None:
    """Within four standard errors, 1 / sqrt(samples) at most."""
    colour = [1.0, -1.2, 0.5]
    found = autoregression(noise(colour, (20000, 2), 1), 2)
    assert found == pytest.approx(colour, abs=4.0 / np.sqrt(40000))


def test_cost_of_white_noise_is_its_size() -> None:
    """-ln L = n ln(s), so that twice the noise costs n ln 2."""
    one = {("a", "x"): noise([1.0], (4000, 6), 2)}
    double = {key: 2.0 * value for key, value in one.items()}
    assert cost(double, 1) - cost(one, 1) == pytest.approx(23994.0 * np.log(2.0), rel=1e-9)


def line(names: str, truth: float, error: float, seed: int) -> tuple[dict, list[dict]]:
    """Residuals of a model b t at b = 0, `truth` being b, each leg with an error of its own."""
    time = np.linspace(-1.0, 1.0, 500)[:, None] * np.ones(6)
    residuals, slopes = {}, {}
    for number, name in enumerate(names):
        level = error * np.arange(6)
        disturbed = noise([1.0, -0.7], time.shape, 10 * seed + number)
        residuals[name, "x"] = truth * time + level + disturbed
        slopes[name, "x"] = -time
    return residuals, [slopes]


@pytest.mark.parametrize("error", [0.0, 100.0])
def test_a_slope_is_found_in_coloured_noise_whatever_the_sensors_errors(error: float) -> None:
    """Best linear estimate: sd = s / (1 - 0.7) / sqrt(sum t^2), of four recordings of six legs."""
    off = []
    for seed in range(40):
        residuals, slopes = line("abcd", 0.0, error, seed)
        found = information(residuals, slopes, 2, SPACING)
        off.append(np.linalg.solve(found.matrix, found.gradient)[0])
    time = np.linspace(-1.0, 1.0, 500)
    promised = 1.0 / (0.3 * np.sqrt(24.0 * (time**2).sum()))
    assert np.std(off) == pytest.approx(promised, rel=4.0 / np.sqrt(80.0))
    assert abs(np.mean(off)) < 4.0 * promised / np.sqrt(40.0)
    assert found.matrix[0, 0] ** -0.5 == pytest.approx(promised, rel=0.1)


def test_deviations_grow_with_what_differs_from_recording_to_recording() -> None:
    """Recordings whose slopes differ by 1 leave their mean open by 1 / sqrt(recordings)."""
    parts = [line(name, truth, 0.0, 3) for name, truth in zip("abcd", (-1, 1, -1, 1), strict=True)]
    residuals = {name: value for one, _ in parts for name, value in one.items()}
    slopes = [{name: value for _, one in parts for name, value in one[0].items()}]
    found = information(residuals, slopes, 2, SPACING)
    bare = found.matrix[0, 0] ** -0.5
    deviation = np.sqrt(spread(found, np.zeros(1))[0, 0])
    assert deviation == pytest.approx(1.0 / np.sqrt(3.0), rel=0.3)
    assert deviation > 5.0 * bare
