"""Structured singular value: an upper bound for real parameters, over all frequencies.

A loop with parameters off by delta_i, each of which enters `sizes[i]` times in a row, is

    x' = A x + B w,    z = C x + D w,    w = diag(delta_i 1) z,    M(s) = C (s - A)^-1 B + D

No delta with |delta_i| < 1 / beta puts a pole at s if matrices X > 0 and Y = Y* that commute with
diag(delta_i 1) are found with (M. Fan, A. Tits and J. Doyle, IEEE Trans. Automatic Control 36
(1991) 25-38)

    Phi(s) = M* X M + j (Y M - M* Y) - beta^2 X <= 0

One pair X, Y serves a closed interval of frequencies: on s = j w e^(j turn) det Phi has its zeros
at imaginary eigenvalues of a Hamiltonian matrix, and between two of them Phi keeps its sign (C.
Roos and J.-M. Biannic, IET Control Theory and Applications 4 (2010) 2447-2462). Work ends when such
intervals cover all of 0 <= w <= infinity, both ends included; negative w are their mirror images.
So nothing is left between two. Each counts for a little less than its eigenvalues say, so that
rounding opens no gap where two meet.

A real number may act at one frequency alone, the damper of an oscillator for one; towards it Y
grows and intervals shrink without end. So none may be narrower than `_NARROW` of the distance from
the nearest pole of A, which keeps their number finite: there one pair X, Y is sought for three
frequencies so far apart, and beta raised until it serves what lies between, by what M changes
there. For modes damped by less than 1e-4 the search ends early: beta is too large, never too small.

With `turn` = asin(zeta) the ray is where poles have the damping ratio zeta: as long as none gets
there all have more. Where slow poles do not count the ray begins where it meets another, from
s = slow at 45 degrees, and this one is swept instead up to there.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize

Matrix = NDArray[np.float64]
Complex = NDArray[np.complex128]

_SLACK = 1.01  #: Beta over the one found at a frequency.
_NARROW = 5e-4  #: Least half width of an interval over the distance from the nearest pole.
_MANY = 400  #: Intervals after which beta is raised with each, to come to an end.
_SURE = 0.999  #: How far an interval counts, over where its eigenvalue is.
_MOST = 1e6  #: Largest part of S, for the sake of rounding.
_NEAR = 1e-2  #: Real part over modulus up to which an eigenvalue is tried as an imaginary one.
_SHARPNESS = (20.0, 60.0, 200.0)
"""Of the smooth maximum of eigenvalues that is minimised, round by round."""
_ENOUGH, _GOOD = 0.9, 0.97
"""Shares of beta below which a search ends, and below which it does not begin again."""
_OPTIONS = {"maxiter": 100, "maxcor": 20, "ftol": 1e-6}


class Uncertain(NamedTuple):
    """A stable loop with real parameters."""

    a: Matrix  #: (n, n).
    b: Matrix  #: From w, (n, k).
    c: Matrix  #: To z, (k, n).
    d: Matrix  #: (k, k).
    sizes: tuple[int, ...]  #: How often each parameter enters; sum k.


class Scaling(NamedTuple):
    """X = T* T and Y = T* S T."""

    beta: float
    t: Complex
    s: Complex


def point_bound(
    m: Complex, sizes: tuple[int, ...], start: Scaling | None = None, enough: float = 0.0
) -> Scaling:
    """The least beta found for one or all of m, (k, k) or (n, k, k); stops below `enough`."""
    pattern = linalg.block_diag(*(np.ones((size, size)) for size in sizes)) > 0.0
    m, entries = m.reshape(-1, *pattern.shape), np.nonzero(np.triu(pattern))
    count, identity = len(entries[0]), np.eye(len(pattern), dtype=complex)

    def unpack(values: Matrix) -> tuple[Complex, Complex]:
        parts = values.reshape(4, count)
        t, s = np.zeros_like(identity), np.zeros_like(identity)
        t[entries] = parts[0] + 1j * parts[1]
        s[entries] = parts[2] + 1j * parts[3]
        return t, s + s.conj().T

    def cost(values: Matrix, m: Complex, scale: float) -> tuple[float, Matrix]:
        t, s = unpack(values)
        inverse = linalg.solve_triangular(t, identity, check_finite=False)
        scaled = t @ m @ inverse
        eigenvalue, vector = _eigh(_gain(scaled, s))
        weight = np.exp(scale * (eigenvalue - eigenvalue.max()))
        value = float(eigenvalue.max() + np.log(weight.sum()) / scale)
        density = (vector * (weight / weight.sum())[:, None, :]) @ _adjoint(vector)
        pull = density @ (_adjoint(scaled) + 1j * s)
        on_t = 2.0 * _adjoint(inverse @ (scaled @ pull - pull @ scaled).sum(axis=0))[entries]
        turned = (1j * scaled @ density).sum(axis=0)
        on_s = 2.0 * (turned + _adjoint(turned))[entries]
        return value, np.concatenate([on_t.real, on_t.imag, on_s.real, on_s.imag])

    def stop(intermediate_result: optimize.OptimizeResult) -> None:  # SciPy looks for this name
        if intermediate_result.fun < enough**2:
            raise StopIteration

    half, base = np.where(entries[0] == entries[1], 0.5, 1.0), identity
    t, s = (identity, np.zeros_like(identity)) if start is None else (start.t, start.s)
    if start is None:
        size = np.abs(m).max(axis=0) + 1e-12
        t = np.diag(1.0 / linalg.matrix_balance(size, permute=False, separate=True)[1][0] + 0j)
        given, ends = t @ m @ np.linalg.inv(t), np.arcsinh([-_MOST, _MOST]) - [-1.0, 1.0]

        def plain(x: float) -> float:
            return largest(given, Scaling(0.0, identity, np.sinh(x) * identity))

        s = np.sinh(optimize.minimize_scalar(plain, bounds=ends, method="bounded").x) * identity
    for sharpness in _SHARPNESS:
        base = t @ base
        base /= np.abs(np.diag(base)).max()
        given, t = base @ m @ np.linalg.inv(base), identity
        size = max(abs(largest(given, Scaling(0.0, t, s))), 1e-9)
        begun = t[entries], half * s[entries]
        values = np.concatenate([part for matrix in begun for part in (matrix.real, matrix.imag)])
        most = optimize.Bounds(*(np.repeat([np.inf, _MOST], 2 * count) * end for end in (-1, 1)))
        how = {"method": "L-BFGS-B", "callback": stop, "bounds": most, "options": _OPTIONS}
        values = optimize.minimize(cost, values, (given, sharpness / size), jac=True, **how).x
        t, s = unpack(values)
        if largest(given, Scaling(0.0, t, s)) < enough**2:
            break
    found = Scaling(0.0, t @ base, s)
    return found._replace(beta=float(np.sqrt(max(largest(m, found), 0.0))))


def largest(m: Complex, scaling: Scaling) -> float:
    """The largest eigenvalue of Phi at beta = 0 over X, of a matrix or of several."""
    scaled = scaling.t @ m @ np.linalg.inv(scaling.t)
    return float(np.linalg.eigvalsh(_gain(scaled, scaling.s)).max())


def peak_bound(loop: Uncertain, turn: float = 0.0, least: float = 0.05, slow: float = 0.0) -> float:
    """The bound on s = j w e^(j turn), or `least`, above 0, where that is more.

    No parameters with |delta| < 1 / beta bring a pole to the ray. At `turn` 0 none of A may be on
    its right, else none of A above the real axis; but for those with Re + |Im| < `slow` [rad/s],
    which do not count. `turn` is below 45 degrees.

    >>> from cmf_mj.analysis.linear.structured import Uncertain, peak_bound
    >>> a, b = np.array([[0.0, 1.0], [-1.0, -0.2]]), np.array([[0.0, 0.0], [-1.0, -1.0]])
    >>> c = np.array([[0.0, 0.1], [0.3, 0.0]])  # x'' + 0.2 (1 + 0.5 d1) x' + (1 + 0.3 d2) x = 0
    >>> loop = Uncertain(a, b, c, np.zeros((2, 2)), (1, 1))
    >>> 1.96 < 1.0 / peak_bound(loop) <= 2.0
    True
    """
    meets = slow / (np.cos(turn) - np.sin(turn))
    if slow > 0.0:
        shifted = loop._replace(a=loop.a - slow * np.eye(len(loop.a)))
        least = _swept(
            _Cover(shifted, 0.25 * np.pi, least), 0.0, np.sqrt(2.0) * np.cos(turn) * meets
        )
    return _swept(_Cover(loop, turn, least), meets, np.inf)


def _swept(cover: "_Cover", low: float, high: float) -> float:
    """The beta of a ray from one frequency to another."""
    if low == 0.0:
        bottom = cover.width(0.0)
        low = cover.raised(0.0, 0.5 * bottom, bottom)[1]
    if np.isinf(high):
        top = float(np.abs(cover.poles).max()) / _NARROW
        high = cover.raised(top, 2.0 * top, np.inf)[0]
    left = [(low, high)]
    while left:
        low, high = left.pop()
        if high <= low:
            continue
        omega = float(np.sqrt(low * high))
        scaling = cover.known[omega] = cover.best(omega)
        grown = _SLACK if len(cover.known) > _MANY else 1.0
        cover.beta = max(cover.beta * grown, _SLACK * scaling.beta)
        begin, end = cover.reach(omega, scaling._replace(beta=cover.beta))
        if min(omega - begin, end - omega) < cover.width(omega):
            width = cover.width(omega)
            begin, end = cover.raised(omega - width, omega, omega + width)
        left += [(low, begin), (end, high)]
    return cover.beta


class _Cover:
    """The ray of a loop, its scalings by frequency, and the beta that they prove."""

    def __init__(self, loop: Uncertain, turn: float, least: float) -> None:
        _, (scale, _) = linalg.matrix_balance(loop.a, permute=False, separate=True)
        self.loop, self.beta, self.known = loop, least, dict[float, Scaling]()
        self.a = loop.a / scale[:, None] * scale * np.exp(-1j * turn)
        self.b, self.c = loop.b / scale[:, None] * np.exp(-1j * turn), loop.c * scale
        self.poles = np.linalg.eigvals(self.a)

    def width(self, omega: float) -> float:
        return _NARROW * float(np.abs(1j * omega - self.poles).min())

    def response(self, *omegas: float) -> Complex:
        finite = np.array([0.0 if np.isinf(omega) else omega for omega in omegas])
        inside = 1j * finite[:, None, None] * np.eye(len(self.a)) - self.a
        moves = self.c @ np.linalg.solve(inside, self.b[None])
        return np.asarray(np.isfinite(omegas)[:, None, None] * moves + self.loop.d)

    def reach(self, omega: float, scaling: Scaling) -> tuple[float, float]:
        """The interval about a frequency on which the scaling proves its beta."""
        t, inverse, a = scaling.t, np.linalg.inv(scaling.t), self.a
        bs, cs, ds = self.b @ inverse, t @ self.c, t @ self.loop.d @ inverse
        r = _gain(ds, scaling.s) - scaling.beta**2 * np.eye(len(ds))
        s = cs.conj().T @ ds - 1j * cs.conj().T @ scaling.s
        inside = np.linalg.solve(r, np.hstack([s.conj().T, bs.conj().T]))
        left, right = inside[:, : len(a)], inside[:, len(a) :]
        closed = a - bs @ left
        ham = np.block([[closed, -bs @ right], [s @ left - cs.conj().T @ cs, -closed.conj().T]])
        values = np.linalg.eigvals(ham)
        near = (np.abs(values.real) <= _NEAR * np.abs(values)) & (values.imag > 0.0)
        crossing = np.sort(values.imag[near])
        above = [omega, *crossing[crossing > omega], np.inf]
        below = [omega, *crossing[crossing <= omega][::-1], 0.0]
        ends = [omega, omega]
        for i, side in enumerate((below, above)):
            for start, far in pairwise(side):
                sure = far if far in (0.0, np.inf) else omega + _SURE * (far - omega)
                middle = 2.0 * start if np.isinf(far) else 0.5 * (start + far)
                if largest(self.response(middle, sure), scaling) > scaling.beta**2:
                    break
                ends[i] = sure
        return ends[0], ends[1]

    def best(self, omega: float, *omegas: float) -> Scaling:
        """Of one frequency or of several about it, from the nearest known and from none."""
        m, found = self.response(*(omegas or (omega,))), []
        others = sorted(self.known, key=lambda w: abs(np.log(w / omega)))
        for start in (*(self.known[w] for w in others[:2]), None):
            found.append(point_bound(m, self.loop.sizes, start, _ENOUGH * self.beta))
            if found[-1].beta < _GOOD * self.beta:
                break
        return min(found, key=lambda scaling: scaling.beta)

    def raised(self, low: float, omega: float, high: float) -> tuple[float, float]:
        """The interval after beta was raised until one scaling serves from low to high."""
        scaling = self.best(omega, low, omega, high)
        self.beta = max(self.beta, _SLACK * scaling.beta)
        while True:
            begin, end = self.reach(omega, scaling._replace(beta=self.beta))
            if begin <= low and high <= end:
                return begin, end
            self.beta *= _SLACK


def _adjoint(m: Complex) -> Complex:
    return m.conj().swapaxes(-1, -2)


def _eigh(m: Complex) -> tuple[Matrix, Complex]:
    """Eigenvalues and vectors of (n, k, k); by QR where divide and conquer does not converge."""
    try:
        return np.linalg.eigh(m)
    except np.linalg.LinAlgError:
        values, vectors = zip(*(linalg.eigh(one, driver="ev") for one in m), strict=True)
        return np.array(values), np.array(vectors)


def _gain(m: Complex, s: Complex) -> Complex:
    """M* M + j (S M - M* S)."""
    cross = 1j * s @ m
    return _adjoint(m) @ m + cross + _adjoint(cross)
