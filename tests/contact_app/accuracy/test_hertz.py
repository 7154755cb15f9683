"""Hertz's contact by force, curvatures of the gap, and its observed size."""

import warnings
from pathlib import Path

import meshio
import numpy as np
import pytest
from mpi4py import MPI

import contact_app
from contact_app.accuracy.hertz import FREE, peak_of, thickness_at
from tests import meshfiles, scenes

MODULUS, FORCE, RADIUS = 1000.0, 2.0, 3.0
ROOM = np.full(3, np.inf)
HALF = (0.75 * FORCE * RADIUS / MODULUS) ** (1.0 / 3.0)


@pytest.mark.parametrize("slope", [0.5 / RADIUS, 1e-17])
def test_a_curvature_that_is_a_rounding_error_gives_no_peak(slope: float) -> None:
    """An edge on a plane: its contact would be infinitely wide."""
    found = peak_of(FORCE, MODULUS, np.full(2, slope), np.full(2, HALF / np.sqrt(5.0)), 0.02, ROOM)
    if slope < 1e-9:
        assert found is None
    else:
        assert found == pytest.approx(1.5 * FORCE / (np.pi * HALF**2), rel=1e-5)


@pytest.mark.parametrize("size", [0.4, 2.5])
def test_a_contact_of_other_size_gives_no_peak(size: float) -> None:
    lengths = np.full(2, size * HALF / np.sqrt(5.0))
    assert peak_of(FORCE, MODULUS, np.full(2, 0.5 / RADIUS), lengths, 0.02, ROOM) is None


def test_a_line_on_a_line_gives_no_peak() -> None:
    """The edge of a block: one row of nodes of some length."""
    bends, lengths = np.array([1e-17, -1e-17]), np.array([0.0, 0.3])
    assert peak_of(FORCE, MODULUS, bends, lengths, 0.17, ROOM) is None


@pytest.mark.parametrize("place", [0, 1, 2])
def test_the_end_of_a_boundary_and_thin_bodies_give_no_peak(place: int) -> None:
    found = []
    for share in (1.01, 0.99):
        room = np.where(np.arange(3) == place, share * FREE * HALF, np.inf)
        lengths = np.full(2, HALF / np.sqrt(5.0))
        found.append(peak_of(FORCE, MODULUS, np.full(2, 0.5 / RADIUS), lengths, 0.02, room))
    assert found == [pytest.approx(1.5 * FORCE / (np.pi * HALF**2), rel=1e-5), None]


@pytest.mark.parametrize(("radius", "error"), [(0.5, 0.025), (1.0, 0.003)])
@pytest.mark.parametrize("cell", ["hexahedron", "quadrilateral"])
def test_peaks_of_facets_as_large_as_a_part_of_the_radius(
    cell: str, radius: float, error: float
) -> None:
    """Facets of R/4 and R/8: gaps are lengths along the radius, not along the normal."""
    d, half, modulus = scenes.dimension(cell), 0.0625, 1000.0 / 0.91
    force = np.pi * half**2 * modulus / (4.0 * radius)
    peak = 2.0 * force / (np.pi * half)
    if d == 3:
        force = 4.0 * modulus * half**3 / (3.0 * radius)
        peak = 1.5 * force / (np.pi * half**2)
    cells = [8] * (d - 1) + [4]
    block = scenes.box("block", [0.5] * (d - 1) + [0.0], cells, [-0.5] * d)
    ball = {"sphere": {"center": [0.0] * (d - 1) + [radius], "radius": radius}}
    conditions = [
        scenes.clamp(cell, f"block.{scenes.down(cell)}"),
        {
            "in": "ball",
            "displacement": [0.0] * (d - 1) + [None],
            "rotation": [0.0] * 3 if d == 3 else 0.0,
        },
        {"in": "ball", "total_force": [0.0] * (d - 1) + [-force]},
    ]
    contact = {"on": f"block.{scenes.up(cell)}", "against": "ball"}
    bodies = [block, {"name": "ball", "rigid": ball}]
    answer = contact_app.solve(scenes.config(cell, bodies, conditions, [contact]))
    found = answer.summary["contacts"][0]["max_smoothed_pressure"]
    assert found == pytest.approx(peak, rel=error)


@pytest.mark.parametrize("thickness", [0.05, 0.2])
@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_a_thin_strip_of_any_direction_has_no_peak(
    thickness: float, angle: float, tmp_path: Path
) -> None:
    """The contact is 0.05 wide. The box about an inclined strip is not thin."""
    along, up = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, 41), np.linspace(-thickness, 0.0, 3))
    first = (np.arange(2)[:, None] * 41 + np.arange(40)).ravel()
    cells = [("quad", first[:, None] + [0, 1, 42, 41])]
    points = x.reshape(-1, 1) * along + y.reshape(-1, 1) * up
    file = meshfiles.write(meshio.Mesh(np.pad(points, ((0, 0), (0, 1))), cells), tmp_path / "a.msh")
    height = f"({float(up[0])!r} * x + {float(up[1])!r} * y)"
    sides = {"top": f"{height} > -1e-9", "foot": f"{height} < {1e-9 - thickness}"}
    strip = {
        "name": "strip",
        "mesh": {"file": str(file)},
        "material": {"young": 1e5, "poisson": 0.3},
        "boundaries": {name: {"where": where} for name, where in sides.items()},
    }
    circle = {"sphere": {"center": (1.9996 * up).tolist(), "radius": 2.0}}
    held = {"on": "strip.foot", "displacement": [0, 0]}
    contact = {"on": "strip.top", "obstacle": circle}
    scene = scenes.config("quadrilateral", [strip], [held], [contact])
    (warning,) = [w for w in contact_app.solve(scene).certificate.warnings if "within single" in w]
    assert ("Hertz's theory" in warning) == (thickness > 0.1)


def test_a_wall_is_as_thick_as_it_is() -> None:
    """A line through a tube ends in its bore; one along a face counts its edges."""
    outer = np.array([[0, 0], [4, 0], [4, 4], [0, 4], [0, 0]], float)
    surface = [np.stack([loop[:-1], loop[1:]], axis=1) for loop in (outer, 1.0 + 0.5 * outer)]
    comm = MPI.COMM_WORLD
    for middle, thickness in (([2.1, 0.01], 1.0), ([0.0, 0.0], 4.0), ([3.5, 0.0], 4.0)):
        assert thickness_at(comm, surface, np.array(middle), np.array([0.0, -1.0])) == (
            pytest.approx(thickness)
        )


@pytest.mark.parametrize("force", [1e-165, 1e-300])
def test_forces_whose_squares_are_zero_have_no_peak(force: float) -> None:
    """Python would report a division of zero by zero."""
    block = {**scenes.box("block", [1.0, 1.0], [10, 5], [-1.0, 0.0]), "hold": ["x", "rz"]}
    push = {"on": "block.y-", "traction": [0, force]}
    circle = {"sphere": {"center": [0, 6.0], "radius": 5.0}}
    contact = {"on": "block.y+", "obstacle": circle}
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        contact_app.solve(scenes.config("quadrilateral", [block], [push], [contact]))
