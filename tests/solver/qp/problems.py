"""Small quadratic programs that the tests share."""

import numpy as np
from scipy import sparse

from solver import BoxQP

ALL = (
    "fixed",
    "grgr-optapprox",
    "gfgr-optapprox",
    "gfgf-optapprox",
    "grgr-opt",
    "gfgr-opt",
    "gfgf-opt",
    "projcg",
    "projcg-safe",
)


def string_obstacle(n: int = 100) -> tuple[sparse.csr_array, np.ndarray, np.ndarray]:
    """PERMON's example: a string over a wavy obstacle; Hessian, right-hand side, lower bound."""
    h = 1.0 / (n - 1)
    i = np.arange(n)
    main, off = np.full(n, 2.0), np.full(n - 1, -1.0)
    main[[0, -1]] = 1.0
    off[[0, -1]] = 0.0  # identity end rows
    lower = np.sin(4.0 * np.pi * i * h - np.pi / 6.0) / 2.0 - 2.0
    lower[[0, -1]] = 0.0
    return (
        sparse.csr_array(sparse.diags([off, main, off], [-1, 0, 1])),
        np.full(n, -30.0 * h**2),
        lower,
    )


def membrane(m: int, seed: int = 0) -> BoxQP:
    """A membrane of m × m inner points pressed onto a hilly obstacle."""
    second = sparse.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(m, m))
    A = sparse.csr_array(sparse.kronsum(second, second))
    t = np.linspace(0.0, 1.0, m + 2)[1:-1]
    x, y = np.meshgrid(t, t)
    lower = -0.05 - 0.05 * np.sin(6.0 * x + seed) * np.cos(9.0 * y)
    return BoxQP(A, np.full(m * m, -2.0 / m**2), lower=lower.ravel())


def random_hessian(rng: np.random.Generator, spectrum: np.ndarray) -> np.ndarray:
    """Symmetric matrix with the given eigenvalues and random eigenvectors."""
    Q, _ = np.linalg.qr(rng.standard_normal((spectrum.size, spectrum.size)))
    A = (Q * spectrum) @ Q.T
    return 0.5 * (A + A.T)


def kkt_residual(
    A: np.ndarray,
    b: np.ndarray,
    x: np.ndarray,
    lower: np.ndarray | None = None,
    upper: np.ndarray | None = None,
) -> float:
    """Norm of x - P(x - g)-like optimality, from the definitions alone."""
    g = A @ x - b
    low = np.zeros(x.size, bool) if lower is None else x <= lower
    high = np.zeros(x.size, bool) if upper is None else x >= upper
    g = np.where(
        low & high, 0.0, np.where(low, np.minimum(g, 0), np.where(high, np.maximum(g, 0), g))
    )
    return float(np.linalg.norm(g))
