"""Structured singular value: an upper bound for real parameters, by intervals of frequency.

A loop with parameters off by delta_i, each of which enters `sizes[i]` times in a row, is

    x' = A x + B w,    z = C x + D w,    w = diag(delta_i 1) z,    M(s) = C (s - A)^-1 B + D

No delta with |delta_i| < 1 / beta puts a pole at s if matrices X > 0 and Y = Y* that commute with
diag(delta_i 1) are found with (M. Fan, A. Tits and J. Doyle, IEEE Trans. Automatic Control 36
(1991) 25-38)

    Phi(s) = M* X M + j (Y M - M* Y) - beta^2 X < 0

One pair X, Y serves a whole interval of frequencies. On s = j w e^(j turn) det Phi has its zeros at
the imaginary eigenvalues of a Hamiltonian matrix; between two of them Phi keeps its sign. Intervals
are covered one after the other (C. Roos and J.-M. Biannic, IET Control Theory and Applications 4
(2010) 2447-2462). A gap is left: the frequency at which two intervals meet is not examined, so that
the limit of a parameter which acts at that frequency alone is missed. With `turn` = asin(zeta) the
ray is where poles have the damping ratio zeta: as long as none gets there all have more.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize

Matrix = NDArray[np.float64]
Complex = NDArray[np.complex128]

_LINES = 2.0 * np.pi * np.geomspace(0.05, 200.0, 25)
"""Frequencies looked at first [rad/s]."""
_LEAST = 0.05
"""Beta that nobody asks to improve."""
_SLACK = 1.01
"""Beta over the largest found at a line."""
_NARROW = 1.001
"""End over begin of an interval below which beta is raised, to get on."""
_NEAR = 1e-2
"""Real part over modulus up to which an eigenvalue is tried as an imaginary one."""
_SHARPNESS = (20.0, 60.0, 200.0)
"""Of the smooth maximum of eigenvalues that is minimised, round by round."""


_OPTIONS = {"maxiter": 100, "maxcor": 20}


class Uncertain(NamedTuple):
    """A stable loop with real parameters."""

    a: Matrix  #: (n, n).
    b: Matrix  #: From w, (n, k).
    c: Matrix  #: To z, (k, n).
    d: Matrix  #: (k, k).
    sizes: tuple[int, ...]  #: How often each parameter enters; sum k.


class Scaling(NamedTuple):
    """X = T* T and Y = T* S T of one frequency."""

    beta: float
    t: Complex
    s: Complex


def point_bound(
    m: Complex, sizes: tuple[int, ...], start: Scaling | None = None, enough: float = 0.0
) -> Scaling:
    """The least beta found for a matrix (k, k), and what proves it; stops below `enough`."""
    pattern = linalg.block_diag(*(np.ones((size, size)) for size in sizes)) > 0.0
    upper, plain = np.triu(pattern), m
    rows, count = np.nonzero(upper), int(upper.sum())

    def unpack(values: Matrix) -> tuple[Complex, Complex]:
        parts = values.reshape(4, count)
        t, s = np.zeros(m.shape, dtype=complex), np.zeros(m.shape, dtype=complex)
        t[rows] = parts[0] + 1j * parts[1]
        s[rows] = parts[2] + 1j * parts[3]
        return t, s + s.conj().T

    def cost(values: Matrix, m: Complex, scale: float) -> tuple[float, Matrix]:
        t, s = unpack(values)
        inverse = linalg.solve_triangular(t, np.eye(len(t)), check_finite=False)
        scaled = t @ m @ inverse
        cross = 1j * s @ scaled
        size, vector = np.linalg.eigh(scaled.conj().T @ scaled + cross + cross.conj().T)
        weight = np.exp(scale * (size - size[-1]))
        value = float(size[-1] + np.log(weight.sum()) / scale)
        density = (vector * (weight / weight.sum())) @ vector.conj().T
        pull = density @ (scaled.conj().T + 1j * s)
        on_t = 2.0 * (inverse @ (scaled @ pull - pull @ scaled)).conj().T[rows]
        turned = 1j * scaled @ density
        on_s = 2.0 * (turned + turned.conj().T)[rows]
        return value, np.concatenate([on_t.real, on_t.imag, on_s.real, on_s.imag])

    def stop(intermediate_result: optimize.OptimizeResult) -> None:
        if intermediate_result.fun < enough**2:
            raise StopIteration

    half, base = np.where(rows[0] == rows[1], 0.5, 1.0), np.eye(len(m), dtype=complex)
    t, s = (base, np.zeros_like(base)) if start is None else (start.t, start.s)
    if start is None:
        balance = linalg.matrix_balance(np.abs(m) + 1e-12, permute=False, separate=True)[1][0]
        t = np.diag(1.0 / balance).astype(complex)
    for sharpness in _SHARPNESS:
        base = t @ base
        base /= np.abs(np.diag(base)).max()
        given = base @ plain @ np.linalg.inv(base)
        t = np.eye(len(m), dtype=complex)
        size = max(abs(largest(given, Scaling(0.0, t, s))), 1e-9)
        begun = t[rows], half * s[rows]
        values = np.concatenate([part for one in begun for part in (one.real, one.imag)])
        how = {"method": "L-BFGS-B", "callback": stop, "options": _OPTIONS}
        values = optimize.minimize(cost, values, (given, sharpness / size), jac=True, **how).x
        t, s = unpack(values)
        if largest(given, Scaling(0.0, t, s)) < enough**2:
            break
    found = Scaling(0.0, t @ base, s)
    return found._replace(beta=float(np.sqrt(max(largest(plain, found), 0.0))))


def largest(m: Complex, scaling: Scaling) -> float:
    """The largest eigenvalue of Phi at beta = 0 over X."""
    scaled = scaling.t @ m @ np.linalg.inv(scaling.t)
    cross = 1j * scaling.s @ scaled
    return float(np.linalg.eigvalsh(scaled.conj().T @ scaled + cross + cross.conj().T)[-1])


def peak_bound(loop: Uncertain, turn: float = 0.0, least: float = 0.0) -> float:
    """The bound, but for the gap above, on s = j w e^(j turn), or `least` where that is more.

    No parameters with |delta| < 1 / beta bring a pole to the ray. At `turn` 0 none of A may be on
    its right, else none of A above the real axis.

    >>> from cmf_mj.analysis.linear.structured import Uncertain, peak_bound
    >>> a, b = np.array([[0.0, 1.0], [-1.0, -0.2]]), np.array([[0.0, 0.0], [-1.0, -1.0]])
    >>> c = np.array([[0.0, 0.1], [0.3, 0.0]])  # x'' + 0.2 (1 + 0.5 d1) x' + (1 + 0.3 d2) x = 0
    >>> loop = Uncertain(a, b, c, np.zeros((2, 2)), (1, 1))
    >>> 1.96 < 1.0 / peak_bound(loop) <= 2.0
    True
    """
    _, (scale, _) = linalg.matrix_balance(loop.a, permute=False, separate=True)
    a = loop.a / scale[:, None] * scale * np.exp(-1j * turn)
    b, c = loop.b / scale[:, None] * np.exp(-1j * turn), loop.c * scale
    one = np.eye(len(a))

    def response(omega: float) -> Complex:
        return np.asarray(c @ np.linalg.solve(1j * omega * one - a, b) + loop.d)

    def reach(omega: float, beta: float, scaling: Scaling) -> tuple[float, float]:
        """The interval about a frequency on which the scaling proves beta."""
        t, inverse = scaling.t, np.linalg.inv(scaling.t)
        bs, cs, ds = b @ inverse, t @ c, t @ loop.d @ inverse
        cross = 1j * scaling.s @ ds
        r = ds.conj().T @ ds + cross + cross.conj().T - beta**2 * np.eye(len(ds))
        q = cs.conj().T @ cs
        s = cs.conj().T @ ds - 1j * cs.conj().T @ scaling.s
        inside = np.linalg.solve(r, np.hstack([s.conj().T, bs.conj().T]))
        left, right = inside[:, : len(a)], inside[:, len(a) :]
        ham = np.block([[a - bs @ left, -bs @ right], [-q + s @ left, -(a - bs @ left).conj().T]])
        values = np.linalg.eigvals(ham)
        near = (np.abs(values.real) <= _NEAR * np.abs(values)) & (values.imag > 0.0)
        crossing = np.sort(values.imag[near])
        above = [omega, *crossing[crossing > omega], np.inf]
        below = [omega, *crossing[crossing <= omega][::-1], 0.0]
        ends = [omega, omega]
        for i, side in enumerate((below, above)):
            for near, far in pairwise(side):
                middle = 2.0 * near if np.isinf(far) else 0.5 * (near + far)
                if largest(response(middle), scaling) >= beta**2:
                    break
                ends[i] = far
        return ends[0], ends[1]

    known: dict[float, Scaling] = {}

    def at(omega: float, enough: float) -> Scaling:
        m = response(omega)
        starts = [known[min(known, key=lambda w: abs(np.log(w / omega)))]] if known else []
        for start in (*starts, None):
            found = point_bound(m, loop.sizes, start, enough)
            if omega not in known or found.beta < known[omega].beta:
                known[omega] = found
            if found.beta < enough:
                break
        return known[omega]

    beta, left = max(least, _LEAST), [(0.0, np.inf)]
    for omega in _LINES:
        beta = max(beta, _SLACK * at(omega, 0.9 * beta).beta)
    while left:
        low, high = left.pop()
        if high <= low * (1.0 + 1e-9):
            continue
        inside = [omega for omega in known if low < omega < high]
        far = min(high, 1e3 * max(low, 1.0))
        middle = float(np.sqrt(max(low, 1e-6 * far) * far))
        omega = max(inside, key=lambda w: known[w].beta) if inside else middle
        scaling = known[omega] if inside else at(omega, 0.9 * beta)
        beta = max(beta, _SLACK * scaling.beta)
        begin, end = reach(omega, beta, scaling)
        beta *= _SLACK if end < begin * _NARROW else 1.0
        left += [(low, begin), (end, high)]
    return beta
