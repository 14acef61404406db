"""Analogue inputs: codes against an independent count, noise of quantisation."""

import numpy as np
import pytest

from cmf_mj.control.feedback import LegFeedback
from cmf_mj.electronics.converter import (
    convert_all,
    convert_channel,
    converter_state,
    load_converters,
    make_converters,
)

INCH = 0.0254


def feedback(seed: int = 0) -> LegFeedback:
    rng = np.random.default_rng(seed)
    return LegFeedback(*(scale * rng.normal(size=4) for scale in (0.3, 0.2, 5.0, 4e6, 4e6)))


def blank() -> LegFeedback:
    return LegFeedback(*(np.zeros(4) for _ in range(5)))


def test_off_passes_bits_and_is_the_default() -> None:
    settings = load_converters()
    assert settings.name == "off"
    converters = make_converters(settings)
    analogue, digital = feedback(), blank()
    analogue.position[0] = -0.0
    convert_all(converters, converter_state(converters, analogue), analogue, digital)
    for one, two in zip(analogue, digital, strict=True):
        assert one.tobytes() == two.tobytes()


@pytest.mark.parametrize("bits", [8, 12, 16])
def test_readings_are_whole_codes_within_the_range(bits: int) -> None:
    """+-10 V over +-40 in: a code is 80 in / 2^bits; the upper end lacks one code."""
    settings = load_converters("sixteen_bit").model_copy(update={"bits": bits, "filter_order": 0})
    converter = make_converters(settings).position
    step = 80.0 * INCH / 2**bits
    values = np.linspace(-45.0, 45.0, 997) * INCH
    read = np.empty_like(values)
    convert_channel(converter, np.zeros((values.size, 0, 2)), values, read)
    codes = read / step
    np.testing.assert_allclose(codes, np.rint(codes), rtol=0.0, atol=1e-9)
    inside = np.abs(values) < 39.0 * INCH
    assert np.abs(read - values)[inside].max() <= step / 2 * (1 + 1e-9)
    assert read.min() == pytest.approx(-40.0 * INCH, rel=1e-12)
    assert read.max() == pytest.approx(40.0 * INCH - step, rel=1e-12)


def test_quantisation_error_is_uniform_noise_of_a_twelfth() -> None:
    """A busy signal leaves an error of variance step^2 / 12 (Widrow)."""
    settings = load_converters("sixteen_bit").model_copy(update={"bits": 10, "filter_order": 0})
    converter = make_converters(settings).velocity
    values = np.random.default_rng(3).normal(size=20000) * 0.2
    read = np.empty_like(values)
    convert_channel(converter, np.zeros((values.size, 0, 2)), values, read)
    assert np.var(read - values) == pytest.approx(converter.step**2 / 12, rel=0.03)


def test_the_filter_takes_in_place_and_starts_settled() -> None:
    converters = make_converters(load_converters("sixteen_bit"))
    analogue = feedback()
    state = converter_state(converters, analogue)
    for _ in range(5):
        same = LegFeedback(*(array.copy() for array in analogue))
        convert_all(converters, state, same, same)
        for name, read, true in zip(LegFeedback._fields, same, analogue, strict=True):
            step = getattr(converters, name).step
            assert np.abs(read - true).max() <= 0.5001 * step
