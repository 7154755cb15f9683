"""Conditions at nodes before B is written: held components, contact rows, contradictions."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy import sparse

from solver.vectors import Array, Ints, Mask


class ContradictionError(ValueError):
    """Conditions on one node exclude each other.

    Attributes
    ----------
    first, second
        Sources of the two conditions, as indices given by the caller.
    node
        Global number of a node with the contradiction.
    amount
        Size of the contradiction, a length.
    kind
        ``held twice``; ``held in contact``: inside the obstacle or body of a
        contact; ``squeezed`` between two obstacles.
    """

    def __init__(self, kind: str, first: int, second: int, node: int, amount: float) -> None:
        super().__init__(f"{kind}: conditions {first} and {second} at node {node}")
        self.kind, self.first, self.second = kind, first, second
        self.node, self.amount = node, amount


@dataclass(frozen=True, eq=False)
class NodeConditions:
    """Conditions at nodes of this rank's subdomains; repeated conditions are allowed."""

    held_nodes: Ints
    held_points: Array
    held: Mask
    values: Array
    held_source: Ints
    """Global node (k,), coordinates (k, 3), mask of held components (k, dimension), their
    displacements (k, dimension), and index of the condition (k,)."""
    contact_nodes: Ints
    contact_points: Array
    directions: Array
    gaps: Array
    contact_source: Ints
    """Global node (k,), coordinates (k, 3), unit direction into the obstacle (k, dimension), gap
    along it (k,), and index of the contact (k,)."""

    def of_contacts(self, some: Mask) -> "NodeConditions":
        """The conditions with some of the contact rows (k,) only."""
        names = ("contact_nodes", "contact_points", "directions", "gaps", "contact_source")
        return replace(self, **{name: getattr(self, name)[some] for name in names})


@dataclass(frozen=True, eq=False)
class HeldRows:
    """Held nodes that this rank owns."""

    nodes: Ints
    points: Array
    """Global number and coordinates. Shapes (k,), (k, 3)."""
    held: Mask
    values: Array
    """Mask of held components, and their displacements; 0 for other components. Shapes (k,
    dimension), (k, dimension)."""


@dataclass(frozen=True, eq=False)
class ContactEntries:
    """Entries of contact rows, over nodes that any rank may own."""

    row: Ints  # (entries,)
    """Row among those of this rank."""
    node: Ints
    points: Array
    component: Ints
    value: Array
    """Node, its coordinates, component of the displacement and coefficient. Shapes (entries,),
    (entries, 3), (entries,), (entries,)."""

    @classmethod
    def none(cls) -> "ContactEntries":
        """An empty table of entries."""
        number = np.zeros(0, np.int64)
        return cls(number, number, np.zeros((0, 3)), number, np.zeros(0))

    @classmethod
    def join(cls, parts: "Sequence[ContactEntries]", rows: Sequence[int]) -> "ContactEntries":
        """The entries of several parts, one after another.

        `rows` has the number of rows of each part.
        """
        starts = np.cumsum([0, *rows])[:-1]
        fields = [{**p.__dict__, "row": p.row + s} for p, s in zip(parts, starts, strict=True)]
        return cls(**{name: np.concatenate([f[name] for f in fields]) for name in fields[0]})

    def some(self, chosen: Mask) -> "ContactEntries":
        """Some of the entries (entries,)."""
        return ContactEntries(**{name: values[chosen] for name, values in self.__dict__.items()})

    def of_rows(self, keep: Mask) -> "ContactEntries":
        """The entries of some rows (rows,), renumbered."""
        entries = self.some(keep[self.row])
        return replace(entries, row=(np.cumsum(keep) - 1)[entries.row])


ENTRIES = ("entries", "held", "rigid", "replaced")
"""Fields of `ContactRows` that hold entries instead of one value per row."""


