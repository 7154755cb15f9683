"""Polynomials fitted around the vertices of a mesh, across subdomains and ranks.

Sums over the cells around a vertex are computed by subdomain and added at the owner of the vertex,
which fits the polynomial. A vertex with too few cells for a fit uses its neighbours. For most
linear polynomials only the value at the vertex is needed, which is the first row of the fit; the
whole fit is stored where a neighbour needs it.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy import sparse

from contact_app.accuracy.estimate.patches import Cells, monomial_count, translations
from contact_app.model.model import Model
from solver.exchange import NodeExchange
from solver.vectors import Array, Ints, Mask, blocks

FLAT = 1e-4
"""Determinant of a patch's linear moments, scaled to a unit diagonal, above which they determine a
linear polynomial: 1 for a symmetric patch, 0 for one whose cell centres lie in a plane."""

THIN = 1e-3
"""Smallest eigenvalue of quadratic moments, so scaled, above which they determine a quadratic
polynomial: 0.1 to 0.2 for a symmetric patch."""

OWN = 32.0
"""Additional weight of the cells around a vertex in a fit with the cells of its neighbours, which
only determine the coefficients that the few cells leave open."""

WEAK = 1e-2
"""Directions of a fit with eigenvalues below this share of the largest are left out."""

AT_ONCE = 20_000_000
"""Number of polynomial coefficients stored at once; stress components are processed in groups."""

HELPED_AT_ONCE = 256
"""Number of vertices whose neighbours' moments are moved at once: some megabytes."""


class Helped:
    """Owned vertices with too few cells, and the neighbours that help them out.

    The weight of a neighbour is the number of cells that it shares with the vertex. Linear
    polynomials are continued from neighbours that have one; quadratic ones are fitted to the
    moments about the vertex itself and all its neighbours.

    Attributes
    ----------
    targets : (targets,)
        Owned vertices with too few cells, by their place among all owned.
    sources : (sources,)
        Neighbours that are used.
    weight : (targets, 1)
        How often their neighbours count in all.
    """

    def __init__(
        self, cells: Sequence[Cells], copies: "Copies", targets: Mask, sources: Mask
    ) -> None:
        marked = copies.spread(np.stack([targets, sources], axis=1) * 1.0)
        rows, columns, weights, shifts = [], [], [], []
        for c, start, marks in zip(cells, copies.starts, marked, strict=False):
            target, source = np.moveaxis(marks > 0.0, 2, 0)
            members = target.shape[1]
            row, column, weight = c.neighbour_pairs
            some = np.flatnonzero(target.any(axis=1)[row] & source.any(axis=1)[column])
            row, column, weight = row[some], column[some], weight[some]
            pair, member = np.nonzero(target[row] & source[column])
            row, column = row[pair].astype(np.int64), column[pair].astype(np.int64)
            rows.append(start + row * members + member)
            columns.append(start + column * members + member)
            weights.append(weight[pair])
            shifts.append(c.points[row] - c.points[column])
        row = np.concatenate([np.zeros(0, np.int64), *rows])
        column = np.concatenate([np.zeros(0, np.int64), *columns])
        pairs = np.arange(len(row))
        sort = sparse.csr_matrix((pairs, (row, pairs)), shape=(copies.count, len(row)))
        counts = np.diff(sort.indptr)
        helped = np.flatnonzero(counts)
        counts, order = counts[helped], sort.indices
        self._starts = np.concatenate([[0], np.cumsum(counts)])
        self._weight = np.concatenate([np.zeros(0), *weights])[order]
        self._shift = np.concatenate([np.zeros((0, cells[0].dimension)), *shifts])[order]
        helps = np.zeros(copies.count, bool)
        helps[column] = True
        helping = np.flatnonzero(helps)
        self._columns = (np.cumsum(helps) - 1)[column[order]]
        self._helped, self._helping = copies.some(helped), copies.some(helping)
        self.sources = copies.places_of(self._helping)
        self.targets = copies.places_of(self._helped)
        totals = np.zeros((len(helped), 1))
        of = np.repeat(np.arange(len(helped)), counts)
        totals[:, 0] = np.bincount(of, self._weight, len(helped))
        self.weight = self._helped.gather(totals)

    def continued(self, polynomials: Array, count: int) -> Array:
        """The first coefficients of means of the neighbours' polynomials, (targets, count, k).

        Parameters
        ----------
        polynomials : (sources, monomials, k)
        """
        T = translations(self._shift, polynomials.shape[1], count)
        return self._summed(polynomials, T) / self.weight[:, :, None]

    def first(self, moments: Array) -> Array:
        """Σ m σ (targets, monomials, k), from those of the sources."""
        T = translations(-self._shift, moments.shape[1])
        return self._summed(moments, np.swapaxes(T, 1, 2))

    def second(self, A: Array) -> Array:
        """Σ m mᵀ (targets, monomials, monomials), from those of the sources."""
        size = A.shape[1]
        at_helping = self._helping.scatter(A.reshape(-1, size**2)).reshape(-1, size, size)
        sums = np.zeros((len(self._starts) - 1, size, size))
        for begin in range(0, len(sums), HELPED_AT_ONCE):
            starts = self._starts[begin : begin + HELPED_AT_ONCE + 1]
            pairs = slice(starts[0], starts[-1])
            T = translations(-self._shift[pairs], size)
            moved = np.swapaxes(T, 1, 2) @ at_helping[self._columns[pairs]] @ T
            moved *= self._weight[pairs, None, None]
            sums[begin : begin + HELPED_AT_ONCE] = np.add.reduceat(moved, starts[:-1] - starts[0])
        return self._helped.gather(sums.reshape(len(sums), size**2)).reshape(-1, size, size)

    def _summed(self, at_helping: Array, T: Array) -> Array:
        """Sum over neighbours of T (…, rows, size) times their values, (…, size, k)."""
        size, k = at_helping.shape[1:]
        rows = T.shape[1]
        values = self._helping.scatter(at_helping.reshape(-1, size * k))
        matrix = sparse.bsr_matrix(
            (self._weight[:, None, None] * T, self._columns, self._starts),
            shape=((len(self._starts) - 1) * rows, len(values) * size),
        )
        sums = (matrix @ values.reshape(-1, k)).reshape(-1, rows * k)
        return self._helped.gather(sums).reshape(-1, rows, k)


