"""Meshes of the bodies, cut into subdomains: regular splits of boxes and graph partitions.

`read` and `repair` read mesh files. `contact_surface`, `facing`, `mortar` and `ties` hold the
geometry of contact between meshes that do not match. `symmetric_half` cuts a mesh at a plane of
symmetry, and `dolfinx_compat` covers the differences between releases of dolfinx.
"""

from meshes.box import BoxShape
from meshes.decompose import Shape, decompose
from meshes.refine import refined
from meshes.subdomains import Partition, Reference, Subdomain
from meshes.unstructured import CellMesh, MeshError

__all__ = [
    "BoxShape",
    "CellMesh",
    "MeshError",
    "Partition",
    "Reference",
    "Shape",
    "Subdomain",
    "decompose",
    "refined",
]
