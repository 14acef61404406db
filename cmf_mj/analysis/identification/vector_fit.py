"""Poles of a frequency response by relaxed vector fitting.

    sigma(s) H(s) = c + sum_i r_i / (s - p_i),   sigma(s) = d + sum_i q_i / (s - p_i)

is linear in c, r, d, q for given p; the zeros of sigma are better poles. Repeated until they stand
still (Gustavsen and Semlyen, IEEE Trans. Power Delivery 14 (1999) 1052-1061), with the relaxed
condition mean(Re sigma) = 1 in place of d = 1 (Gustavsen, ibid. 21 (2006) 1587-1592). Poles in the
right half plane are reflected and counted.

It is our own: scikit-rf's works on the scattering parameters of network objects and takes neither
weights nor a delay.
"""

import numpy as np
from numpy.typing import ArrayLike

from cmf_mj.analysis.identification.data import Real
from cmf_mj.analysis.identification.model import Complex
from cmf_mj.core.errors import InputError

_SWEEPS = 30
"""Largest number of pole relocations."""


def vector_fit(
    frequency: ArrayLike, response: ArrayLike, poles: int, *, deviation: ArrayLike | None = None
) -> tuple[Complex, int]:
    """Poles [rad/s] of a rational function through a response, by relaxed vector fitting.

    Args:
        frequency: lines [Hz], (K,), above 0.
        response: complex, (K,).
        poles: how many.
        deviation: standard deviation of each line; default |response|.

    Returns:
        Poles in the left half plane, and how many the last sweep had to reflect into it.

    Raises:
        InputError: bad lines, or too few for so many poles.
    """
    f, h, sigma = checked_lines(frequency, response, deviation)
    if poles < 1 or f.size < poles + 1:
        raise InputError(f"poles: {poles}; allowed with {f.size} lines: 1 to {f.size - 1}")
    scale = 2.0 * np.pi * float(np.sqrt(f[0] * f[-1]))
    s: Complex = np.asarray(2j * np.pi * f / scale, dtype=np.complex128)
    found = _starting_poles(np.asarray(s.imag, dtype=float), poles)
    reflected = 0
    for _ in range(_SWEEPS):
        new = _relocated(s, h, 1.0 / sigma, found)
        reflected = int(np.count_nonzero(new.real > 0.0))
        new = np.where(new.real > 0.0, -new.conj(), new)
        moved = np.abs(np.sort_complex(new) - np.sort_complex(found)).max()
        found = new
        if moved < 1e-8 * np.abs(found).max():
            break
    return found * scale, reflected


def checked_lines(
    frequency: ArrayLike, response: ArrayLike, deviation: ArrayLike | None
) -> tuple[Real, Complex, Real]:
    """Lines [Hz], response and deviation as arrays (K,) that belong together.

    Raises:
        InputError: they do not, or a value is out of range.
    """
    f, h = np.asarray(frequency, dtype=float), np.asarray(response, dtype=complex)
    sigma = np.abs(h) if deviation is None else np.asarray(deviation, dtype=float)
    if f.ndim != 1 or not f.shape == h.shape == sigma.shape:
        raise InputError(f"frequency, response: {f.shape}, {h.shape}; must be one line of each")
    if f.size < 2 or not (np.isfinite(f).all() and f[0] > 0.0 and (np.diff(f) > 0.0).all()):
        raise InputError("frequency: must be finite, above 0 and rising")
    if not np.isfinite(h).all():
        raise InputError(f"response: is not finite at {f[~np.isfinite(h)][0]} Hz")
    if not (np.isfinite(sigma).all() and (sigma > 0.0).all()):
        raise InputError("deviation: must be finite and greater than 0 at every line")
    return f, h, sigma


def _starting_poles(omega: Real, count: int) -> Complex:
    """Lightly damped pairs spread over the band, and one real pole for an odd count."""
    at = np.geomspace(omega[0], omega[-1], count // 2)
    pairs = np.ravel(np.column_stack([at * (-0.01 + 1j), at * (-0.01 - 1j)]))
    real = [-np.sqrt(omega[0] * omega[-1])] if count % 2 else []
    return np.concatenate([pairs, real]).astype(complex)


def _fractions(s: Complex, poles: Complex) -> Complex:
    """Partial fractions with real coefficients, (K, n): pairs as 1/(s-p) + 1/(s-p*), j/(..) - .."""
    columns = []
    for p in poles[poles.imag >= 0.0]:
        if p.imag == 0.0:
            columns.append(1.0 / (s - p))
        else:
            columns.append(1.0 / (s - p) + 1.0 / (s - p.conj()))
            columns.append(1j / (s - p) - 1j / (s - p.conj()))
    return np.column_stack(columns)


def _relocated(s: Complex, h: Complex, weight: Real, poles: Complex) -> Complex:
    """One sweep: zeros of the relaxed sigma function, which are the next poles."""
    poles = _paired(poles)
    basis = _fractions(s, poles)
    count = basis.shape[1]
    ones = np.ones((s.size, 1))
    table = np.hstack([basis, ones, -h[:, None] * basis, -h[:, None] * ones]) * weight[:, None]
    real = np.vstack([table.real, table.imag])
    # Relaxation: the mean of Re sigma over the lines is 1, so that sigma = 0 is no solution.
    force = np.linalg.norm(weight * np.abs(h)) / s.size
    row = np.concatenate(
        [np.zeros(count + 1), np.sum(basis.real, axis=0) * force, [s.size * force]]
    )
    system = np.vstack([real, row])
    right = np.zeros(system.shape[0])
    right[-1] = s.size * force
    size = np.linalg.norm(system, axis=0)
    solution = np.linalg.lstsq(system / size, right, rcond=None)[0] / size
    residues, level = solution[count + 1 : -1], solution[-1]
    if abs(level) < 1e-8:
        level = 1e-8 if level >= 0.0 else -1e-8
    a, b = np.zeros((count, count)), np.zeros(count)
    i = 0
    for p in poles[poles.imag >= 0.0]:
        if p.imag == 0.0:
            a[i, i], b[i] = p.real, 1.0
            i += 1
        else:
            a[i : i + 2, i : i + 2] = [[p.real, p.imag], [-p.imag, p.real]]
            b[i] = 2.0
            i += 2
    return np.asarray(np.linalg.eigvals(a - np.outer(b, residues) / level), dtype=np.complex128)


def _paired(poles: Complex) -> Complex:
    """Poles as exact conjugate pairs and exactly real ones."""
    tiny = np.abs(poles.imag) <= 1e-12 * np.abs(poles)
    above = poles[~tiny & (poles.imag > 0.0)]
    return np.concatenate([poles[tiny].real.astype(complex), above, above.conj()])
