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
intervals cover all of 0 <= w <= infinity; negative w are their mirror images. Each counts for a
little less than its eigenvalues say, so that rounding opens no gap where two meet.

A real number may act at one frequency alone, such as the damper of an oscillator; towards it Y
grows and intervals shrink without end. So none may be narrower than `_NARROWEST` of the distance
from the nearest pole of A: there one pair X, Y is sought for three frequencies, and beta raised
until it serves between them. For modes damped by less than 1e-4 beta is too large, never too small.

With `turn` = asin(zeta) the ray is where poles have the damping ratio zeta: as long as none gets
there all have more. Where slow poles do not count the ray begins where it meets another, from
s = `ignored_below` at 45 degrees, and this one is swept instead up to there.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize

Matrix = NDArray[np.float64]
Complex = NDArray[np.complex128]

_SLACK = 1.01  #: Beta over the one found at a frequency.
_NARROWEST = 5e-4  #: Least half width of an interval over the distance from the nearest pole.
_MOST_INTERVALS = 400  #: After so many beta is raised with each, to come to an end.
_CERTAIN_SHARE = 0.999  #: How far an interval counts, over where its eigenvalue is.
_LARGEST_S = 1e6  #: Largest part of S, for the sake of rounding.
_NEAR_IMAGINARY = 1e-2  #: Real part over modulus up to which an eigenvalue is tried.
_SHARPNESS = (20.0, 60.0, 200.0)  #: Of the smooth maximum of eigenvalues, round by round.
_ENOUGH, _GOOD = 0.9, 0.97  #: Shares of beta at which a search ends, and does not begin again.
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


class _Variables:
    """T upper triangular and S Hermitian, in blocks of `sizes`, as the variables of a search."""

    def __init__(self, sizes: tuple[int, ...]) -> None:
        pattern = linalg.block_diag(*(np.ones((size, size)) for size in sizes)) > 0.0
        self.identity = np.eye(len(pattern), dtype=complex)
        self.entries = rows, columns = np.nonzero(np.triu(pattern))
        self.count = len(rows)
        self._share = np.where(rows == columns, 0.5, 1.0)  # of S, whose adjoint is added
        largest = np.repeat([np.inf, _LARGEST_S], 2 * self.count)
        self.bounds = optimize.Bounds(-largest, largest)

    def pack(self, t: Complex, s: Complex) -> Matrix:
        """The variables of T and S."""
        on_t, on_s = t[self.entries], self._share * s[self.entries]
        return np.concatenate([on_t.real, on_t.imag, on_s.real, on_s.imag])

    def unpack(self, values: Matrix) -> tuple[Complex, Complex]:
        """T and S of the variables."""
        t_real, t_imag, s_real, s_imag = values.reshape(4, self.count)
        t, s = np.zeros_like(self.identity), np.zeros_like(self.identity)
        t[self.entries] = t_real + 1j * t_imag
        s[self.entries] = s_real + 1j * s_imag
        return t, s + s.conj().T

    def cost(self, values: Matrix, m: Complex, sharpness: float) -> tuple[float, Matrix]:
        """Smooth maximum of the eigenvalues of Phi at beta = 0 over X, and its gradient."""
        t, s = self.unpack(values)
        inverse = linalg.solve_triangular(t, self.identity, check_finite=False)
        scaled = t @ m @ inverse
        eigenvalue, vector = _eigh(_phi_over_x(scaled, s))
        weight = np.exp(sharpness * (eigenvalue - eigenvalue.max()))
        value = float(eigenvalue.max() + np.log(weight.sum()) / sharpness)
        density = (vector * (weight / weight.sum())[:, None, :]) @ _adjoint(vector)
        pull = density @ (_adjoint(scaled) + 1j * s)
        by_t = 2.0 * _adjoint(inverse @ (scaled @ pull - pull @ scaled).sum(axis=0))[self.entries]
        product = (1j * scaled @ density).sum(axis=0)
        by_s = 2.0 * (product + _adjoint(product))[self.entries]
        return value, np.concatenate([by_t.real, by_t.imag, by_s.real, by_s.imag])


