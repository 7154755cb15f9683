"""Rows of B: orthonormal, of full rank, right where conditions overlap."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mpi4py import MPI

from solver.contact.row_kinds import RowKind
from solver.exchange import NodeExchange
from solver.problem.constraints.conditions import ContradictionError, NodeConditions
from solver.problem.constraints.merge import merge_contact, merge_held
from solver.problem.constraints.shared_rows import SharedRows
from solver.tfeti.constraints.rows import write_rows

D = 3


def conditions(
    held: list[tuple[int, list[float | None]]] = (),
    contact: list[tuple[int, list[float], float]] = (),
) -> NodeConditions:
    """Conditions from (node, values) and (node, direction into the obstacle, gap)."""
    values = np.array([[np.nan if v is None else v for v in row] for _, row in held])
    values = values.reshape(-1, D)
    return NodeConditions(
        held_nodes=np.array([n for n, _ in held], dtype=np.int64),
        held_points=np.zeros((len(held), 3)),
        held=~np.isnan(values),
        values=np.nan_to_num(values),
        held_source=np.arange(len(held)),
        contact_nodes=np.array([n for n, _, _ in contact], dtype=np.int64),
        contact_points=np.zeros((len(contact), 3)),
        directions=np.array([c for _, c, _ in contact], dtype=float).reshape(-1, D),
        gaps=np.array([g for _, _, g in contact], dtype=float),
        contact_source=np.arange(len(contact)),
    )


def build(nodes: list[int], given: NodeConditions, eliminate: bool = False):
    """B as a dense matrix over (copy, component), its right-hand side and kinds, and the rows."""
    exchange = NodeExchange(MPI.COMM_SELF, np.array(nodes, dtype=np.int64), max(nodes) + 1)
    held = merge_held(exchange, given)
    contact, _ = merge_contact(exchange, given, held, 1.0)
    eliminated = np.full(len(held.nodes), eliminate)
    shared = SharedRows.of(contact)
    rows, shared = write_rows(exchange, np.arange(len(nodes)), held, shared, eliminated)
    B = np.zeros((len(rows.kind), len(nodes) * D))
    row, column, value = rows.entries(np.arange(len(nodes) * D).reshape(-1, D))
    np.add.at(B, (row, column), value)
    return B, rows.rhs, rows.kind, shared.contact


def test_an_edge_shared_by_four_is_glued_by_three_rows_a_component() -> None:
    B, rhs, kind, _ = build([7, 7, 7, 7], conditions())
    assert B.shape == (3 * D, 4 * D)
    np.testing.assert_allclose(B @ B.T, np.eye(3 * D), atol=1e-15)
    np.testing.assert_allclose(B @ np.tile([1.0, 2.0, 3.0], 4), 0, atol=1e-15)
    assert not rhs.any()
    assert (kind == RowKind.GLUING).all()


def test_a_held_component_replaces_its_gluing_rows() -> None:
    B, rhs, kind, _ = build([0, 0], conditions(held=[(0, [0.5, None, None])]))
    assert sorted(kind) == [RowKind.GLUING] * 2 + [RowKind.DIRICHLET] * 2
    np.testing.assert_allclose(B @ B.T, np.eye(4), atol=1e-15)
    np.testing.assert_allclose(B @ np.tile([0.5, 7.0, 8.0], 2), rhs)


def test_the_contact_force_on_a_shared_node_is_split_among_its_copies() -> None:
    c = [0.6, 0.0, 0.8]
    B, rhs, kind, rows = build([3, 3, 3], conditions(contact=[(3, c, 0.2)]))
    row = B[kind == RowKind.CONTACT][0]
    np.testing.assert_allclose(B @ B.T, np.eye(len(B)), atol=1e-15)
    np.testing.assert_allclose(row @ np.tile(c, 3), np.sqrt(3.0))
    touching = 0.2 * np.array(c)
    assert row @ np.tile(touching, 3) == pytest.approx(rhs[kind == RowKind.CONTACT][0])
    assert rows.spread == pytest.approx([np.sqrt(3.0)])


def test_a_node_held_and_in_contact_keeps_the_free_part_of_the_row() -> None:
    given = conditions(held=[(0, [0.1, None, None])], contact=[(0, [0.6, 0.8, 0.0], 0.5)])
    B, rhs, kind, rows = build([0], given)
    np.testing.assert_allclose(B @ B.T, np.eye(2), atol=1e-15)
    np.testing.assert_allclose(B[kind == RowKind.CONTACT], [[0.0, 1.0, 0.0]])
    # 0.6 · 0.1 + 0.8 u_y ≤ 0.5
    assert rhs[kind == RowKind.CONTACT][0] == pytest.approx((0.5 - 0.06) / 0.8)
    assert rows.gaps[0] == pytest.approx(0.5 - 0.06)
    assert rows.spread[0] == pytest.approx(1.25)


def test_a_row_decided_by_held_values_is_dropped() -> None:
    given = conditions(held=[(0, [0.1, 0.0, 0.0])], contact=[(0, [1.0, 0.0, 0.0], 0.5)])
    _, _, kind, _ = build([0], given)
    assert (kind == RowKind.DIRICHLET).all()


def test_a_node_held_inside_an_obstacle_is_refused() -> None:
    given = conditions(held=[(0, [0.6, 0.0, 0.0])], contact=[(0, [1.0, 0.0, 0.0], 0.5)])
    with pytest.raises(ContradictionError) as refused:
        build([0], given)
    assert refused.value.kind == "held in contact"
    assert refused.value.amount == pytest.approx(0.1)


def test_two_values_for_one_component_are_refused() -> None:
    with pytest.raises(ContradictionError) as refused:
        build([0], conditions(held=[(0, [0.1, None, None]), (0, [0.2, 0.0, None])]))
    assert refused.value.kind == "held twice"
    assert {refused.value.first, refused.value.second} == {0, 1}


def test_one_value_given_twice_is_one_condition() -> None:
    B, _, _, _ = build([0], conditions(held=[(0, [0.1, None, None]), (0, [0.1, 0.0, None])]))
    assert len(B) == 2


def test_of_equal_directions_the_tightest_row_stays() -> None:
    x = [1.0, 0.0, 0.0]
    given = conditions(contact=[(0, x, 0.3), (0, x, 0.1), (0, x, 0.2), (0, [0.0, 1.0, 0.0], 0.5)])
    _, rhs, _, rows = build([0], given)
    assert sorted(rhs) == [0.1, 0.5]
    assert sorted(rows.sources) == [1, 3]


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_rows_have_full_rank_however_conditions_overlap(data: st.DataObject) -> None:
    copies = data.draw(st.lists(st.integers(0, 3), min_size=1, max_size=12))
    nodes = sorted(set(copies))
    number = st.sampled_from([None, 0.0])
    held = [
        (n, data.draw(st.lists(number, min_size=D, max_size=D)))
        for n in nodes
        if data.draw(st.booleans())
    ]
    axis = st.sampled_from([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0], [0.6, 0.8, 0], [0, 0.6, 0.8]])
    contact = [
        (n, data.draw(axis), 0.1) for n in nodes for _ in range(data.draw(st.integers(0, 2)))
    ]
    B, _, kind, _ = build(copies, conditions(held, contact))
    if len(B):
        assert np.linalg.matrix_rank(B, tol=1e-8) == len(B)
    plain = B[kind != RowKind.CONTACT]
    np.testing.assert_allclose(plain @ plain.T, np.eye(len(plain)), atol=1e-14)
