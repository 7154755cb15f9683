"""The tuned numbers of constraints and coarse problem."""

from dataclasses import dataclass


@dataclass(frozen=True)
class TotalFetiOptions:
    """Tuned numbers, each with the measured reason; tests set them to reach every branch."""

    many_subdomains: int = 100
    """Number of subdomains in space from which on gluing rows at cross points join neighbours
    alone: this halves the coarse factor. With fewer subdomains a coarse solve takes no time beside
    an operator application."""
    gathered: int = 50_000
    """Number of coarse unknowns up to which every rank holds the whole factor and solves alone:
    one gather of the right-hand side takes less time than the messages of a distributed
    triangular solve. Measured on two ranks: a solve takes 6 percent less at 48,000, 12 percent
    more at 94,000."""
    chunk: int = 2**20
    """Entries of B in one chunk: 50 MB of Gᵀ."""
    factored: bool = True
    """Whether subdomains are factored and a coarse problem is made. Methods that solve for the
    displacements (`solver.primal`) need neither."""
