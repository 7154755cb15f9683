"""The number of classes in a summary does not depend on which of them share a factor."""

from types import SimpleNamespace

from mpi4py import MPI

from contact_app.results.summary import distinct_classes
from solver.tfeti.subdomain.classes import subdomain_class, subdomain_classes
from tests.solver.tfeti.test_similar import data, turned


def test_a_class_with_a_shared_factor_and_with_its_own_counts_once() -> None:
    given = [data((3, 2, 1)), data(turned((3, 2, 1)))]
    shared, own = subdomain_classes(given), [subdomain_class(one) for one in given]
    assert (shared[1].stiffness != own[1].stiffness).nnz  # by round-off
    problem = SimpleNamespace(comm=MPI.COMM_SELF, classes=[*shared, *own])
    assert distinct_classes(problem) == 2  # type: ignore[arg-type]
