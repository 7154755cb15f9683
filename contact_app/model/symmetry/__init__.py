"""Half a scene where the other half is its mirror image: `halved` cuts it at its planes.

`bodies` finds what the bodies are about a plane, `boundaries` where a boundary and its image are,
`items` compares conditions and contacts with their images, `halving` cuts the scene.
"""

from contact_app.model.symmetry.halving import Halving, halved

__all__ = ["Halving", "halved"]
