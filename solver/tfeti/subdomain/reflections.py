"""Reflection symmetry of a subdomain, which splits its inverse into small independent blocks.

A box of equal cells is its own mirror image: with S_a the signed permutation that reflects
along axis a (nodes change places, the component along a changes sign), S_a K S_aᵀ = K. The
reflections a subdomain has commute and form a group H of at most 2^d elements. For each character
χ of H, the displacements with S_h u = χ(h) u are a subspace that K maps into itself; orthonormal
bases V_χ of these subspaces turn K, and a generalised inverse that keeps the symmetry, into |H|
blocks of about n / |H| unknowns (Bossavit, *Symmetry, groups, and boundary value problems*, 1986).
A dense inverse then costs |H| times less to apply and to hold, and its factors much less.
"""

from dataclasses import dataclass
from functools import cache, cached_property
from itertools import groupby, product

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import hadamard
from scipy.spatial import cKDTree

from solver.vectors import Array, Ints, runs

TOLERANCE = 1e-10
"""Relative difference up to which two coordinates, or two products with K, count as equal."""


@dataclass(frozen=True, eq=False)
class Symmetry:
    """The reflections of a subdomain, as signed permutations of its unknowns."""

    images: Ints  # (2^g, n)
    """Image of each unknown under each element of the group; element h is the product of the
    generators whose bit is set in h, element 0 the identity."""
    signs: NDArray[np.int8]  # (2^g, n)
    """Sign of the image, equal for a component at all nodes."""
    dimension: int
    """Number of unknowns of a node."""

    @property
    def order(self) -> int:
        """Number of elements of the group."""
        return len(self.images)

    def closure(self, unknowns: Ints) -> Ints:
        """The unknowns and their mirror images, in increasing order."""
        return np.unique(self.images[:, unknowns])

    def average(self, stiffness: sparse.csr_matrix) -> sparse.csr_matrix:
        """The mean of S K Sᵀ over the group: K without the round-off that breaks the symmetry.

        Coordinates have round-off of their own, so cells that should be mirror images differ in
        their last digits; a slender body multiplies the difference by its condition.
        """
        nodes = self.images.shape[1] // self.dimension
        blocks = stiffness.tobsr((self.dimension, self.dimension))
        blocks.sort_indices()
        h = 1
        while h < self.order:  # the generators are the elements with one bit set
            # unknowns of a node stay together: S K Sᵀ moves whole blocks and changes their signs
            node = self.images[h, :: self.dimension] // self.dimension
            sign = self.signs[h, : self.dimension].astype(float)
            back = np.argsort(node)
            widths = np.diff(blocks.indptr)[back]
            begins = np.zeros(nodes + 1, blocks.indptr.dtype)
            np.cumsum(widths, out=begins[1:])
            source = runs(blocks.indptr[back], widths)
            column = node[blocks.indices[source]]
            key = np.repeat(np.arange(nodes), widths) * nodes + column
            order = np.argsort(key)
            data = np.outer(sign, sign) * np.take(blocks.data, source[order], 0)
            column = column[order]
            if np.array_equal(column, blocks.indices) and np.array_equal(begins, blocks.indptr):
                blocks.data += data
            else:
                blocks = blocks + sparse.bsr_matrix((data, column, begins), stiffness.shape)
            blocks.data *= 0.5
            h *= 2
        result = blocks.tocsr()
        result.sort_indices()
        return result

    def split(self, unknowns: Ints) -> "Split":
        """The split into characters of vectors on unknowns that are closed under reflection."""
        inside = np.zeros(self.images.shape[1], bool)
        inside[unknowns] = True
        first = np.flatnonzero(inside & (self.images.min(axis=0) == np.arange(len(inside))))
        fixed = self.images[:, first] == first
        # elements that leave an unknown in place, and the signs of all elements, as bits
        bits = 1 << np.arange(self.order)
        kind = (bits @ fixed << self.order) + bits @ (self.signs[:, first] > 0)
        families = [self._family(first[kind == one]) for one in np.unique(kind)]
        families.sort(key=lambda family: len(family.unknowns))
        return Split(tuple(families), self.order)

    def _family(self, first: Ints) -> "Family":
        """Orbits on which the group acts alike, from their first unknowns."""
        one = first[0]
        stays = tuple((self.images[:, one] == one).tolist())
        cosets, characters = _action(stays, tuple(self.signs[:, one].tolist()))
        return Family(self.images[cosets][:, first], characters)


