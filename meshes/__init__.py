"""Meshes of the bodies, cut into subdomains: regular splits of boxes and graph partitions.

Files are read by `meshes.repair`, which boxes do without.
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
