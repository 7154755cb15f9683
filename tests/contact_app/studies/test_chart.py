"""The chart of speed against accuracy: frontier, distances of solutions, small real charts."""

import csv
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contact_app.errors import ConfigurationError
from contact_app.scene.material import Material
from contact_app.studies import chart
from contact_app.studies.chart_figure import frontier
from contact_app.studies.chart_meshes import PEERS, plan_meshes
from contact_app.studies.fields_on_meshes import BodyNodes, PointsOfMesh
from contact_app.studies.processes import RunError
from contact_app.studies.reference import Distances, Fields, ReferenceAnswer, Sampled, extrapolate
from contact_app.studies.tables import read
from meshes.graded import graded_box
from tests import meshfiles, scenes
from tests.reference import solve as solve_reference
from tests.scenes import CONFIGS

NUMBERS = st.one_of(st.integers(0, 5).map(float), st.sampled_from([np.nan, np.inf]))


def points(directory: Path) -> list[dict[str, Any]]:
    """The files that a chart has written."""
    return read(directory / "frontier.csv", ("method", "cell", "tolerance"))


# --- the frontier


@given(st.lists(st.tuples(NUMBERS, NUMBERS), max_size=12))
def test_frontier_consists_of_undominated_points(points: list[tuple[float, float]]) -> None:
    seconds, errors = [p[0] for p in points], [p[1] for p in points]
    found = frontier(seconds, errors)
    finite = [i for i, p in enumerate(points) if np.isfinite(p).all()]

    def beats(a: int, b: int) -> bool:
        first, second = points[a], points[b]
        return first != second and first[0] <= second[0] and first[1] <= second[1]

    unbeaten = [i for i in finite if not any(beats(j, i) for j in finite)]
    assert {points[i] for i in found} == {points[i] for i in unbeaten}
    assert len({points[i] for i in found}) == len(found)
    assert [seconds[i] for i in found] == sorted(seconds[i] for i in found)
    assert [errors[i] for i in found] == sorted((errors[i] for i in found), reverse=True)


# --- distances of solutions


def _body(cell: str, degree: int, cells: int) -> BodyNodes:
    """A box [0, 2] x [0, 1] (x [0, 1]) whose grid lines are not even; y = 0 is its contact."""
    d = 3 if cell in ("hexahedron", "tetrahedron") else 2
    lines = [np.linspace(0.0, length, cells + 1) ** 1.3 for length in (2.0 ** (1 / 1.3), 1.0, 1.0)]
    mesh = graded_box(cell, lines[:d]).shape(degree)
    points = np.pad(mesh.points, ((0, 0), (0, 3 - d)))
    facets = mesh.topology.facets[mesh.sides["y-"]]
    return BodyNodes(cell, degree, points, mesh.cells, np.zeros(len(mesh.cells), np.int32), facets)


def test_pressure_is_continued_to_nodes_without_a_row() -> None:
    scene = scenes.read("block_2d")
    finest, coarse = _body("quadrilateral", 1, 8), _body("quadrilateral", 1, 2)
    floor = coarse.points[:, 1] == 0.0
    watched = floor & (coarse.points[:, 0] > 0.0)
    fields = Fields(coarse.points, np.zeros((9, 2)), 5.0 * watched, watched, np.array([0, 9]),
                    np.array([1]), np.array(["quadrilateral"]), [coarse.cells],
                    [coarse.tags])  # fmt: skip
    found = Distances(scene, (PointsOfMesh(finest),)).sample(fields).pressure[0]
    floor, end = finest.points[:, 1] == 0.0, finest.points[:, 0] == 0.0
    assert found[floor & ~end] == pytest.approx(5.0)
    assert found[floor & end] == pytest.approx(0.0, abs=1e-12)


def test_extrapolation_finds_rate_and_rest() -> None:
    scene = scenes.read("block_2d")
    distances = Distances(scene, (PointsOfMesh(_body("quadrilateral", 1, 4)),))
    limit = np.random.default_rng(0).normal(size=(25, 3))
    drift = np.random.default_rng(1).normal(size=(25, 3))

    def answer(h: float) -> Sampled:
        field = limit + h**2 * drift
        return Sampled([field[:, :2]], [field[:, 2]])

    reference = ReferenceAnswer.of(distances, [answer(0.4), answer(0.2), answer(0.1)])
    assert reference.rates == pytest.approx(2.0)
    left = distances.norms(answer(0.1), answer(0.0)) / reference.norms
    assert reference.accuracy[1:] == pytest.approx(left[1:])
    near = distances.norms(answer(0.2), answer(0.1)) / reference.norms
    assert reference.errors(answer(0.2))[1:] == pytest.approx(near[1:])
    assert reference.errors(answer(0.1))[0] == pytest.approx(reference.accuracy[0])
    assert "rate 2.00" in reference.describe()
    assert extrapolate(np.ones(3), np.ones(3))[0] == pytest.approx(0.25)