@dataclass(frozen=True, eq=False)
class Family:
    """Orbits of unknowns on which the group acts alike."""

    unknowns: Ints  # (2^k, orbits)
    """Row β holds the images under the product of those of k elements whose bit is set in β."""
    characters: Ints  # (2^k,)
    """Character of Σ_β (-1)^{β·γ} u_β, for each γ."""


@dataclass(frozen=True, eq=False)
class Split:
    """The transform to one coordinate per orbit and character, and back.

    Coordinates are Σ_β (-1)^{β·γ} u_β over the images of an unknown (a Walsh-Hadamard transform);
    they are orthogonal but not normalised. Orbits of one size are transformed together, and the
    coordinates are then sorted by character.
    """

    families: tuple[Family, ...]
    """Orbits, grouped by the action of the group; orbits of one size follow one another."""
    order: int
    """Number of characters."""

    @cached_property
    def unknowns(self) -> Ints:
        """The unknowns in the order of the vectors, (m,).

        If all components of a node are in the vectors, they follow one another.
        """
        return np.concatenate([unknowns.ravel() for _, unknowns, _ in self._groups])

    @cached_property
    def _groups(self) -> list[tuple[list[Family], Ints, Ints]]:
        """Families with orbits of one size, their unknowns (2^k, orbits), and places of the orbits.

        Orbits are sorted by their first unknowns, across families.
        """
        result = []
        for _, group in groupby(self.families, lambda f: len(f.unknowns)):
            families = list(group)
            unknowns = np.concatenate([f.unknowns for f in families], axis=1)
            order = np.argsort(unknowns[0])
            result.append((families, unknowns[:, order], np.argsort(order)))
        return result

    @cached_property
    def _transforms(self) -> list[tuple[slice, Array]]:
        """Place of each group in a vector, and its Hadamard matrix (cosets, cosets)."""
        result, begin = [], 0
        for _, unknowns, _ in self._groups:
            end = begin + unknowns.size
            result.append((slice(begin, end), _characters(len(unknowns))))
            begin = end
        return result

    @cached_property
    def _gather(self) -> Ints:
        """Place after the transforms of each coordinate in the order of the characters, (m,)."""
        parts: list[list[Ints]] = [[] for _ in range(self.order)]
        begin = 0
        for families, unknowns, place in self._groups:
            width, first = unknowns.shape[1], 0
            for family in families:
                orbits = place[first : first + family.unknowns.shape[1]]
                for gamma, character in enumerate(family.characters):
                    parts[character].append(begin + gamma * width + orbits)
                first += len(orbits)
            begin += unknowns.size
        return np.concatenate([np.zeros(0, np.int64), *(a for part in parts for a in part)])

    @cached_property
    def _scatter(self) -> Ints:
        """The inverse of `_gather`."""
        return np.argsort(self._gather)

    @cached_property
    def places(self) -> list[slice]:
        """Slice of the coordinates of each character."""
        ends = np.cumsum([0, *self.sizes])
        return [slice(int(a), int(b)) for a, b in zip(ends[:-1], ends[1:], strict=True)]

    @cached_property
    def sizes(self) -> list[int]:
        """Number of coordinates of each character, m_χ."""
        sizes = [0] * self.order
        for family in self.families:
            for character in family.characters:
                sizes[character] += family.unknowns.shape[1]
        return sizes

    @cached_property
    def orbits(self) -> list[Ints]:
        """First unknown and size of the orbit of each coordinate, (2, m_χ) for each character."""
        parts: list[list[Ints]] = [[] for _ in range(self.order)]
        for family in self.families:
            first = family.unknowns[0]
            part = np.stack([first, np.full_like(first, len(family.unknowns))])
            for character in family.characters:
                parts[character].append(part)
        return [np.concatenate([np.zeros((2, 0), np.int64), *p], axis=1) for p in parts]

    def bases(self, size: int) -> list[sparse.csr_matrix]:
        """V_χ, whose transpose maps vectors on all `size` unknowns to coordinates."""
        result = []
        for character, columns in enumerate(self.sizes):
            # each unknown is in one orbit, so it has at most one coordinate of a character
            place, value, start = np.full(size, -1), np.zeros(size), 0
            for family in self.families:
                cosets, orbits = family.unknowns.shape
                for gamma in np.flatnonzero(family.characters == character):
                    place[family.unknowns] = np.arange(start, start + orbits)
                    value[family.unknowns] = _characters(cosets)[gamma][:, None]
                    start += orbits
            some = place >= 0
            begins = np.concatenate([[0], np.cumsum(some)])
            entries = value[some], place[some], begins
            result.append(sparse.csr_matrix(entries, shape=(size, columns)))
        return result

    def forward(self, vectors: Array) -> Array:
        """Coordinates of vectors in the order of `unknowns`, character after character: (s, m)."""
        result = np.empty_like(vectors)
        np.take(self._transformed(vectors, np.empty_like(vectors)), self._gather, 1, out=result,
                mode="clip")  # fmt: skip
        return result

    def backward(self, coordinates: Array, out: Array) -> None:
        """Σ V_χ times coordinates: (s, m) to (s, m) in the order of `unknowns`."""
        gathered = np.empty_like(coordinates)
        np.take(coordinates, self._scatter, 1, out=gathered, mode="clip")
        self._transformed(gathered, out)

    def _transformed(self, vectors: Array, out: Array) -> Array:
        """Sums Σ_β (-1)^{β·γ} x_β over the cosets of each group, (s, m)."""
        for place, matrix in self._transforms:
            shape, signs = (len(vectors), len(matrix), -1), matrix.astype(vectors.dtype, copy=False)
            np.matmul(signs, vectors[:, place].reshape(shape), out=out[:, place].reshape(shape))
        return out


