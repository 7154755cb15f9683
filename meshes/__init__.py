"""Meshes of the bodies, cut into subdomains: regular splits of boxes and graph partitions.

Input are boxes (`box`, `graded`) or mesh files; the product is a `Partition`: the subdomains of
each rank with their nodes and cells (`decompose`). `read` and `repair` read mesh files, `graph`
partitions a mesh, `load_balance` distributes the subdomains, and `refine` and `bisect` refine
(Rivara, 1984). `contact_surface`, `facing`, `mortar` (Puso, 2004) and `ties` hold the geometry of
contact between meshes that do not match. `symmetric_half` cuts a mesh at a plane of symmetry, and
`dolfinx_compat` covers the differences between releases of dolfinx.
"""

from meshes.box import BoxShape
from meshes.decompose import Shape, decompose
from meshes.refine import refined
from meshes.subdomains import Partition, Reference, Subdomain
from meshes.unstructured import CellMesh, MeshError

__all__ = [
    "BoxShape", "CellMesh", "MeshError", "Partition", "Reference", "Shape", "Subdomain", "arrays",
    "bisect", "box", "connected", "contact_surface", "crossing", "decompose", "dolfinx_compat",
    "facet_overlaps", "facet_search", "facing", "graded", "inner_surface", "merged_nodes", "mortar",
    "plane_cut", "point_location", "pseudo_inverses", "quadratic", "read", "refine", "refined",
    "repair", "rounded_refinement", "shares", "subdomains", "symmetric_half", "ties",
    "unstructured",
]  # fmt: skip