def point_bound(
    m: Complex, sizes: tuple[int, ...], start: Scaling | None = None, enough: float = 0.0
) -> Scaling:
    """The least beta found for one or all of m, (k, k) or (n, k, k); stops below `enough`."""
    variables = _Variables(sizes)
    base = identity = variables.identity
    m = m.reshape(-1, *identity.shape)
    t, s = _balanced(m) if start is None else (start.t, start.s)

    settings = {"jac": True, "method": "L-BFGS-B", "bounds": variables.bounds, "options": _OPTIONS}

    def stop(intermediate_result: optimize.OptimizeResult) -> None:  # SciPy looks for this name
        if intermediate_result.fun < enough**2:
            raise StopIteration

    for sharpness in _SHARPNESS:
        base = t @ base
        base /= np.abs(np.diag(base)).max()
        scaled, t = base @ m @ np.linalg.inv(base), identity
        size = max(abs(largest_eigenvalue(scaled, Scaling(0.0, t, s))), 1e-9)
        start_values, sharp = variables.pack(t, s), (scaled, sharpness / size)
        search = optimize.minimize(variables.cost, start_values, sharp, callback=stop, **settings)
        t, s = variables.unpack(search.x)
        if largest_eigenvalue(scaled, Scaling(0.0, t, s)) < enough**2:
            break
    scaling = Scaling(0.0, t @ base, s)
    return scaling._replace(beta=float(np.sqrt(max(largest_eigenvalue(m, scaling), 0.0))))


def _balanced(m: Complex) -> tuple[Complex, Complex]:
    """A first T, diagonal, that balances m (n, k, k), and the best S that is a number times 1."""
    identity = np.eye(m.shape[-1], dtype=complex)
    size = np.abs(m).max(axis=0) + 1e-12
    _, (balance, _) = linalg.matrix_balance(size, permute=False, separate=True)
    t = np.diag(1.0 / balance + 0j)
    scaled = t @ m @ np.linalg.inv(t)

    def eigenvalue(x: float) -> float:
        return largest_eigenvalue(scaled, Scaling(0.0, identity, np.sinh(x) * identity))

    bounds = np.arcsinh([-_LARGEST_S, _LARGEST_S]) - [-1.0, 1.0]
    search = optimize.minimize_scalar(eigenvalue, bounds=bounds, method="bounded")
    return t, np.sinh(search.x) * identity


def largest_eigenvalue(m: Complex, scaling: Scaling) -> float:
    """The largest eigenvalue of Phi at beta = 0 over X, of a matrix or of several."""
    scaled = scaling.t @ m @ np.linalg.inv(scaling.t)
    return float(np.linalg.eigvalsh(_phi_over_x(scaled, scaling.s)).max())


def peak_bound(
    loop: Uncertain, turn: float = 0.0, floor: float = 0.05, ignored_below: float = 0.0
) -> float:
    """The bound on s = j w e^(j turn), or `floor`, above 0, where that is more.

    No parameters with |delta| < 1 / beta bring a pole to the ray. At `turn` 0 no pole of A may be
    on its right, else none above the real axis; poles with Re + |Im| < `ignored_below` [rad/s] do
    not count. `turn` is below 45 degrees.

    >>> from cmf_mj.analysis.linear.structured import Uncertain, peak_bound
    >>> a, b = np.array([[0.0, 1.0], [-1.0, -0.2]]), np.array([[0.0, 0.0], [-1.0, -1.0]])
    >>> c = np.array([[0.0, 0.1], [0.3, 0.0]])  # x'' + 0.2 (1 + 0.5 d1) x' + (1 + 0.3 d2) x = 0
    >>> loop = Uncertain(a, b, c, np.zeros((2, 2)), (1, 1))
    >>> 1.96 < 1.0 / peak_bound(loop) <= 2.0
    True
    """
    corner = ignored_below / (np.cos(turn) - np.sin(turn))
    if ignored_below > 0.0:
        shifted = loop._replace(a=loop.a - ignored_below * np.eye(len(loop.a)))
        floor = _Ray(shifted, 0.25 * np.pi, floor).sweep(0.0, np.sqrt(2.0) * np.cos(turn) * corner)
    return _Ray(loop, turn, floor).sweep(corner, np.inf)