@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron", "quadrilateral", "triangle"])
@pytest.mark.parametrize("degree", [1, 2])
def test_clouds_hold_polynomials(cell: str, degree: int) -> None:
    """Evaluated exactly on another mesh; energy, volume and area of fields known."""
    coarse, fine = _body(cell, degree, 2), _body(cell, degree, 3)
    d, cloud = fine.dimension, PointsOfMesh(fine)

    def field(x: np.ndarray) -> np.ndarray:
        line = x[:, :d] @ np.array([1.0, -3.0, 0.7])[:d] + 2.0
        return np.column_stack([line**degree, -line])

    found = cloud.sample(coarse, field(coarse.points))
    assert found == pytest.approx(field(fine.points), abs=1e-10)
    linear = cloud.sample(coarse, field(coarse.points)[:, 1], first_order=True)
    assert linear[:, 0] == pytest.approx(field(fine.points)[:, 1], abs=1e-10)
    stretch = np.zeros((len(fine.points), d))
    stretch[:, 0] = 0.1 * fine.points[:, 0]
    modulus = 210.0 * 0.7 / (1.3 * 0.4)
    energy = cloud.energy(stretch, (Material(210.0, 0.3),), "plane_strain" if d == 2 else None)
    assert energy == pytest.approx(2.0 * modulus * 0.01)
    assert cloud.volume(stretch) == pytest.approx(0.01 * 8.0 / 3.0)
    assert cloud.areas.sum() == pytest.approx(2.0)
    assert cloud.areas @ fine.points[:, 0] == pytest.approx(2.0, rel=1e-9)


@pytest.mark.slow
def test_a_chart_of_a_mesh_from_a_file(tmp_path: Path) -> None:
    """Halved once the error is less, and refined where it is for as much takes fewer unknowns."""
    made = scenes.wall("triangle", 4)
    file = meshfiles.write(meshfiles.block("triangle", 8), tmp_path / "block.msh")
    made["bodies"][0] |= {
        "mesh": {"file": str(file)},
        "material": {
            "soft": {"young": 500, "poisson": 0.3},
            "hard": {"young": 1e3, "poisson": 0.3},
        },
    }
    config = scenes.write(made, tmp_path / "block.yaml")
    sweep = chart.plan(config, largest=1_000)
    assert any("mesh from a file" in sentence for sentence in sweep.left_out)
    assert any("peers" in sentence for sentence in sweep.left_out)
    usual = [v for v in sweep.variants if v == chart.Variant(v.factor, v.cell)]
    usual += [v for v in sweep.variants if v.accuracy == 0.05 and v.degree == 2]
    list(chart.chart(config, tmp_path, replace(sweep, variants=tuple(usual))))
    given, halved, adaptive = points(tmp_path)
    assert adaptive["method"] == "contact-app accuracy 0.05"
    assert 0.4 < halved["error_energy"] / given["error_energy"] < 0.8
    assert 0.1 < halved["error_displacement"] / given["error_displacement"] < 0.6
    assert adaptive["error_energy"] < 0.05


# --- charts


def test_a_patch_whose_answer_every_mesh_holds_has_no_error(tmp_path: Path) -> None:
    """Uniform compression: errors are those of the solvers, peers included."""
    config = CONFIGS / "block_2d.yaml"
    sweep = chart.plan(config, largest=140)
    usual = {(v.cell, v.method): v for v in sweep.variants if v == chart.Variant(
        v.factor, v.cell, method=v.method)}  # fmt: skip
    chosen = [usual["triangle", "contact-app"], usual["quadrilateral", "tao-bnls"]]
    sweep = chart.Sweep(sweep.scene, tuple(chosen), sweep.references, sweep.left_out)
    told = list(chart.chart(config, tmp_path, sweep))
    rows = points(tmp_path)
    assert len(rows) == sum(p.row is not None for p in told)
    assert ("contact-app", "triangle") in {(r["method"], r["cell"]) for r in rows}
    if len(rows) < len(chosen):  # TAO's bnls of PETSc 3.22 crashes on this scene: that is told
        assert any("tao-bnls" in p.text for p in told if p.row is None)
    for row in rows:
        assert row["error_energy"] < 1e-5
        assert row["error_displacement"] < 1e-5
        assert row["error_pressure"] < 1e-5
        assert row["seconds"] > 0.0
        assert row["dofs"] == 132
    with (tmp_path / "frontier.csv").open() as file:
        assert next(csv.reader(file)) == list(chart.COLUMNS)
    assert (tmp_path / "frontier.png").stat().st_size > 10_000


