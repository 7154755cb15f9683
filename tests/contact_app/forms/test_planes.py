"""Planes of symmetry that Dirichlet conditions of forms make: as in scenes."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import contact_app
from contact_app import Contact, ContactProblem, Sphere
from tests import form_problems as problems
from tests.ranks import execute

SIZES, CELLS = (2.0, 2.0, 1.5), (6, 6, 4)


def pressed(cell: str, held_at: float = 0.0) -> ContactProblem:
    """A ball or roller on the corner of a quarter or half model."""
    d = 2 if cell in ("quadrilateral", "triangle") else 3
    mesh = problems.box(
        cell, (*CELLS[: d - 1], CELLS[-1]), (*SIZES[: d - 1], SIZES[-1]), MPI.COMM_WORLD
    )
    V = problems.vector_space(mesh, 1)
    up, tags = d - 1, problems.facet_tags(mesh, {1: lambda x: np.isclose(x[d - 1], SIZES[-1])})
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    rule = {"quadrature_degree": 1 if cell in ("triangle", "tetrahedron") else 2}
    dx = ufl.Measure("dx", domain=mesh, metadata=rule)
    a = ufl.inner(problems.isotropic(u, 1000.0, 0.3), problems.strain(v)) * dx
    L = ufl.inner(fem.Constant(mesh, np.zeros(d)), v) * dx
    bcs = [problems.held(V, lambda x: np.isclose(x[up], 0.0))]
    for axis in range(d - 1):
        bcs.append(problems.held(V, lambda x, i=axis: np.isclose(x[i], 0.0), axis, held_at))
    center = (*(0.0,) * (d - 1), SIZES[-1] + 4.0)
    ball = Contact(tags, 1, Sphere(center, 4.0), interference=0.1)
    return ContactProblem(a, L, bcs, [ball], tolerance=1e-10)


@pytest.mark.parametrize("cell", ["quadrilateral", "triangle", "hexahedron", "tetrahedron"])
def test_smoothed_pressures_at_planes_are_those_of_a_scene(cell: str) -> None:
    problem = pressed(cell)
    problem.solve()
    d = 2 if cell in ("quadrilateral", "triangle") else 3
    sizes, cells = (*SIZES[: d - 1], SIZES[-1]), (*CELLS[: d - 1], CELLS[-1])
    last, rollers = "xyz"[d - 1], []
    for axis in range(d - 1):
        value = [0.0 if k == axis else None for k in range(d)]
        rollers.append({"on": f"body.{'xyz'[axis]}-", "displacement": value})
    box = {"lower": [0] * d, "upper": list(sizes), "cells": list(cells), "cell": cell}
    material = {"young": 1000.0, "poisson": 0.3}
    ball = {"center": [0.0] * (d - 1) + [sizes[-1] + 4.0], "radius": 4.0}
    foot = {"on": f"body.{last}-", "displacement": [0] * d}
    scene = contact_app.solve({
        "dimension": d, "solver": {"tolerance": 1e-10}, "conditions": [foot, *rollers],
        "bodies": [{"name": "body", "mesh": {"box": box}, "material": material}],
        "contacts": [{"on": f"body.{last}+", "obstacle": {"sphere": ball}, "interference": 0.1}],
    })  # fmt: skip
    one, other = problem.summary["contacts"][0], scene.summary["contacts"][0]
    for key in ("max_pressure", "max_smoothed_pressure"):
        assert one[key] == pytest.approx(other[key], rel=1e-6), key
    mine, theirs = (
        [
            w.partition("; for bodies large")[0]  # its pressure needs the moduli of a scene
            for w in s["certificate"]["warnings"]
            if "facets" in w
        ]
        for s in (problem.summary, scene.summary)
    )
    assert mine == theirs


def test_other_conditions_make_no_plane() -> None:
    """A face that is moved along its normal has no mirror image."""
    problem = pressed("quadrilateral", held_at=1e-9)
    problem.solve()
    moved = problem.summary["contacts"][0]["max_smoothed_pressure"]
    problem = pressed("quadrilateral")
    problem.solve()
    assert abs(moved / problem.summary["contacts"][0]["max_smoothed_pressure"] - 1.0) > 1e-3


PROGRAM = """
from tests.contact_app.forms.test_planes import pressed
problem = pressed("hexahedron")
problem.solve()
print(problem.summary["contacts"][0]["max_smoothed_pressure"])
"""


def test_planes_on_ranks() -> None:
    one, two = (execute(PROGRAM, ranks=n).split() for n in (1, 2))
    assert [float(v) for v in two] == pytest.approx(2 * [float(one[0])], rel=1e-8)
