"""The stiffness of a mesh of equal cells, as boxes have them: one cell is integrated for all.

    K = Σ_T Aᵀ K_T A,  K_T = ∫_T λ ∂_i φ_a ∂_j φ_b + μ (δ_ij ∇φ_a · ∇φ_b + ∂_j φ_a ∂_i φ_b) dx.

A form compiler integrates each cell; on small sub-boxes this takes three to five times as long as
the sum of copies of one K_T, to the same digits.
"""

import numpy as np
from scipy import sparse

from meshes import Reference, dolfinx_compat
from meshes.subdomains import vtk_shapes
from solver.vectors import Array, Ints

EQUAL = 1e-12
"""Largest difference of the coordinates of equal cells, over their size."""

MOST_PAIRS = 500_000
"""Pairs of nodes of a cell, over all cells, up to which copies of K_T are held at once: 40 MB."""


def has_equal_cells(reference: Reference) -> bool:
    """Whether all cells are translations of the first, and few enough to be added up at once."""
    cells = reference.cells
    if reference.curved or not 1 < len(cells) <= MOST_PAIRS // cells.shape[1] ** 2:
        return False
    places = reference.points[cells] - reference.points[cells[:, :1]]
    return bool(np.abs(places - places[0]).max() <= EQUAL * np.abs(places[0]).max())


def stiffness_of_equal_cells(
    reference: Reference, dimension: int, moduli: tuple[float, float], rule: int
) -> sparse.csr_matrix:
    """K, (unknowns, unknowns), of one material.

    Parameters
    ----------
    moduli
        λ and μ.
    rule
        Degree of the rule of integration.
    """
    one = _of_one_cell(reference, dimension, moduli, rule)
    return sum_of_copies(one, reference.cells.astype(np.int64), len(reference.points))


def sum_of_copies(K: Array, cells: Ints, nodes: int) -> sparse.csr_matrix:
    """K of a mesh, with entries that are zero, from that of one of its equal cells.

    Parameters
    ----------
    K : (n · d, n · d)
        Of a cell, components of a node one after another.
    cells : (cells, n)
        Numbers of the nodes of each cell, below `nodes`.
    """
    n = cells.shape[1]
    d = len(K) // n
    blocks = K.reshape(n, d, n, d)
    blocks = np.ascontiguousarray(blocks.transpose(0, 2, 1, 3)).reshape(n * n, d, d)
    pairs = (cells[:, :, None] * nodes + cells[:, None, :]).ravel()
    order = np.argsort(pairs, kind="stable")
    pairs = pairs[order]
    begins = np.flatnonzero(np.diff(pairs, prepend=-1))
    row, column = np.divmod(pairs[begins], nodes)
    widths = np.bincount(row, minlength=nodes)
    data = np.add.reduceat(blocks[order % (n * n)], begins, axis=0)
    shape = (nodes * d, nodes * d)
    return sparse.bsr_matrix((data, column, np.cumsum([0, *widths])), shape=shape).tocsr()


def _of_one_cell(reference: Reference, d: int, moduli: tuple[float, float], rule: int) -> Array:
    """K_T of the first cell, (nodes · d, nodes · d)."""
    lam, mu = moduli
    points, weights = dolfinx_compat.quadrature(reference.cell, rule)
    slopes = vtk_shapes(reference.cell, reference.degree, points)[1]
    mapping = vtk_shapes(reference.cell, 1, points)[1]
    corners = reference.points[reference.cells[0, : mapping.shape[2]], :d]
    jacobian = np.einsum("ni,qkn->qik", corners, mapping)
    volume = weights * np.abs(np.linalg.det(jacobian))
    gradient = np.einsum("qkj,qkn->qnj", np.linalg.inv(jacobian), slopes)
    flat = gradient.reshape(len(points), -1)
    products = (flat * volume[:, None]).T @ flat  # ∫ ∂_i φ_a ∂_j φ_b, row a · d + i
    n = gradient.shape[1]
    result = lam * products
    sides = products.reshape(n, d, n, d)
    result += mu * sides.transpose(0, 3, 2, 1).reshape(n * d, n * d)
    result += mu * np.kron(np.einsum("aibi->ab", sides), np.eye(d))
    return result