@pytest.mark.slow
def test_refinement_to_an_accuracy_is_a_point(tmp_path: Path) -> None:
    """Graded cells under a punch: the error measured is below what was asked for."""
    config = CONFIGS / "flat_punch.yaml"
    sweep = chart.plan(config, largest=1_000, peers=False)
    adaptive = {v.accuracy: v for v in sweep.variants if v.accuracy}
    assert set(adaptive) == set(chart.ACCURACIES)
    few = [adaptive[0.2], adaptive[0.1]]
    assert not any("degree" in o for v in few for o in v.overrides(sweep.scene))
    sweep = chart.Sweep(sweep.scene, tuple(few), sweep.references, ())
    list(chart.chart(config, tmp_path, sweep))
    for row, asked in zip(points(tmp_path), (0.2, 0.1), strict=True):
        assert row["method"] == f"contact-app accuracy {asked:g}"
        assert 0.2 * asked < row["error_energy"] < asked
        assert row["degree"] == 2


def test_an_interrupted_chart_writes_its_finished_rows(tmp_path: Path) -> None:
    config = CONFIGS / "block_2d.yaml"
    sweep = chart.plan(config, largest=1000, peers=False)
    done = []

    def point(_config, _sweep, variant, *_rest):
        if variant.cell == "triangle":
            raise RunError("not done after 1 s")
        if len(done) == 4:
            raise KeyboardInterrupt
        done.append(variant)
        return dict.fromkeys(chart.COLUMNS, 1.0) | {"method": "contact-app", "cell": variant.cell}

    def reference(*_arguments):
        yield chart.Progress("reference")
        return ReferenceAnswer(None, None, np.ones(3), np.ones(3), np.ones(3))

    with pytest.raises(KeyboardInterrupt):
        list(chart.chart(config, tmp_path, sweep, runs=chart.Runs(reference, point)))
    assert len(points(tmp_path)) == 4
    assert (tmp_path / "frontier.png").exists()


def test_settings_that_a_scene_does_not_allow_are_reported(tmp_path: Path) -> None:
    path = scenes.write(scenes.two_bodies("hexahedron", 2), tmp_path / "two.yaml")
    sweep = chart.plan(path, largest=20_000)
    assert any("peers" in sentence for sentence in sweep.left_out)
    assert not any(v.method != "contact-app" for v in sweep.variants)
    degrees = {v.degree for v in sweep.variants}
    assert (2 in degrees) != any(s.startswith("degree 2:") for s in sweep.left_out)
    with pytest.raises(ConfigurationError, match="one kind of cell"):
        chart.plan(CONFIGS / "three_bodies.yaml")
    with pytest.raises(ConfigurationError, match="more than 10 degrees"):
        chart.plan(CONFIGS / "cube.yaml", largest=10)
    with pytest.raises(ConfigurationError, match="unknown"):
        chart.plan(CONFIGS / "cube.yaml", ["unknown=1"])


def test_cells_are_scaled_to_whole_numbers() -> None:
    assert chart.scaled((20, 8), Fraction(1, 4)) == (5, 2)
    with pytest.raises(ValueError, match="1/8"):
        chart.scaled((20, 8), Fraction(1, 8))


# --- peers on whole systems


