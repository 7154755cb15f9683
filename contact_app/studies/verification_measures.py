"""Measures of answers of `verification`, with the numbers of the theory."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import brentq

from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.run.increments import SolvedIncrement
from contact_app.studies.exact_fields import lame_ring, relative_errors
from contact_app.studies.hertz import Quantity, fitted, hertz_quantities


def roller(solved: SolvedScene) -> list[Quantity]:
    """Two elastic cylinders: the fitted numbers for R = 50, F' = 35 kN/mm, E = 210e3 on 70e3."""
    force, radius = 35_000.0, 50.0
    modulus = 1.0 / sum(
        (1.0 - m.poisson**2) / m.young for b in solved.model.scene.bodies for m in b.materials
    )
    half_width = np.sqrt(4.0 * force * radius / (np.pi * modulus))
    peak = 2.0 * force / (np.pi * half_width)
    nodes = solved.nodes
    half_width_fitted, top = fitted(nodes.points[:, 0] ** 2, nodes.contact_pressure)
    return [
        Quantity("half-width a", half_width_fitted, float(half_width)),
        Quantity("peak pressure p0", top, float(peak)),
        Quantity("largest nodal pressure", float(nodes.contact_pressure.max()), float(peak)),
    ]


def rough_roller(increments: Sequence[SolvedIncrement]) -> list[Quantity]:
    """`roller` at the end of the increments with friction, and the peak of the smoothed field."""
    solved = increments[-1].solved
    numbers, smoothed = roller(solved), solved.nodes.smoothed_contact_pressure
    return [*numbers, Quantity("largest smoothed", float(smoothed.max()), numbers[1].theory)]


def punch(solved: SolvedScene) -> list[Quantity]:
    """p(x) = P/(π √(a² - x²)) on the inner half of a punch of half-width a = 1 (half model)."""
    nodes, half_width = solved.nodes, 1.0
    load = 2.0 * abs(solved.summary["solution"]["contact_force"][1])
    x = nodes.points[:, 0]
    inner = (nodes.contact_pressure > 0.0) & (x <= 0.5 * half_width + 1e-9)
    shape = np.pi * np.sqrt(half_width**2 - x[inner] ** 2) / load
    scaled = nodes.contact_pressure[inner] * shape
    off = float(np.sqrt(np.mean((scaled - 1.0) ** 2)))
    return [
        Quantity("inner half, 1 + rms", 1.0 + off, 1.0),
        Quantity("in the middle", float(scaled[np.argmin(x[inner])]), 1.0),
    ]


def press_fit(solved: SolvedScene) -> list[Quantity]:
    """p = E δ/(b (1 + ν)(1 - 2ν)), to first order in δ/b."""
    scene, pressure = solved.model.scene, solved.nodes.contact_pressure
    (material,) = scene.bodies[0].materials
    hole, excess = 10.0, 0.01
    poisson = material.poisson
    exact = material.young * excess / (hole * (1.0 + poisson) * (1.0 - 2.0 * poisson))
    touching = pressure[pressure > 0.0]
    return [
        Quantity("mean pressure", float(touching.mean()), exact),
        Quantity("largest nodal pressure", float(touching.max()), exact),
    ]


def fit(solved: SolvedScene) -> list[Quantity]:
    """p = E δ/(2 R) (1 - R²/Rₒ²), δ = 0.01, R = 10 and Rₒ = 20, by the force on the quarter."""
    (material,) = solved.model.scene.bodies[0].materials
    exact = material.young * 0.01 / 20.0 * (1.0 - 0.25)
    (contact,) = solved.summary["contacts"]
    pressure = solved.nodes.contact_pressure
    return [
        Quantity("mean pressure", contact["force"][0] / 10.0, exact),
        Quantity("largest nodal pressure", float(pressure.max()), exact),
    ]


def round_fit(solved: SolvedScene) -> list[Quantity]:
    """The numbers of `fit` for straight edges, from the smoothed pressure."""
    mean, single = fit(solved)
    (contact,) = solved.summary["contacts"]
    return [mean, Quantity("largest smoothed", contact["max_smoothed_pressure"], single.theory)]


def cantilever(solved: SolvedScene) -> list[Quantity]:
    """Pure bending: displacement M L²/(2 E I) of the end, and energy M² L/(2 E I), I = h³/12."""
    (material,) = solved.model.scene.bodies[0].materials
    moment, length, height = 5000.0, 100.0, 10.0
    stiffness = material.young * height**3 / 12.0
    end = solved.summary["probes"]["end"]["displacement"]
    return [
        Quantity("deflection", -end[1], moment * length**2 / (2.0 * stiffness)),
        Quantity(
            "strain energy", -solved.summary["solution"]["energy"],
            moment**2 * length / (2.0 * stiffness),
        ),
    ]  # fmt: skip


def rigid_ball(solved: SolvedScene) -> list[Quantity]:
    """A rigid ball on an elastic block, of which a quarter is modelled: a³ = 3 F R/(4 E*).

    The approach is that of a layer as deep as the block.
    """
    scene, nodes = solved.model.scene, solved.nodes
    (material,), radius = scene.bodies[0].materials, 30.0
    modulus = material.young / (1.0 - material.poisson**2)
    force = 4.0 * abs(solved.summary["contacts"][0]["force"][2])
    half_width = (0.75 * force * radius / modulus) ** (1.0 / 3.0)
    peak = 1.5 * force / (np.pi * half_width**2)
    half_width_fitted, top = fitted((nodes.points[:, :2] ** 2).sum(axis=1), nodes.contact_pressure)
    approach = -solved.summary["rigid_bodies"]["ball"]["displacement"][2]
    return [
        Quantity("force", force, 1500.0),
        Quantity("half-width a", half_width_fitted, half_width),
        Quantity("peak pressure p0", top, peak),
        Quantity("approach", approach, approach_to_layer(force, radius, modulus, material.poisson)),
    ]


