"""The structured singular value against systems whose limits have closed forms."""

from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import optimize

from cmf_mj.analysis.linear.structured import (
    Scaling,
    Uncertain,
    largest_eigenvalue,
    peak_bound,
    point_bound,
)

DAMPER, SPRING, ON_DAMPER, ON_SPRING = 0.2, 1.0, 0.5, 0.3
AB13MD = 2.696866


def oscillator(damper: float = DAMPER, frequency: float = 1.0) -> Uncertain:
    """x'' + c (1 + 0.5 d1) x' + k (1 + 0.3 d2) x = 0, k = frequency squared."""
    spring = SPRING * frequency**2
    a = np.array([[0.0, 1.0], [-spring, -damper]])
    b = np.array([[0.0, 0.0], [-1.0, -1.0]])
    c = np.array([[0.0, ON_DAMPER * damper], [ON_SPRING * spring, 0.0]])
    return Uncertain(a, b, c, np.zeros((2, 2)), (1, 1))


def only(loop: Uncertain, one: int) -> Uncertain:
    """With one of its numbers uncertain."""
    kept = slice(one, one + 1)
    return Uncertain(loop.a, loop.b[:, kept], loop.c[kept], loop.d[kept, kept], (1,))


@pytest.mark.parametrize(
    ("damper", "frequency"), [(DAMPER, 1.0), (3e-2, 7.331), (3e-3, 7.331), (3e-4, 7.331)]
)
def test_oscillator_with_one_number_uncertain(damper: float, frequency: float) -> None:
    """The damper is gone at -2, at the natural frequency alone; the spring at -3.33, at rest alone.

    The lightest is 0.004 % wide.
    """
    loop = oscillator(damper, frequency)
    for one, exact in enumerate((1.0 / ON_DAMPER, 1.0 / ON_SPRING)):
        assert 0.98 * exact < 1.0 / peak_bound(only(loop, one)) <= exact


@pytest.mark.parametrize(("damper", "frequency"), [(DAMPER, 1.0), (3e-2, 7.331), (3e-3, 7.331)])
def test_oscillator_is_stable_until_its_damper_is_gone(damper: float, frequency: float) -> None:
    """At d1 = -2, whatever the spring: the spring would be gone at d2 = -3.3."""
    assert 0.98 * 2.0 < 1.0 / peak_bound(oscillator(damper, frequency)) <= 2.0


@pytest.mark.parametrize("speed", [1e-2, 1.0, 1e3])
def test_pole_at_rest(speed: float) -> None:
    """x' = speed (-1 + d) x is unstable from d = 1 on, at w = 0 alone."""
    one = np.ones((1, 1))
    loop = Uncertain(-speed * one, one, speed * one, 0.0 * one, (1,))
    assert 0.98 < 1.0 / peak_bound(loop) <= 1.0


@pytest.mark.parametrize("turn", [0.0, 0.1])
def test_slow_poles_do_not_count(turn: float) -> None:
    """x' = (-1 + d) x up to d = 1 + slow; a fast oscillator as without; a slow one until the larger
    of its real poles, those of s^2 + 0.02 (1 + 0.5 d1) s + 0.0025, is 0.3."""
    one = np.ones((1, 1))
    loop = Uncertain(-one, one, one, 0.0 * one, (1,))
    assert 0.98 * 1.3 < 1.0 / peak_bound(loop, turn, ignored_below=0.3) <= 1.3
    faster = oscillator(frequency=7.331)
    with_slow = peak_bound(faster, turn, ignored_below=0.3)
    assert with_slow == pytest.approx(peak_bound(faster, turn), rel=0.02)
    slower, edge = only(oscillator(0.02, 0.05), 0), 2.0 * (1.0 + (0.3 + 0.0025 / 0.3) / 0.02)
    assert 0.98 * edge < 1.0 / peak_bound(slower, turn, 0.01, 0.3) <= edge


def test_pole_that_runs_to_infinity() -> None:
    """(1 - 0.5 d) x' = -x has its pole at infinity for d = 2: w = 0.5 d x', z = x'."""
    one = np.ones((1, 1))
    loop = Uncertain(-one, 0.5 * one, -one, 0.5 * one, (1,))
    assert 0.98 * 2.0 < 1.0 / peak_bound(loop) <= 2.0


def test_damping_ratio_of_the_oscillator() -> None:
    """zeta = c (1 - 0.5 s) / (2 sqrt(k (1 + 0.3 s))) with the softest damper, stiffest spring."""
    wanted = 0.05

    def surplus(scale: float) -> float:
        spring = SPRING * (1.0 + ON_SPRING * scale)
        return DAMPER * (1.0 - ON_DAMPER * scale) / (2.0 * np.sqrt(spring)) - wanted

    exact = float(optimize.brentq(surplus, 0.0, 2.0))
    limit = 1.0 / peak_bound(oscillator(), float(np.arcsin(wanted)))
    assert 0.98 * exact < limit <= exact


