"""Symmetric scenes: `halved` cuts a scene at its planes of symmetry.

`bodies` finds the symmetry of bodies about a plane, `boundaries` that of boundaries. `items`
compares conditions and contacts with their mirror images, and `halving` cuts the scene.
"""

from contact_app.model.symmetry.halving import Halving, halved

__all__ = ["Halving", "halved"]
