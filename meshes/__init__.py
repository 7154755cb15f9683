"""Meshes of the bodies, cut into subdomains: regular splits of boxes and graph partitions."""

from meshes.box import BoxShape
from meshes.decompose import decompose
from meshes.subdomains import Partition, Reference, Subdomain

__all__ = ["BoxShape", "Partition", "Reference", "Subdomain", "decompose"]
