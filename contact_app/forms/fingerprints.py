"""Fingerprints of forms and rows: a solve reuses stiffness, factors and rows where they are equal.

The matrix of a form is reused if its coefficients, constants, facet tags and mesh have the same
values, byte by byte, and the surfaces of contacts if their tags have. Rows are reused if all but
displacements and gaps are the same.
"""

from collections.abc import Iterator, Sequence
from hashlib import sha1
from itertools import chain
from typing import Any

import numpy as np
from mpi4py import MPI

from contact_app.forms.contacts import Contact
from solver.problem.constraints.conditions import ContactEntries, ContactRows, HeldRows


def fingerprint_of_form(form: Any, mesh: Any, contacts: Sequence[Contact] = ()) -> bytes:
    """Fingerprint of all values on this rank that a bilinear form and sides of contacts have."""
    return _digest(chain(_values_of_form(form, mesh), _values_of_tags(contacts)))


def fingerprint_of_rows(held: HeldRows, contact: ContactRows) -> bytes:
    """Fingerprint of held nodes and contact rows, without their right-hand sides."""
    return _digest(_values_of_rows(held, contact))


def all_equal(comm: MPI.Intracomm, one: bytes, other: bytes) -> bool:
    """Whether two fingerprints are equal on all ranks (collective)."""
    return bool(comm.allreduce(one == other, op=MPI.LAND))


def _digest(values: Iterator[Any]) -> bytes:
    digest = sha1(usedforsecurity=False)
    for value in values:
        array = np.ascontiguousarray(value)
        digest.update(f"{array.shape}{array.dtype}".encode())
        digest.update(array.data)
    return digest.digest()


def _values_of_form(form: Any, mesh: Any) -> Iterator[Any]:
    yield mesh.geometry.x
    for constant in form.constants():
        yield constant.value
    for coefficient in form.coefficients():
        yield coefficient.x.array
    for integral in form.integrals():
        data = integral.subdomain_data()
        for tags in data if isinstance(data, list | tuple) else [data]:
            yield from _arrays_of(tags)


def _values_of_tags(contacts: Sequence[Contact]) -> Iterator[Any]:
    for tags in {id(contact.facet_tags): contact.facet_tags for contact in contacts}.values():
        yield from _arrays_of(tags)


def _arrays_of(tags: Any) -> Iterator[Any]:
    for name in ("indices", "values"):
        if hasattr(tags, name):
            yield getattr(tags, name)


def _values_of_rows(held: HeldRows, contact: ContactRows) -> Iterator[Any]:
    yield from (held.nodes, held.held)
    for name, value in vars(contact).items():
        if isinstance(value, ContactEntries):
            yield from vars(value).values()
        elif name != "gaps":
            yield value