class _Ray:
    """The ray of a loop, its scalings by frequency, and the beta that they prove."""

    def __init__(self, loop: Uncertain, turn: float, beta: float) -> None:
        _, (scale, _) = linalg.matrix_balance(loop.a, permute=False, separate=True)
        self.loop, self.beta, self.scalings = loop, beta, dict[float, Scaling]()
        self.a = loop.a / scale[:, None] * scale * np.exp(-1j * turn)
        self.b, self.c = loop.b / scale[:, None] * np.exp(-1j * turn), loop.c * scale
        self.poles = np.linalg.eigvals(self.a)

    def sweep(self, low: float, high: float) -> float:
        """The beta that serves from one frequency to another."""
        if low == 0.0:
            width = self.half_width(0.0)
            _, low = self.raise_beta(0.0, 0.5 * width, width)
        if np.isinf(high):
            top = float(np.abs(self.poles).max()) / _NARROWEST
            high, _ = self.raise_beta(top, 2.0 * top, np.inf)
        gaps = [(low, high)]
        while gaps:
            low, high = gaps.pop()
            if high <= low:
                continue
            omega = float(np.sqrt(low * high))
            scaling = self.scalings[omega] = self.best_scaling(omega)
            growth = _SLACK if len(self.scalings) > _MOST_INTERVALS else 1.0
            self.beta = max(self.beta * growth, _SLACK * scaling.beta)
            begin, end = self.interval(omega, scaling._replace(beta=self.beta))
            width = self.half_width(omega)
            if min(omega - begin, end - omega) < width:
                begin, end = self.raise_beta(omega - width, omega, omega + width)
            gaps += [(low, begin), (end, high)]
        return self.beta

    def half_width(self, omega: float) -> float:
        return _NARROWEST * float(np.abs(1j * omega - self.poles).min())

    def response(self, *omegas: float) -> Complex:
        finite = np.array([0.0 if np.isinf(omega) else omega for omega in omegas])
        characteristic = 1j * finite[:, None, None] * np.eye(len(self.a)) - self.a
        dynamic = self.c @ np.linalg.solve(characteristic, self.b[None])
        return np.asarray(np.isfinite(omegas)[:, None, None] * dynamic + self.loop.d)

    def interval(self, omega: float, scaling: Scaling) -> tuple[float, float]:
        """The interval about a frequency on which the scaling proves its beta."""
        crossings = self._crossings(scaling)
        above = [omega, *crossings[crossings > omega], np.inf]
        below = [omega, *crossings[crossings <= omega][::-1], 0.0]
        return self._proven_end(omega, below, scaling), self._proven_end(omega, above, scaling)

    def _crossings(self, scaling: Scaling) -> Matrix:
        """Frequencies at which det Phi may be zero, ascending."""
        t, inverse, a = scaling.t, np.linalg.inv(scaling.t), self.a
        bs, cs, ds = self.b @ inverse, t @ self.c, t @ self.loop.d @ inverse
        r = _phi_over_x(ds, scaling.s) - scaling.beta**2 * np.eye(len(ds))
        s = cs.conj().T @ ds - 1j * cs.conj().T @ scaling.s
        solution = np.linalg.solve(r, np.hstack([s.conj().T, bs.conj().T]))
        by_s, by_b = solution[:, : len(a)], solution[:, len(a) :]
        closed = a - bs @ by_s
        lower = s @ by_s - cs.conj().T @ cs
        hamiltonian = np.block([[closed, -bs @ by_b], [lower, -closed.conj().T]])
        values = np.linalg.eigvals(hamiltonian)
        is_near = np.abs(values.real) <= _NEAR_IMAGINARY * np.abs(values)
        return np.sort(values.imag[is_near & (values.imag > 0.0)])

    def _proven_end(self, omega: float, steps: list[float], scaling: Scaling) -> float:
        """How far from a frequency the scaling proves its beta, of the steps to one side."""
        end = omega
        for near, far in pairwise(steps):
            certain = far if far in (0.0, np.inf) else omega + _CERTAIN_SHARE * (far - omega)
            middle = 2.0 * near if np.isinf(far) else 0.5 * (near + far)
            if largest_eigenvalue(self.response(middle, certain), scaling) > scaling.beta**2:
                break
            end = certain
        return end

    def best_scaling(self, omega: float, *omegas: float) -> Scaling:
        """Of one frequency or of several about it, from the nearest known and from none."""
        m, candidates = self.response(*(omegas or (omega,))), []
        neighbours = sorted(self.scalings, key=lambda w: abs(np.log(w / omega)))[:2]
        for start in (*(self.scalings[w] for w in neighbours), None):
            candidates.append(point_bound(m, self.loop.sizes, start, _ENOUGH * self.beta))
            if candidates[-1].beta < _GOOD * self.beta:
                break
        return min(candidates, key=lambda scaling: scaling.beta)

    def raise_beta(self, low: float, omega: float, high: float) -> tuple[float, float]:
        """Raise beta until one scaling serves from low to high; returns its interval."""
        scaling = self.best_scaling(omega, low, omega, high)
        self.beta = max(self.beta, _SLACK * scaling.beta)
        while True:
            begin, end = self.interval(omega, scaling._replace(beta=self.beta))
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
        values, vectors = zip(*(linalg.eigh(each, driver="ev") for each in m), strict=True)
        return np.array(values), np.array(vectors)


def _phi_over_x(m: Complex, s: Complex) -> Complex:
    """Phi at beta = 0 over X, of m = T M T^-1: m* m + j (S m - m* S)."""
    cross = 1j * s @ m
    return _adjoint(m) @ m + cross + _adjoint(cross)
