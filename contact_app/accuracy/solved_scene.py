"""A scene with its solution: the input of estimates, refinement and output."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

from contact_app.accuracy.contact_limits import pressed_contacts
from contact_app.accuracy.estimate.error_estimate import ErrorEstimator
from contact_app.accuracy.hertz import CoarsePressure, coarse_pressures
from contact_app.machine.timings import Timings
from contact_app.model.model import Model
from contact_app.results.fields import CellFields, NodeFields
from contact_app.results.output import Fields
from contact_app.results.overcome_friction import overcome_friction
from contact_app.results.rigid import placements_of
from contact_app.scene.rigid import Placement
from meshes.arrays import Array
from solver.contact.solution import Accuracy, Solution
from solver.qp.result import Reason
from solver.tfeti.friction_share import HOLDS

if TYPE_CHECKING:
    from contact_app.accuracy.guarantee.guarantee import Guarantee


@dataclass(frozen=True, eq=False)
class SolvedScene:
    """A solved scene: the model, the answer, its fields and its summary.

    `nodal` holds the recovered stresses at nodes by the names of their fields, if files of fields
    are written, `guaranteed` the guaranteed bound of the error, if the scene requests one, `holds`
    the share of the loads below which friction at the contact forces does not hold them.
    """

    model: Model
    solution: Solution
    nodes: NodeFields
    cells: CellFields
    accuracy: Accuracy
    timings: Timings
    nodal: dict[str, Array] = field(default_factory=dict)
    summary: dict[str, Any] = field(default_factory=dict)
    guaranteed: "Guarantee | None" = None
    holds: float = HOLDS

    @property
    def fields(self) -> Fields:
        """The fields that files of results hold."""
        return Fields(self.nodes, self.cells, self.nodal)

    @property
    def certified(self) -> bool:
        """Whether the answer is certified and has the guaranteed bound that its scene requests."""
        missing = self.guaranteed is not None and self.guaranteed.missing
        return self.solution.converged and not missing

    @property
    def interrupted(self) -> bool:
        """Whether the answer is the partial result of an interrupted solve."""
        return self.solution.reason is Reason.STOPPED and not self.solution.converged

    @cached_property
    def overcome(self) -> list[str]:
        """A sentence for each group of bodies that friction does not hold (collective)."""
        name_of = self.model.geometry.body_names.__getitem__
        return list(overcome_friction(self.model.problem, self.solution, name_of, self.holds))

    @cached_property
    def coarse_pressures(self) -> list[CoarsePressure | None]:
        """The contacts with few facets across (collective)."""
        return coarse_pressures(self.model, self.nodes, self.pressed)

    @cached_property
    def pressed(self) -> list[bool]:
        """Whether each contact carries a force above the solver's error (collective)."""
        return pressed_contacts(self.model.geometry, self.solution, self.nodes)

    @property
    def placements(self) -> list[Placement]:
        """Placement of each rigid body after its displacement by the answer (collective)."""
        return placements_of(self.model.geometry, self.model.problem, self.solution)

    @cached_property
    def estimator(self) -> ErrorEstimator:
        """Estimator of the distribution of the error of the answer."""
        return ErrorEstimator(self.model)

    def without_factors(self) -> "SolvedScene":
        """The answer without the factors of its model, which output does not need."""
        model = replace(self.model, problem=self.model.problem.without_factors())
        return replace(self, model=model)
