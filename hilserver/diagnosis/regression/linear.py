"""Least squares on whitened columns: projections, ridge solutions, covariances over blocks.

The sensitivities of causes differ by many orders of magnitude, so everything is solved on columns
of unit length; a `damping` is a share of that length.
"""

from typing import Final

import numpy as np

from hilserver.arrays import Array

SHORTEST: Final = 1e-100  # length of a column without any effect
DAMPING: Final = 1e-9  # keeps a Gram matrix invertible and changes no reported digit


def scaled(columns: Array) -> tuple[Array, Array]:
    """Return columns of unit length and their lengths; a column of zeros stays zero."""
    length = np.maximum(np.sqrt((columns**2).sum(axis=0)), SHORTEST)
    return columns / length, length


def basis(columns: Array) -> Array:
    """Return an orthonormal basis of columns; an empty one without any."""
    return np.linalg.qr(scaled(columns)[0])[0] if columns.shape[1] else columns


def orthogonal(columns: Array, others: Array | None) -> Array:
    """Return columns, shape (n,) or (n, k), without what others, shape (n, m), explain."""
    if others is None or others.shape[1] == 0:
        return columns
    base = basis(others)
    return np.asarray(columns - base @ (base.T @ columns))


def ridge(columns: Array, target: Array, damping: float = DAMPING) -> Array:
    """Return the coefficients of columns, shape (n, k), that explain most of a target."""
    unit, length = scaled(columns)
    return np.asarray(np.linalg.solve(_gram(unit, damping), unit.T @ target) / length)


def saved(columns: Array, target: Array, damping: float) -> float:
    """Return by how much columns together lower the sum of squares of a target."""
    unit, _ = scaled(columns)
    along = unit.T @ target
    return float(along @ np.linalg.solve(_gram(unit, damping), along))


def cosine(one: Array, other: Array) -> float:
    """Return the |cos| between two vectors; 0 if one is zero."""
    length = float(np.sqrt((one @ one) * (other @ other)))
    return abs(float(one @ other)) / length if length > 0.0 else 0.0


def inverse_gram(columns: Array) -> Array:
    """Return the covariance of coefficients under white noise of deviation one, shape (k, k)."""
    unit, length = scaled(columns)
    return np.asarray(np.linalg.inv(_gram(unit, DAMPING)) / np.outer(length, length))


def sandwich(columns: Array, sums: Array) -> Array:
    """Return the covariance of coefficients from the scatter between independent blocks.

    Parameters
    ----------
    sums : ndarray, shape (blocks, k)
        Of ``columns * residual`` over each block.
    """
    unit, length = scaled(columns)
    bread, own = np.linalg.inv(_gram(unit, DAMPING)), sums / length
    return np.asarray(bread @ (own.T @ own) @ bread / np.outer(length, length))


def covariance(columns: Array, sums: Array, blocks: int, level: float) -> Array:
    """Return the covariance of coefficients: the sandwich, or white noise if that is larger.

    Parameters
    ----------
    sums : ndarray
        See `sandwich`.
    blocks : int
        Number of blocks with information.
    level : float
        Variance of the residual; less than one counts as one.
    """
    robust = sandwich(columns, sums) * (blocks / (blocks - columns.shape[1]))
    naive = np.diag(inverse_gram(columns)) * max(level, 1.0)
    exact = np.diag(robust) < 1e-12 * naive  # a fit without any residual has no scatter
    robust[exact, exact] = naive[exact]
    growth = np.sqrt(np.maximum(naive / np.diag(robust), 1.0))
    return np.asarray(robust * np.outer(growth, growth))


def _gram(unit: Array, damping: float) -> Array:
    return np.asarray(unit.T @ unit + damping * np.eye(unit.shape[1]))
