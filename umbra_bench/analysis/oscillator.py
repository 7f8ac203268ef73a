"""The linear oscillator x'' = -omega^2 x, where one step of every method is a matrix.

Written from the methods' definitions in the books and in the devlog, and from nothing of the code
that is measured: what runs must agree with it. The matrices act on (q, v) with q = omega x, and for
UMBRA's pipelines on (q, v, b) with b = a/omega, the stored acceleration; w stands for omega dt.

Source: Hairer, Lubich, Wanner, Geometric Numerical Integration, I.1 and II.1; the devlog's formulas.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

_CUBE_ROOT = 2.0 ** (1.0 / 3.0)
YOSHIDA = (1 / (2 - _CUBE_ROOT), -_CUBE_ROOT / (2 - _CUBE_ROOT), 1 / (2 - _CUBE_ROOT))
"""The fractions of a step that Yoshida's fourth-order method composes. Source: Yoshida 1990."""


def _drift(w: float) -> np.ndarray:
    return np.array([[1.0, w], [0.0, 1.0]])


def _kick(w: float) -> np.ndarray:
    return np.array([[1.0, 0.0], [-w, 1.0]])


def _explicit_euler(w: float) -> np.ndarray:
    return np.array([[1.0, w], [-w, 1.0]])


def _semi_implicit_euler(w: float) -> np.ndarray:
    return _drift(w) @ _kick(w)


def _velocity_verlet(w: float) -> np.ndarray:
    return _kick(w / 2) @ _drift(w) @ _kick(w / 2)


def _rk4(w: float) -> np.ndarray:
    turn = np.array([[0.0, w], [-w, 0.0]])
    powers = (np.linalg.matrix_power(turn, k) / math.factorial(k) for k in range(5))
    return np.sum(list(powers), axis=0)


def _yoshida4(w: float) -> np.ndarray:
    outer, middle, _ = (_velocity_verlet(fraction * w) for fraction in YOSHIDA)
    return outer @ middle @ outer


def _umbra(w: float) -> np.ndarray:
    """b' = -q; v' = v + (b + b') w/2; q' = q + v' w + b' w^2/2, with the q that the forces saw."""
    new_b = np.array([-1.0, 0.0, 0.0])
    new_v = np.array([0.0, 1.0, w / 2]) + new_b * w / 2
    new_q = np.array([1.0, 0.0, 0.0]) + new_v * w + new_b * w * w / 2
    return np.stack([new_q, new_v, new_b])


def _umbra_repaired(w: float) -> np.ndarray:
    """q' = q + v w + b w^2/2; b' = -q'; v' = v + (b + b') w/2."""
    new_q = np.array([1.0, w, w * w / 2])
    new_b = -new_q
    new_v = np.array([0.0, 1.0, w / 2]) + new_b * w / 2
    return np.stack([new_q, new_v, new_b])


_MATRICES: dict[str, Callable[[float], np.ndarray]] = {
    "explicit-euler": _explicit_euler,
    "semi-implicit-euler": _semi_implicit_euler,
    "velocity-verlet": _velocity_verlet,
    "rk4": _rk4,
    "yoshida4": _yoshida4,
    "umbra": _umbra,
    "umbra-repaired": _umbra_repaired,
}

METHODS = tuple(_MATRICES)


def amplification(method: str, w: float, kept: float = 1.0) -> np.ndarray:
    """The matrix of one step, shape (2, 2), or (3, 3) for UMBRA's pipelines.

    Args:
        method: a name in :data:`METHODS`.
        w: omega dt.
        kept: the part of the velocity that damping leaves after each step, d^dt.
    """
    matrix = _MATRICES[method](w)
    matrix[1] *= kept
    return matrix


def spectral_radius(method: str, w: float, kept: float = 1.0) -> float:
    """The growth per step of the fastest growing motion."""
    return float(np.abs(np.linalg.eigvals(amplification(method, w, kept))).max())


def discrete_solution(
    method: str, w: float, start: tuple[float, float], steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """The exact (q, v) after 0, 1, ..., `steps` steps of a method, shape (steps + 1,) each."""
    matrix = amplification(method, w)
    primed = -start[0] if method == "umbra-repaired" else 0.0
    state = np.array([*start, primed])[: len(matrix)]
    # By eigenvectors, so that thousands of multiplications do not add their own rounding up.
    values, vectors = np.linalg.eig(matrix)
    parts = vectors * np.linalg.solve(vectors, state)
    powers = values[:, None] ** np.arange(steps + 1)
    q, v, *_ = (parts @ powers).real
    return q, v
