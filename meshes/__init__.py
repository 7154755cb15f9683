"""Meshes of the bodies, cut into subdomains: regular splits of boxes and graph partitions."""

from meshes.decompose import BoxShape, decompose
from meshes.subdomains import Partition, Reference, Subdomain

__all__ = ["BoxShape", "Partition", "Reference", "Subdomain", "decompose"]