def moved(loop: Uncertain, deltas: NDArray[np.float64]) -> NDArray[np.float64]:
    """A with parameters off by delta."""
    delta = np.diag(np.repeat(deltas, loop.sizes))
    inner = np.linalg.solve(np.eye(len(loop.d)) - delta @ loop.d, delta @ loop.c)
    return np.asarray(loop.a + loop.b @ inner)


def stable_loop(seed: int, size: int, sizes: tuple[int, ...]) -> Uncertain:
    """Random, with all poles at least 0.3 left of the imaginary axis."""
    generator, count = np.random.default_rng(seed), sum(sizes)
    a = generator.normal(size=(size, size))
    a -= (np.linalg.eigvals(a).real.max() + 0.3) * np.eye(size)
    b, c = generator.normal(size=(size, count)), generator.normal(size=(count, size))
    return Uncertain(a, b, c, 0.1 * generator.normal(size=(count, count)), sizes)


@pytest.mark.parametrize("seed", [1, 2])
def test_no_machine_within_the_bound_is_unstable(seed: int) -> None:
    """Corners and random points of the box."""
    loop = stable_loop(seed, 5, (1, 2, 1))
    limit = 0.9999 / peak_bound(loop)
    points = np.random.default_rng(seed).uniform(-1.0, 1.0, (500, 3))
    for point in [*points, *np.sign(points)]:
        assert np.linalg.eigvals(moved(loop, limit * point)).real.max() < 0.0


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_bound_is_near_the_first_corner_that_fails(seed: int) -> None:
    """Where a grid does not: on 40 frequencies the largest bound for seed 4 is 0.68 of this."""
    loop = stable_loop(seed, 6, (1, 1, 1, 1))

    def growth(scale: float, corner: NDArray[np.float64]) -> float:
        return float(np.linalg.eigvals(moved(loop, scale * corner)).real.max())

    limit = 1.0 / peak_bound(loop)
    scales, corners = limit * np.linspace(0.9, 1.1, 101), product((-1.0, 1.0), repeat=4)
    fails = [s for c in corners for s in scales if growth(s, np.array(c)) > 0.0]
    assert limit <= min(fails) < 1.03 * limit


def test_bound_where_divide_and_conquer_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    """LAPACK's zheevd gives up on some matrices that its zheev takes."""
    generator = np.random.default_rng(7)
    m = generator.normal(size=(4, 4)) + 1j * generator.normal(size=(4, 4))
    expected = point_bound(m, (2, 1, 1)).beta

    def fails(_: NDArray[np.complex128]) -> None:
        raise np.linalg.LinAlgError

    monkeypatch.setattr(np.linalg, "eigh", fails)
    assert point_bound(m, (2, 1, 1)).beta == pytest.approx(expected, rel=1e-6)


def test_matrix_of_ab13md() -> None:
    """An independent bound for single real numbers, SLICOT's AB13MD (slycot 0.7.1), of a matrix."""
    i, k = np.indices((5, 5))
    m = np.cos(1.0 + i + 2.0 * k * i) + 1j * np.sin(2.0 + 3.0 * i - k)
    assert point_bound(m, (1,) * 5).beta == pytest.approx(AB13MD, rel=0.005)


def test_closed_forms_of_matrices() -> None:
    """One repeated real number: the largest real eigenvalue, 0 where none is real."""
    generator = np.random.default_rng(3)
    m = generator.normal(size=(8, 8)) + 1j * generator.normal(size=(8, 8))
    hermitian = m + m.conj().T
    exact = float(np.abs(np.linalg.eigvalsh(hermitian)).max())
    assert point_bound(hermitian, (8,)).beta == pytest.approx(exact, rel=1e-4)
    assert point_bound(m, (8,)).beta < 1e-2 * np.abs(np.linalg.eigvals(m)).min()
    assert point_bound(1j * np.eye(3), (1, 1, 1)).beta < 1e-2


def test_repeated_is_at_most_free_is_at_most_complex() -> None:
    """Fewer machines, a smaller bound; Y = 0 is that of complex parameters."""
    generator = np.random.default_rng(4)
    m = generator.normal(size=(6, 6)) + 1j * generator.normal(size=(6, 6))
    together, alone = point_bound(m, (3, 3)), point_bound(m, (1,) * 6)
    one = np.eye(6, dtype=complex)
    norm = np.sqrt(largest_eigenvalue(m, Scaling(0.0, one, 0.0 * one)))
    assert norm == pytest.approx(np.linalg.norm(m, 2))
    assert together.beta <= alone.beta * 1.01 <= norm * 1.01