class Meeting:
    """Exchange between copies of nodes and their owners.

    Parameters
    ----------
    numbers : (copies,)
        The node each copy stands for.
    total
        Nodes in all.

    Attributes
    ----------
    owned_nodes : (owned,)
        Nodes this rank owns that have copies, in order. Values at them are in the order in which
        copies come: neighbours in memory are summed and sent to.
    """

    def __init__(self, comm: MPI.Intracomm, numbers: Ints, total: int) -> None:
        self._exchange = exchange = NodeExchange(comm, numbers, total)
        self.owned_nodes, first, at = np.unique(
            exchange.nodes, return_index=True, return_inverse=True
        )
        comes = np.zeros(len(exchange.nodes), np.int64)
        comes[first] = 1
        self._place = np.cumsum(comes)[first] - 1
        self._at = self._place[at.reshape(-1)]
        local, foreign = self._at[exchange.local_part], np.delete(self._at, exchange.local_part)
        self._sums = sparse.csr_matrix(
            (np.ones(len(local)), (local, exchange.local)),
            shape=(len(self.owned_nodes), len(numbers)),
        )
        # values from other ranks belong to few of the nodes
        self._shared, place = np.unique(foreign, return_inverse=True)
        arrived = len(foreign)
        self._foreign = sparse.csr_matrix(
            (np.ones(arrived), (place.reshape(-1), np.arange(arrived))),
            shape=(len(self._shared), arrived),
        )

    def places_of(self, part: "Meeting") -> Ints:
        """Positions here of the nodes of an exchange between a part of these nodes."""
        result = np.empty(len(part.owned_nodes), np.int64)
        result[part._place] = self._place[np.searchsorted(self.owned_nodes, part.owned_nodes)]
        return result

    def gather(self, copies: Array) -> Array:
        """Sum (copies, width) over the copies of a node, (owned, width)."""
        sums = self._sums @ copies
        if self._exchange.comm.size > 1:
            sums[self._shared] += self._foreign @ self._exchange.of_others(copies)
        return sums

    def scatter(self, values: Array) -> Array:
        """Bring (owned, width) to the copies, (copies, width)."""
        copies = values[self._at]
        return copies if self._exchange.comm.size == 1 else self._exchange.from_owners(copies)


