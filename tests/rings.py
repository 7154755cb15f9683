"""Two rings of one material, one in the other, and Lamé's answer for them."""

from pathlib import Path

from tests import meshfiles, scenes

YOUNG, POISSON = 2.0e5, 0.3
INNER, MIDDLE, OUTER = 5.0, 10.0, 20.0


def quarter(path: Path, inner: float, outer: float, counts: int = 6, straight: bool = False) -> str:
    """A quarter of a ring about the origin: x- inside, x+ outside.

    Its quadrilaterals have round edges, or straight ones.
    """
    bent = meshfiles.ring(inner, outer)
    block = meshfiles.block("quadrilateral", counts, 0.0)
    if straight:
        block.points = bent(block.points)
        return str(meshfiles.write(block, path))
    mesh = meshfiles.second_order(block, "quadrilateral", "quad9", bent)
    return str(meshfiles.write(mesh, path))


def fit(
    directory: Path,
    plane: str,
    radius: float = MIDDLE,
    counts: tuple[int, int] = (8, 12),
    straight: bool = False,
) -> scenes.Config:
    """A ring of an outer radius in a ring; held at their two planes of symmetry alone.

    The cells are of degree 2 with round edges, or of degree 1 with straight ones.
    """
    sizes = {"shaft": (INNER, radius), "hub": (MIDDLE, OUTER)}
    bodies = [
        {
            "name": name,
            "mesh": {"file": quarter(directory / f"{name}-{radius}.msh", *size, count, straight)},
            "degree": 1 if straight else 2,
            "material": {"young": YOUNG, "poisson": POISSON},
        }
        for (name, size), count in zip(sizes.items(), counts, strict=True)
    ]
    conditions = [
        {"on": f"{name}.{side}", "displacement": held}
        for name in sizes
        for side, held in (("y-", [None, 0.0]), ("y+", [0.0, None]))
    ]
    return {
        "dimension": plane,
        "bodies": bodies,
        "conditions": conditions,
        "contacts": [{"on": "hub.x-", "against": "shaft.x+"}],
        "solver": {"tolerance": 1e-9},
    }


def fit_pressure(plane: str, overlap: float) -> float:
    """Pressure between rings of one material that overlap by a length along the radius."""
    modulus = YOUNG / (1.0 - POISSON**2) if plane == "plane_strain" else YOUNG
    a, b, c = INNER**2, MIDDLE**2, OUTER**2
    return modulus * overlap / MIDDLE / ((c + b) / (c - b) + (b + a) / (b - a))