@dataclass(frozen=True, eq=False)
class ContactRows:
    """This rank's contact rows, Σ value · ū ≤ gap, sorted by node and then by contact."""

    nodes: Ints
    points: Array
    sources: Ints
    """Node of each row (k,), its coordinates (k, 3) and the index of the contact (k,)."""
    gaps: Array  # (k,)
    """Gap of each row, reduced by the displacement of held components."""
    normals: Array  # (k, dimension)
    """Force on the body for a multiplier of one: the normal out of the obstacle or other body."""
    moments: Array  # (k, 3)
    """Moment of that force about the node: zero unless the row has several nodes of the body."""
    areas: Array  # (k,)
    """Area on which the multiplier acts; NaN where this is the node's share of the boundary."""
    spread: Array  # (k,)
    """One over the length of the row on the copies. The force is the multiplier of the scaled row
    times `spread`, and the distance is the residual over `spread`."""
    entries: ContactEntries
    """The coefficients, without held components."""
    held: ContactEntries = field(default_factory=ContactEntries.none)
    """The coefficients of held components, after `cut_held` removed them from `entries`."""
    rigid: ContactEntries = field(default_factory=ContactEntries.none)
    """The coefficients of the motions of rigid bodies, at the nodes of rigid bodies. They count
    neither for the length of a row nor for `wide`, because no stiffness resists them."""
    replaced: ContactEntries = field(default_factory=ContactEntries.none)
    """The coefficients of nodes that are tied to rigid bodies, which those in `rigid` replace."""

    @classmethod
    def empty(cls, dimension: int) -> "ContactRows":
        """No rows."""
        number, none = np.zeros(0, np.int64), np.zeros(0)
        return cls(
            nodes=number, points=np.zeros((0, 3)), sources=number, gaps=none,
            normals=np.zeros((0, dimension)), moments=np.zeros((0, 3)), areas=none, spread=none,
            entries=ContactEntries.none(),
        )  # fmt: skip

    @property
    def on_rigid(self) -> Mask:
        """Mask (k,) of the rows with entries at a rigid body."""
        result = np.zeros(len(self.nodes), bool)
        result[self.rigid.row] = True
        return result

    @property
    def wide(self) -> Mask:
        """Mask (k,) of the rows with entries at several nodes."""
        row, node = self.entries.row, self.entries.node
        of_row = np.zeros(len(self.nodes), np.int64)
        of_row[row] = node  # one node of each row
        result = np.zeros(len(self.nodes), bool)
        result[row[node != of_row[row]]] = True
        return result

    @classmethod
    def join(cls, parts: "Sequence[ContactRows]") -> "ContactRows":
        """Rows of several parts, sorted."""
        fields = [f for f in cls.__dataclass_fields__ if f not in ENTRIES]
        joined = {name: np.concatenate([getattr(p, name) for p in parts]) for name in fields}
        counts = [len(p.nodes) for p in parts]
        entries: dict[str, Any] = {
            name: ContactEntries.join([getattr(p, name) for p in parts], counts) for name in ENTRIES
        }
        order = np.lexsort((joined["sources"], joined["nodes"]))
        place = np.empty(len(order), np.int64)
        place[order] = np.arange(len(order))
        return cls(
            **{name: values[order] for name, values in joined.items()},
            **{name: replace(of_name, row=place[of_name.row]) for name, of_name in entries.items()},
        )

    def of(self, keep: Mask) -> "ContactRows":
        """Some of the rows, (k,)."""
        fields = {
            name: v.of_rows(keep) if name in ENTRIES else v[keep]
            for name, v in self.__dict__.items()
        }
        return ContactRows(**fields)

    def none(self) -> "ContactRows":
        """No rows."""
        return self.of(np.zeros(len(self.nodes), bool))


def points_of(rows: ContactRows) -> Ints:
    """Number of the contact point of each row, (rows,): rows of one node and contact share it."""
    new = (np.diff(rows.nodes) != 0) | (np.diff(rows.sources) != 0)
    return np.cumsum(np.concatenate([np.zeros(min(len(rows.nodes), 1), bool), new]))


def pairs_at_nodes(node: Ints) -> Iterator[tuple[Ints, Ints]]:
    """Pairs of rows that share a node, the rows sorted by node; each pair once."""
    if len(node) == 0:
        return
    _, start, count = np.unique(node, return_index=True, return_counts=True)
    for a in range(int(count.max())):
        for b in range(a):
            both = start[count > a]
            yield both + b, both + a


def unit_rows(rows: ContactRows) -> tuple[sparse.csr_matrix, Array]:
    """Contact rows scaled to unit length, and their lengths before scaling.

    The nodes may belong to any rank: columns are numbered over all nodes.

    Returns
    -------
    A matrix (rows, components of nodes), and (rows,).
    """
    entries = rows.entries
    column = entries.node * rows.normals.shape[1] + entries.component
    columns, place = np.unique(column, return_inverse=True)
    matrix = sparse.csr_matrix(
        (entries.value, (entries.row, place.reshape(-1))), shape=(len(rows.nodes), len(columns))
    )
    norm = np.sqrt(np.asarray(matrix.multiply(matrix).sum(axis=1)).ravel())
    return sparse.csr_matrix(sparse.diags(1.0 / norm) @ matrix), norm
