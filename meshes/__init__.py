"""Meshes of the bodies, cut into subdomains: regular splits of boxes and graph partitions."""

from meshes.box import BoxShape
from meshes.decompose import Shape, decompose
from meshes.refine import refined
from meshes.repair import Placement, load_mesh
from meshes.subdomains import Partition, Reference, Subdomain
from meshes.unstructured import CellMesh, MeshError

__all__ = [
    "BoxShape",
    "CellMesh",
    "MeshError",
    "Partition",
    "Placement",
    "Reference",
    "Shape",
    "Subdomain",
    "decompose",
    "load_mesh",
    "refined",
]
