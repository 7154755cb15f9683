"""The depth buffer: hidden surfaces pixel by pixel, and surfaces behind translucent ones."""

import numpy as np
import pytest

from contact_app.results.plot.raster import DepthBuffer, Triangles, visible_share, wires

SIZE = 40


def square(depth: np.ndarray, low: float = 0.0, high: float = SIZE) -> np.ndarray:
    """Two triangles (2, 3, 3) that look to the eye, with depths at the four corners."""
    x = np.array([low, high, high, low])
    y = np.array([high, high, low, low])
    corners = np.stack([x, y, depth], axis=1).astype(float)
    return corners[[[0, 1, 2], [0, 2, 3]]]


def test_squares_that_interlock_hide_each_other_by_halves() -> None:
    """One rises to the right, the other to the left: each is in front on its side."""
    rising, falling = square(np.array([-9, 9, 9, -9])), square(np.array([9, -9, -9, 9]))
    for order in (1, -1):
        parts = [rising, falling][::order]
        buffer = DepthBuffer(SIZE, SIZE)
        buffer.add(np.concatenate(parts))
        owner = buffer.triangle.reshape(SIZE, SIZE) // 2
        expected = np.zeros((SIZE, SIZE), int)
        expected[:, : SIZE // 2] = 1 if order == 1 else 0
        expected[:, SIZE // 2 :] = 0 if order == 1 else 1
        np.testing.assert_array_equal(owner, expected)


def test_values_are_interpolated_within_triangles() -> None:
    corners = square(np.zeros(4))
    buffer = DepthBuffer(SIZE, SIZE)
    buffer.add(corners)
    pixel, triangle, shares = buffer.seen()
    assert len(pixel) == SIZE * SIZE
    column = np.einsum("ni,ni->n", shares, corners[triangle, :, 0])
    np.testing.assert_allclose(column, pixel % SIZE + 0.5, atol=1e-4)


def test_each_pixel_of_a_mesh_is_covered_once() -> None:
    """No gap along shared edges, whatever is drawn at once."""
    rng = np.random.default_rng(2)
    n = 7
    at = np.stack(np.meshgrid(*[np.linspace(0, SIZE, n)] * 2, indexing="ij"), axis=-1)
    at[1:-1, 1:-1] += rng.uniform(-2, 2, (n - 2, n - 2, 2))
    a, b, c, d = at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]
    halves = [np.stack(part, axis=2).reshape(-1, 3, 2) for part in ((a, b, c), (a, c, d))]
    corners = np.pad(np.concatenate(halves), ((0, 0), (0, 0), (0, 1)))
    buffer = DepthBuffer(SIZE, SIZE)
    buffer.add(corners)
    assert (buffer.triangle >= 0).all()


def test_transparent_layers_are_counted_in_front_of_opaque_ones_only() -> None:
    buffer = DepthBuffer(SIZE, SIZE)
    buffer.add(square(np.zeros(4), high=SIZE / 2))
    veils = np.concatenate([square(np.full(4, z)) for z in (5.0, 10.0, -5.0, 0.01)])
    count, bright = buffer.in_front(veils, np.repeat([0.5, 1.0, 0.2, 0.2], 2))
    count, bright = count.reshape(SIZE, SIZE), bright.reshape(SIZE, SIZE)
    # on the diagonal two triangles share pixels, which both count
    off = ~np.eye(SIZE, dtype=bool)[::-1]
    half = np.zeros((SIZE, SIZE), bool)
    half[: SIZE // 2, : SIZE // 2] = True
    assert (count[half & off] == 2).all()
    assert (count[~half & off] == 4).all()
    np.testing.assert_allclose(bright[half & off], 0.75)


@pytest.mark.parametrize(("depth", "share"), [(5.0, 0.0), (-5.0, 1.0), (0.0, 1.0)])
def test_hidden_surfaces(depth: float, share: float) -> None:
    """A square behind, in front of and on another one."""
    corners = np.concatenate([square(np.zeros(4)), square(np.full(4, depth))])
    chosen = np.array([True, True, False, False])
    assert visible_share(corners, chosen, SIZE, SIZE) == share


def test_edges_of_faces_are_drawn_and_not_their_diagonals() -> None:
    wired = np.array([[True, False, True], [True, True, False]])
    made = Triangles(square(np.zeros(4)), np.zeros((2, 3)), np.ones((2, 3)), wired)
    buffer = DepthBuffer(SIZE, SIZE)
    buffer.add(made.corners)
    pixel, triangle, shares = buffer.seen()
    dark = np.zeros((SIZE, SIZE), bool)
    dark.ravel()[pixel] = wires(made, triangle, shares)
    assert dark[0].all()
    assert dark[-1].all()
    assert dark[:, 0].all()
    assert dark[:, -1].all()
    assert not dark[1:-1, 1:-1].any()


@pytest.mark.parametrize(("height", "strength"), [(3.0, 0.0), (6.0, 0.5), (9.0, 1.0)])
def test_edges_of_low_faces_are_faint(height: float, strength: float) -> None:
    low = np.array([[[0.0, 0.0, 0.0], [50.0, height, 0.0], [50.0, 0.0, 0.0]]])
    made = Triangles(low, np.zeros((1, 3)), np.ones((1, 3)), np.array([[True, False, False]]))
    shares = np.array([[0.0, 0.5, 0.5], [0.8, 0.1, 0.1]])
    inside = wires(made, np.zeros(2, int), shares)
    assert inside[0] == pytest.approx(strength, abs=0.02)
    assert inside[1] == 0.0


def test_faces_that_look_away_are_known() -> None:
    front = square(np.zeros(4))
    made = Triangles(
        np.concatenate([front, front[:, ::-1]]), np.zeros((4, 3)), np.ones((4, 3)),
        np.zeros((4, 3), bool),
    )  # fmt: skip
    assert made.towards.tolist() == [True, True, False, False]
