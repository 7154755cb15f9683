"""Kernels of floating subdomains: the rigid motions, from geometry alone.

The null space of the elasticity stiffness of a connected subdomain is spanned by its rigid
motions, three in the plane and six in space: u(x) = t + W (x - x̄) with W antisymmetric. They
are written down from the nodes' coordinates and checked against the stiffness, never computed
from it (Dostál, Horák, Kučera, Total FETI, 2006).
"""

import numpy as np
from scipy import linalg, sparse

from solver.rigid_motions import rigid_motions
from solver.vectors import Array, Ints


def orthonormal_kernel(points: Array, dimension: int) -> Array:
    """Orthonormal basis R of the rigid motions of a set of nodes, (n · dimension, motions)."""
    centre = points.mean(axis=0)
    length = float(np.ptp(points, axis=0).max())
    motions = rigid_motions(points, dimension, centre, length)
    return np.linalg.qr(motions.reshape(len(points) * dimension, -1))[0]


def check_kernel(stiffness: sparse.csr_matrix, kernel: Array) -> None:
    """Check that the kernel is one: K R vanishes to round-off.

    Raises
    ------
    ValueError
        The stiffness resists a rigid motion, so the mesh or the assembly is wrong.
    """
    resistance = np.abs(stiffness @ kernel).max(initial=0.0)
    scale = np.abs(stiffness.diagonal()).max()
    if not resistance <= 1e-9 * scale:
        raise ValueError(
            f"the stiffness of a subdomain resists a rigid motion (|K R| = {resistance:.1e} "
            f"against |K| = {scale:.1e}); its cells may be degenerate"
        )


def fixing_nodes(points: Array, dimension: int) -> Ints:
    """Nodes far apart that determine a rigid motion: two in the plane, three in space.

    The first is the farthest from the centre, each next the one whose distance to the point or
    line through those before it is largest.
    """
    x = points - points.mean(axis=0)
    first = int(np.argmax(np.einsum("ij,ij->i", x, x)))
    chosen = [first]
    x = points - points[first]
    for _ in range(dimension - 1):
        farthest = int(np.argmax(np.einsum("ij,ij->i", x, x)))
        chosen.append(farthest)
        direction = x[farthest] / np.linalg.norm(x[farthest])
        x = x - np.outer(x @ direction, direction)
    return np.array(chosen)


def fixing_unknowns(kernel: Array) -> Ints:
    """Unknowns that determine any motion of a kernel (n, k), by QR with column pivoting, (k,)."""
    pivots = linalg.qr(kernel.T, mode="r", pivoting=True)[1]
    return np.sort(pivots[: kernel.shape[1]]).astype(np.int64)