class Copies(Meeting):
    """Copies of nodes in this rank's subdomains and their owners.

    Copies are numbered class by class, node by node, member by member.

    Parameters
    ----------
    nodes : one (n,) array per class
        Which of its nodes.

    Attributes
    ----------
    count
        Copies on this rank.
    starts : (classes + 1,)
        First copy of each class.
    shapes : one (n, members) pair per class
    """

    def __init__(self, model: Model, nodes: Sequence[Ints]) -> None:
        members = np.bincount(model.place[:, 0], minlength=len(nodes))
        self.shapes = [(len(n), int(m)) for n, m in zip(nodes, members, strict=True)]
        self.starts = np.cumsum([0, *(n * m for n, m in self.shapes)])
        self.count = int(self.starts[-1])
        numbers = np.empty(self.count, np.int64)
        for s, (cls, column) in zip(model.partition.subdomains, model.place, strict=True):
            self.of_class(numbers, cls)[:, column] = s.nodes[nodes[cls]]
        self._comm, self._numbers, self._total = model.comm, numbers, model.partition.nodes
        super().__init__(self._comm, numbers, self._total)

    def some(self, copies: NDArray[np.integer[Any]]) -> Meeting:
        """Exchange between some of the copies and their owners (collective)."""
        return Meeting(self._comm, self._numbers[copies], self._total)

    def of_class(self, values: NDArray, cls: int) -> NDArray:
        """View (n, members, …) of the copies of a class in (count, …)."""
        part = values[self.starts[cls] : self.starts[cls + 1]]
        return part.reshape(*self.shapes[cls], *values.shape[1:])

    def sum(self, by_class: Sequence[Array]) -> Array:
        """Sum (n, members, width) of each class over the copies of a node."""
        parts = [part.reshape(-1, part.shape[2]) for part in by_class]
        return self.gather(parts[0] if len(parts) == 1 else np.concatenate(parts))

    def spread(self, values: Array) -> list[Array]:
        """Bring (owned, width) to (n, members, width) of each class."""
        copies = self.scatter(values)
        return [self.of_class(copies, cls) for cls in range(len(self.shapes))]


def scaled_moments(cells: Sequence[Cells], copies: Copies, size: int) -> tuple[Array, Ints, Array]:
    """Second moments Σ m mᵀ about owned vertices, scaled to a unit diagonal (collective).

    Returns
    -------
    Distinct moments (kinds, monomials, monomials), the number of those of each vertex (owned,), and
    the roots of the diagonals (owned, monomials). Vertices amid equal cells have the same.
    """
    upper = np.triu_indices(size)
    moments_by_class: dict[int, Array] = {}
    for c in cells:
        if id(c) not in moments_by_class:
            moments_by_class[id(c)] = c.second_moments(size)[:, None]
    sums = copies.sum(
        [
            np.broadcast_to(moments_by_class[id(c)], (*shape, len(upper[0])))
            for c, shape in zip(cells, copies.shapes, strict=True)
        ]
    )
    on = np.flatnonzero(upper[0] == upper[1])
    root = np.sqrt(np.where(sums[:, on] > 0.0, sums[:, on], 1.0))
    weights = np.sqrt(np.arange(2.0, len(upper[0]) + 2.0))
    key = np.empty(len(sums))
    for rows in blocks(len(sums)):  # without more arrays of all vertices
        part, scale = sums[rows], root[rows]
        part /= scale[:, upper[0]] * scale[:, upper[1]]
        part[:, on] = 1.0
        key[rows] = np.round(np.round(part, 9) @ weights, 8)
    _, first, kind = np.unique(key, return_index=True, return_inverse=True)
    A = np.empty((len(first), size, size))
    A[:, upper[0], upper[1]] = A[:, upper[1], upper[0]] = sums[first]
    return A, kind.reshape(-1), root


