"""Symmetric scenes: `halved` cuts a scene at its planes of symmetry.

If bodies, conditions and contacts are mirror images of each other about a plane, so is the answer:
one half of the scene is solved, and its displacement normal to the plane is zero there. Input is a
`Scene`; the product is a `Halving`: the scene that is solved, with its planes, and one sentence per
axis with the cut or the reason why there is none. `bodies` finds the symmetry of bodies about a
plane, `boundaries` that of boundaries. `items` compares conditions and contacts with their mirror
images, and `halving` cuts the scene. `contact_app.results.mirror` completes the answer.
"""

from contact_app.model.symmetry.halving import Halving, halved

__all__ = ["Halving", "halved"]