def find_symmetry(points: Array, dimension: int, stiffness: sparse.csr_matrix) -> Symmetry | None:
    """Reflections along the axes, and their products, that leave a stiffness unchanged.

    They are sought about the centre of the nodes, and tested on the stiffness with random
    displacements. Returns None without reflections.

    Parameters
    ----------
    points : (nodes, 3)
        Coordinates; unknown ``node * dimension + component``.
    """
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    x = points - middle
    length = float(np.abs(x).max())
    lopsided = np.abs(x.mean(axis=0)[:dimension]) > TOLERANCE * length
    tree = cKDTree(x)
    probe = np.random.default_rng(0).standard_normal(stiffness.shape[0])
    force = stiffness @ probe
    scale = float(np.abs(force).max())

    generators: list[tuple[Ints, NDArray[np.int8]]] = []
    spanned = {(False,) * dimension}
    flips = sorted(product((False, True), repeat=dimension), key=sum)
    for flip in flips[1:]:
        if flip in spanned or (lopsided & flip).any():
            continue
        mirror = np.ones(3)
        mirror[:dimension] = np.where(flip, -1.0, 1.0)
        distance, node = tree.query(x * mirror)
        if distance.max() > TOLERANCE * length or len(np.unique(node)) < len(node):
            continue
        image = (node[:, None] * dimension + np.arange(dimension)).ravel()
        sign = np.tile(mirror[:dimension], len(points))
        reflected = np.empty_like(probe)
        reflected[image] = sign * probe
        expected = np.empty_like(force)
        expected[image] = sign * force
        if np.abs(stiffness @ reflected - expected).max() > TOLERANCE * scale:
            continue
        generators.append((image, sign.astype(np.int8)))
        spanned |= {tuple(np.logical_xor(flip, s).tolist()) for s in spanned}
    if not generators:
        return None

    unknowns = stiffness.shape[0]
    images = [np.arange(unknowns)]
    signs = [np.ones(unknowns, np.int8)]
    for image, sign in generators:
        images += [image[earlier] for earlier in images]
        signs += [before * sign[earlier] for earlier, before in zip(images, signs, strict=False)]
    return Symmetry(np.array(images), np.array(signs), dimension)


@cache
def _action(stays: tuple[bool, ...], signs: tuple[int, ...]) -> tuple[list[int], Ints]:
    """How a group acts on an unknown: the images of an orbit, and the characters of its sums.

    Parameters
    ----------
    stays, signs
        For each element, whether it leaves the unknown in place, and the sign of the image.
    """
    elements = range(len(stays))
    fixing = [h for h in elements if stays[h]]
    moves: list[int] = []  # a basis of the quotient group
    reached = set(fixing)
    for h in elements:
        if h not in reached:
            moves.append(h)
            reached |= {h ^ g for g in reached}
    cosets = [0]
    for h in moves:
        cosets += [h ^ g for g in cosets]
    # of the characters that are 1 on the elements that stay: their signs on the basis
    negative = (_characters(len(stays)) * np.array(signs)) < 0
    unchanged = np.flatnonzero(~negative[:, fixing].any(axis=1))
    characters = np.empty(len(cosets), np.int64)
    characters[negative[unchanged][:, moves] @ (1 << np.arange(len(moves)))] = unchanged
    return cosets, characters


@cache
def _characters(order: int) -> Array:
    """Value, -1 or 1, of each character (rows) on each element (columns) of a group."""
    return np.asarray(hadamard(order, dtype=float))
