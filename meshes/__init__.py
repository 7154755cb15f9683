"""Meshes of the bodies, cut into subdomains: regular splits of boxes and graph partitions.

Files are read by `read` and `repair`, which boxes do without. `contact_surface`, `facet_overlaps`,
`mortar` and `ties` have the geometry of contact between meshes that do not match,
`symmetric_half` cuts a mesh at a plane of symmetry, `dolfinx_compat` has what differs between
releases of dolfinx.
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