@pytest.mark.parametrize(("name", "cells"), [("sphere", "[4,4,3]"), ("tilted_plane", "[20,3,3]")])
def test_peers_solve_scenes_with_turned_frames(name: str, cells: str) -> None:
    """Bounds in turned frames against the reference that keeps the rows."""
    from contact_app.studies.peers import solve

    overrides = [f"bodies.0.mesh.box.cells={cells}"]
    scene = scenes.read(name, overrides)
    expected = solve_reference(scene)
    row, system, x = solve(scene, "snes-vi-cholmod", 1e-10)
    assert row["energy"] == pytest.approx(expected.energy, rel=1e-8)
    assert row["penetration"] < 1e-10
    order, other = (np.lexsort(p.round(9).T) for p in (system.points, expected.points))
    size = np.abs(expected.u).max()
    assert system.displacement(x)[order] == pytest.approx(expected.u[other], abs=1e-7 * size)
    assert system.force(x).max() > 0.0


@pytest.mark.parametrize("degree", [1, 2])
def test_fields_of_a_peer_belong_to_the_mesh_in_the_file(tmp_path: Path, degree: int) -> None:
    """A block of tetrahedra pressed on a floor without friction: the pressure is uniform.

    Nodal forces of degree 2 are zero at vertices; the pressure there comes from those about them.
    """
    from contact_app.studies.peer_fields import about_vertices, fields_of_peer
    from contact_app.studies.peers import solve

    file = meshfiles.write(meshfiles.block("tetrahedron", 4), tmp_path / "block.msh")
    made = scenes.config(
        "tetrahedron",
        [{"name": "block", "mesh": {"file": str(file)}, "degree": degree,
          "material": {"young": 100.0, "poisson": 0.0}}],
        [{"on": "block.x-", "displacement": [0, None, None]},
         {"on": "block.y-", "displacement": [None, 0, None]},
         {"on": "block.z+", "displacement": [None, None, -0.02]}],
        [{"on": "block.z-", "obstacle": {"plane": {"point": [0, 0, 0], "normal": [0, 0, 1]}}}],
    )  # fmt: skip
    scene = scenes.build(made)
    row, system, x = solve(scene, "snes-vi-cholmod", 1e-12, nodal=True)
    fields = fields_of_peer(scene, system, x)
    assert fields is not None
    assert row["converged"]
    shape = scene.bodies[0].mesh.shape(degree)
    assert fields.points == pytest.approx(shape.points, abs=1e-12)
    assert fields.displacement[:, 2] == pytest.approx(-0.02 * shape.points[:, 2], abs=1e-9)
    corners = np.isin(np.arange(shape.nodes), shape.cells[:, :4])
    pressed = corners & (shape.points[:, 2] < 1e-9)
    assert fields.pressure[pressed] == pytest.approx(2.0, rel=1e-6)
    assert not fields.pressure[~pressed].any()
    assert (fields.watched == pressed).all()
    assert (fields.nodes(0).cells == shape.cells).all()
    if degree == 2:
        ones = np.ones(shape.nodes)
        assert about_vertices(shape, ones).sum() == pytest.approx(shape.nodes)
        assert not about_vertices(shape, ones)[~corners].any()


def test_a_chart_of_drawn_meshes_runs_each_with_both_degrees(tmp_path: Path) -> None:
    config = CONFIGS / "pillow_block.yaml"
    shipped = CONFIGS.parent / "meshes" / "samples"
    sweep = plan_meshes(config, [], [shipped], [shipped] * 3, largest=20_000)
    own = {(v.degree, v.method) for v in sweep.variants}
    assert own == {(p, m) for p in (1, 2) for m in ("contact-app", *PEERS)}
    assert sweep.variants[0].kind == replace(sweep.variants[0], settings=()).kind
    assert sweep.scene.title.endswith("case pushed")  # the last load case
    settings = sweep.overrides(sweep.variants[0])
    assert "bodies.0.degree=1" in settings
    assert f"bodies.0.mesh.file={shipped.resolve()}/pillow_block.msh" in settings
    assert {v.degree for v in sweep.references} == {2}
    few = plan_meshes(config, [], [shipped], [shipped] * 3, largest=5_000, peers=False)
    assert [v.degree for v in few.variants] == [1]
    for wrong, most, reason in (
        ([shipped] * 2, 20_000, "3 references"),
        ([tmp_path / "none"] * 3, 20_000, "no such directory"),
        ([shipped] * 3, 100, "more than 100"),
    ):
        with pytest.raises(ConfigurationError, match=reason):
            plan_meshes(config, [], [shipped], wrong, largest=most)


def test_peers_refuse_two_bodies() -> None:
    from contact_app.studies.undecomposed import UnsuitableError, assemble

    scene = scenes.read("three_bodies")
    with pytest.raises(UnsuitableError, match="bodies"):
        assemble(scene)
