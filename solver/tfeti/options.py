"""The tuned numbers of constraints and coarse problem."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TotalFetiOptions:
    """What was measured for each stands beside it; tests set them to reach every way.

    Attributes
    ----------
    many_subdomains
        Subdomains in space from which on gluing rows at cross points join neighbours alone: the
        coarse factor is half as large then. With fewer a coarse solve is nothing beside an operator
        application.
    pattern_rows, pattern_rows_on_ranks
        Rows of B that a pattern has to have, on average, for its calls to cost less than they save;
        on several ranks the other way, through the interface, takes two halos and a gather.
    other_rows
        Share of rows without a pattern up to which it pays to apply G pattern by pattern.
    gathered
        Coarse unknowns up to which every rank holds the whole factor and solves alone: one gather
        of the right-hand side costs less than the messages of a triangular solve in parts. Measured
        on two ranks: a solve takes 6 percent less at 48,000, 12 percent more at 94,000.
    factored
        Whether subdomains are factored and a coarse problem is made. Methods that solve for the
        displacements (`solver.primal`) need neither.
    chunk
        Entries of B that are taken at a time: 50 MB of Gᵀ.
    """

    many_subdomains: int = 100
    pattern_rows: int = 2000
    pattern_rows_on_ranks: int = 1000
    other_rows: float = 0.2
    gathered: int = 50_000
    chunk: int = 2**20
    factored: bool = True