def _outer(root: Array) -> Array:
    """Products of the entries of each row, (n, size, size)."""
    return root[:, :, None] * root[:, None, :]


def pseudo_inverse(A: Array, weak: float, dimension: int) -> Array:
    """Pseudo-inverse of moments (n, monomials, monomials) without weakly determined directions.

    Low degrees come first: of several polynomials with the same fit, the one with the smallest
    slopes is chosen, and of these the one with the smallest curvature. A body one cell thick is
    constant across.

    Parameters
    ----------
    weak
        Eigenvalue of what moments leave to a degree, over their diagonal, up to which that is so.
    """
    inverse = 1.0 / A[:, :1, :1]
    for end in (1 + dimension, A.shape[1]):
        begin = inverse.shape[1]
        if begin == end:
            break
        coupling = inverse @ A[:, :begin, begin:end]
        left = A[:, begin:end, begin:end] - np.swapaxes(A[:, :begin, begin:end], 1, 2) @ coupling
        diagonal = np.einsum("nii->ni", A)[:, begin:end]
        scale = _outer(np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)))
        values, vectors = np.linalg.eigh(left / scale)
        determined = values > weak
        reciprocals = np.where(determined, 1.0 / np.where(determined, values, 1.0), 0.0)
        corner = np.einsum("nij,nj,nkj->nik", vectors, reciprocals, vectors) / scale
        side = coupling @ corner
        inverse = np.block(
            [
                [inverse + side @ np.swapaxes(coupling, 1, 2), -side],
                [-np.swapaxes(side, 1, 2), corner],
            ]
        )
    return inverse


class LinearFits:
    """Linear polynomials, continued from neighbours to where there are too few cells (collective).

    Parameters
    ----------
    cells
        Of each class.
    flat
        Determinant from which the cells around a vertex determine a polynomial.
    """

    count = 1
    """Coefficients that `at_vertices` gives."""

    def __init__(
        self, comm: MPI.Intracomm, cells: Sequence[Cells], copies: Copies, flat: float = FLAT
    ) -> None:
        self._comm, self._cells, self._copies, self._flat = comm, cells, copies, flat
        self._size = 1 + cells[0].dimension
        A, kind, root = scaled_moments(cells, copies, self._size)
        fit = np.zeros(A.shape)
        self._determinants = np.linalg.det(A)
        determined = self._determinants > flat
        fit[determined] = np.linalg.inv(A[determined])
        done = determined[kind]
        continued: list[Helped] = []
        while comm.allreduce(int((~done).sum())):
            helped = Helped(cells, copies, ~done, done)
            if not comm.allreduce(len(helped.targets)):
                break
            continued.append(helped)
            done[helped.targets] = True
        left = np.unique(kind[~done])  # nothing to continue: a body one cell thick
        fit[left] = pseudo_inverse(A[left], WEAK, cells[0].dimension)
        self._row = fit[kind, 0]
        self._row /= root[:, :1]
        self._row /= root
        near = np.zeros(len(kind), bool)
        for helped in continued:
            near[helped.sources] = near[helped.targets] = True
        self._near, place = np.flatnonzero(near), np.cumsum(near) - 1
        self._fit = fit[kind[self._near]] / _outer(root[self._near])
        self._continued = [(h, place[h.sources], place[h.targets]) for h in continued]

    def determined_from(self, flat: float) -> "LinearFits":
        """Fits with another threshold; these where no determinant lies between (collective)."""
        others = (self._determinants > self._flat) != (self._determinants > flat)
        if not self._comm.allreduce(int(others.sum())):
            return self
        return LinearFits(self._comm, self._cells, self._copies, flat)

    def at_vertices(self, stresses: Sequence[Array]) -> Array:
        """Values at owned vertices of the polynomials that fit samples, (owned, k).

        Parameters
        ----------
        stresses : one (samples, members, k) array per class
        """
        k = stresses[0].shape[2]
        result = np.zeros((len(self._row), k))
        moments = np.empty((len(self._near), self._size, k))
        for a in range(self._size):
            sums = self._copies.sum(
                [c.moment(a, s) for c, s in zip(self._cells, stresses, strict=True)]
            )
            moments[:, a] = sums[self._near]
            sums *= self._row[:, a, None]
            result += sums
        polynomials = self._fit @ moments
        for nth, (helped, sources, targets) in enumerate(self._continued, 1):
            # of the last ones neighbours need the value only
            count = self._size if nth < len(self._continued) else 1
            polynomials[targets, :count] = helped.continued(polynomials[sources], count)
        result[self._near] = polynomials[:, 0]
        return result