def approach_to_layer(force: float, radius: float, modulus: float, poisson: float) -> float:
    """Approach of a rigid ball and an elastic layer 20 deep that is fixed to a rigid base.

    F = 4/3 E* √R δ^(3/2) (1 - 2 α x + (2 α x)² - 8 (α³ + 4 π² β/15) x³) with x = √(R δ)/(π depth),
    of Dimitriadis and others, Biophysical Journal 82 (2002) 2798. Here √(R δ) is 0.12 of the depth,
    and the next term is below 1e-4.
    """
    depth = 20.0
    alpha = -(1.2876 - 1.4678 * poisson + 1.3442 * poisson**2) / (1.0 - poisson)
    beta = (0.6387 - 1.0277 * poisson + 1.5164 * poisson**2) / (1.0 - poisson)

    def excess(approach: float) -> float:
        x = np.sqrt(radius * approach) / depth / np.pi
        cubic = alpha**3 + 4.0 * np.pi**2 * beta / 15.0
        series = 1.0 - 2.0 * alpha * x + (2.0 * alpha * x) ** 2 - 8.0 * cubic * x**3
        return float(4.0 / 3.0 * modulus * np.sqrt(radius) * approach**1.5 * series - force)

    deepest = (0.75 * force / modulus) ** (2.0 / 3.0) / radius ** (1.0 / 3.0)
    return float(brentq(excess, 0.5 * deepest, deepest))


def rough_rod(solved: SolvedScene) -> list[Quantity]:
    """Displacement of the end F² / (2 E A s), and length F / s that slips."""
    force, height, young, limit = 10.0, 0.5, 1000.0, 0.2
    nodes = solved.nodes
    end = np.isclose(nodes.points[:, 0], nodes.points[:, 0].max())
    floor = np.isclose(nodes.points[:, 1], 0.0)
    slips = floor & (nodes.displacement[:, 0] > 1e-6 * nodes.displacement[end, 0].max())
    length = nodes.points[end, 0].max() - nodes.points[slips, 0].min()
    return [
        Quantity("u", float(nodes.displacement[end, 0].mean()),
                 force**2 / (2.0 * young * height * limit)),
        Quantity("slip length", float(length), force / limit),
    ]  # fmt: skip


def rough_plate(solved: SolvedScene) -> list[Quantity]:
    """Displacements of five points of the foot in µm, beside published means of several programs.

    Code_Aster, validation manual V6.04.128 (SSNV128), after R. A. Feijóo, H. J. C. Barbosa, N.
    Zouain, *Numerical formulations for contact problems with friction*, J. Theor. Appl. Mech. 7,
    1988.
    """
    published = {"A": 28.6, "B": 27.2, "C": 22.8, "D": 19.8, "E": 15.0}
    probes = solved.summary["probes"]
    return [
        Quantity(f"u of {name}, µm", 1e3 * probes[name]["displacement"][0], point_name)
        for name, point_name in published.items()
    ]


def column(solved: SolvedScene) -> list[Quantity]:
    """Stress M ε with M = E (1 - ν)/((1 + ν)(1 - 2ν)), by a strain of 1 %."""
    (material,) = solved.model.scene.bodies[0].materials
    poisson = material.poisson
    modulus = material.young * (1.0 - poisson) / ((1.0 + poisson) * (1.0 - 2.0 * poisson))
    solution = solved.summary["solution"]
    force = abs(solution["contact_force"][2])
    return [
        Quantity("modulus", force / 0.01, modulus),
        Quantity("largest nodal pressure", solution["max_contact_pressure"] / 0.01, modulus),
    ]


def ring(solved: SolvedScene) -> list[Quantity]:
    """Lamé's ring: radii 10 and 20, pressure 100 inside, displacement 0.01 inwards outside."""
    (material,) = solved.model.scene.bodies[0].materials
    u, sigma, outside = lame_ring(material.young, material.poisson, (10.0, 20.0), 100.0, 0.01)
    errors = relative_errors(solved, u, sigma)
    pressure = solved.nodes.contact_pressure
    touching = pressure[pressure > 0.0]
    return [
        Quantity("1 + error of displacement", 1.0 + errors[0], 1.0),
        Quantity("1 + error of stress", 1.0 + errors[1], 1.0),
        Quantity("mean pressure", float(touching.mean()), outside),
        Quantity("largest nodal pressure", float(touching.max()), outside),
    ]


def hertz_profile(solved: SolvedScene) -> list[Quantity]:
    """Hertz's quantities, and the profile within the contact."""
    quantities = hertz_quantities(solved)
    half_width, peak = quantities[0].theory, quantities[1].theory
    nodes, d = solved.nodes, solved.model.scene.dimension
    r2 = (nodes.points[:, : d - 1] ** 2).sum(axis=1)
    inner = (nodes.contact_pressure > 0.0) & (r2 < (0.8 * half_width) ** 2)
    exact = peak * np.sqrt(1.0 - r2[inner] / half_width**2)
    off = float(np.abs(nodes.contact_pressure[inner] - exact).max() / peak)
    return [*quantities[:3], Quantity("1 + error of the profile", 1.0 + off, 1.0), *quantities[3:]]