class QuadraticFits:
    """Quadratic polynomials; where cells are too few, fitted to neighbours', too (collective).

    Parameters
    ----------
    cells
        Of each class; those of first degree leave the quadratic part alone.
    """

    def __init__(self, comm: MPI.Intracomm, cells: Sequence[Cells], copies: Copies) -> None:
        self._cells, self._copies, self._comm = cells, copies, comm
        d = cells[0].dimension
        self.count = self._size = size = monomial_count(d, 2)
        A, kind, root = scaled_moments(cells, copies, size)
        linear = 1 + d
        flat = np.linalg.det(A[:, :linear, :linear]) <= FLAT
        quadratic = np.abs(A[:, :linear, linear:]).max(axis=(1, 2)) > 0.0
        few = np.where(quadratic, np.linalg.eigvalsh(A)[:, 0] <= THIN, flat)
        fit = np.zeros(A.shape)
        fit[~few] = np.linalg.inv(A[~few])
        scale = _outer(root)
        self._fit = fit[kind] / scale
        self._helped = None
        few = few[kind]
        if comm.allreduce(int(few.sum())):
            self._helped = helped = Helped(cells, copies, few, np.ones_like(few))
            moments = A[kind] * scale
            of_patch = OWN * moments[helped.targets]
            enlarged = helped.second(moments[helped.sources]) + of_patch
            of_linear = np.flatnonzero(~quadratic[kind[helped.targets]])
            enlarged[of_linear, linear:] = enlarged[of_linear, :, linear:] = 0.0
            self._fit[helped.targets] = pseudo_inverse(enlarged, THIN, d)

    def determined_from(self, flat: float) -> "QuadraticFits":
        """Return self: the threshold applies to linear fits only."""
        return self

    def at_vertices(self, stresses: Sequence[Array]) -> Array:
        """Coefficients at owned vertices, (owned, monomials · k); the rest as for linear ones."""
        most = self._comm.allreduce(len(self._fit), op=MPI.MAX)
        step = max(1, AT_ONCE // (most * self._size + 1))
        parts = [
            self._polynomials([stress[..., k : k + step] for stress in stresses])
            for k in range(0, stresses[0].shape[2], step)
        ]
        polynomials = np.concatenate(parts, axis=2)
        return polynomials.reshape(len(polynomials), self._size * polynomials.shape[2])

    def _polynomials(self, stresses: Sequence[Array]) -> Array:
        """(owned, monomials, k) of some components."""
        size, k = self._size, stresses[0].shape[2]
        moments = []
        for c, stress in zip(self._cells, stresses, strict=True):
            polynomials = np.zeros((len(c.points), stress.shape[1], size, k))
            for a in range(len(c.first_moments)):
                polynomials[:, :, a] = c.moment(a, stress)
            moments.append(polynomials.reshape(*polynomials.shape[:2], -1))
        summed = self._copies.sum(moments).reshape(-1, size, k)
        if self._helped is not None:
            helped = self._helped
            of_patch = OWN * summed[helped.targets]
            summed[helped.targets] = helped.first(summed[helped.sources]) + of_patch
        return self._fit @ summed
