"""Models of increments: slip is measured from the end of the last one.

Apart from the slip, an increment is a load case of the model that all increments share
(`run.case_models`). An increment begins with the nearest combination of earlier multipliers, or
with those of the last increment.
"""

from collections.abc import Callable
from copy import copy
from dataclasses import replace

import numpy as np
from mpi4py import MPI

from contact_app.accuracy.estimate.error_estimate import ErrorEstimator
from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.machine.timings import Timings
from contact_app.model.candidates import Needed
from contact_app.model.method import is_undecomposed, with_chosen_method
from contact_app.model.model import Model
from contact_app.model.normal_forces import NormalForces
from contact_app.model.outline import Report
from contact_app.results.friction import moved_by_held
from contact_app.run.case_models import CaseModels
from contact_app.run.fallback import fewest_subdomains
from contact_app.run.placing import SameRows
from contact_app.scene.rigid import RigidBodies
from contact_app.scene.scene import Decomposition, Scene
from meshes.arrays import Array
from solver.contact.options import Method, SolverOptions
from solver.contact.solution import Guess
from solver.tfeti.derived import beside_moved

Displacements = list[Array]
"""One (n, members) array per class."""


class IncrementModels:
    """Makes the models of increments, and stores the last answer; methods are collective.

    Attributes
    ----------
    scene
        The scene with the method that `auto` chooses, in the subdomains of the first answer.
    """

    def __init__(self, scene: Scene, comm: MPI.Intracomm) -> None:
        self.scene = with_chosen_method(scene)
        self._comm, self._models = comm, CaseModels(self.scene, comm)
        self._rough = scene.has_friction
        self._displacements: Displacements | None = None
        self._earlier: Callable[[list[tuple[int, int]]], Displacements] | None = None
        self._rows: SameRows | None = None
        self._last: RigidBodies | None = None
        self._pressed: NormalForces | None = None
        self._of_nodes, self._of_rigid = np.zeros((0, 0)), Displacements()
        self._order: tuple[Decomposition, bool] | None = None
        self._before: SameRows | None = None
        self._jumps = np.zeros(0)

    @property
    def displacements(self) -> Displacements | None:
        """Displacements from which slip is measured; None before the first increment."""
        return self._displacements

    @property
    def last(self) -> RigidBodies | None:
        """The rigid bodies under the loads of the last increment; None before the first one."""
        return self._last

    @property
    def keeps_subdomains(self) -> bool:
        """Whether slip is measured from an earlier answer."""
        earlier = self._displacements is not None or self._earlier is not None
        return self._rough and earlier

    def go_on(
        self,
        last: RigidBodies,
        read: Callable[[list[tuple[int, int]]], Displacements],
        pressed: NormalForces,
    ) -> None:
        """Continue from displacements and normal forces of an earlier run.

        Parameters
        ----------
        last
            The rigid bodies under the loads of that time.
        read
            Returns the displacements, (n, members) for each class, given their shapes (collective).
        """
        self._last, self._earlier, self._pressed = last, read, pressed

    def model(self, scene: Scene, timings: Timings, needed: Needed, report: Report | None) -> Model:
        """The model of an increment, with slip measured from the last one."""
        model = self._models.model(scene, timings, needed, report)
        problem = model.problem
        if self._earlier is not None:
            self._displacements = self._earlier([(len(f), f.shape[1]) for f in problem.forces])
            self._earlier = None
            self._store_order(model, self._displacements)
        begin, order = self._displacements, _order(scene.decomposition, scene.solver)
        if self._rough and self._order not in (None, order):
            begin = _in_order_of(model, self._of_nodes, self._of_rigid)
        if begin is not None:
            problem = problem.with_least_motion_from(begin)
        if self._rough and begin is not None:
            problem = problem.with_slip_from(begin)
            if scene.rigid.bodies:
                moved = moved_by_held(model.geometry, problem, self._last, slips=True)
                problem = beside_moved(problem, moved)
        return replace(model, problem=problem, pressed_before=self._pressed)

    def approach(self, model: Model) -> Array:
        """Penetrations (dual,) that held components of rigid bodies add in the increment."""
        return moved_by_held(model.geometry, model.problem, self._last)

    def estimator(self, model: Model) -> ErrorEstimator:
        """The estimator of errors of answers to a model."""
        return self._models.estimator(model)

    def by_other_method(self) -> Scene | None:
        """The scene by Total FETI if multigrid solves it, and by multigrid otherwise (collective).

        Total FETI has the fewest subdomains there can be. None if it needs too much memory.
        """
        scene = self.scene
        if not is_undecomposed(scene.solver):
            return scene.solved_by(method="primal")
        scene = scene.solved_by(method="auto")
        if scene.decomposition.subdomains is not None:
            return scene
        fewest = fewest_subdomains(scene.bodies, scene.decomposition, None, self._comm)
        return None if fewest is None else replace(scene, decomposition=fewest)

    def following(self, scene: Scene, decomposition: Decomposition, method: Method) -> Scene:
        """The scene of a history in the subdomains of its last answer.

        Slip is measured from the displacements of subdomains. If an increment was certified by
        another method only, the next ones have the method and the subdomains of that answer.

        Parameters
        ----------
        decomposition, method
            Those of an answer.
        """
        options = replace(scene.solver, method="active-set" if method == "auto" else method)
        order = _order(decomposition, options)
        if not self._rough or order == _order(scene.decomposition, scene.solver):
            return scene
        scene = replace(scene, decomposition=decomposition, solver=options)
        self.scene, self._models = scene, CaseModels(scene, self._comm)
        return scene

    def add(self, solved: SolvedScene) -> None:
        """Store an answer: the next increment begins with it."""
        self._last, self._displacements = solved.model.scene.rigid, solved.solution.displacements
        self._before, self._rows = self._rows, SameRows(solved.solution)
        problem, displacements = solved.model.problem, solved.solution.displacements
        self._pressed = NormalForces.of(problem, solved.solution)
        self._jumps = problem.jumps(displacements)
        self._store_order(solved.model, solved.solution.displacements)
        self._models.add(problem, solved.solution)

    def _store_order(self, model: Model, displacements: Displacements) -> None:
        """Store the displacements that this rank owns of nodes and rigid bodies, and the order."""
        if self._rough:
            self._of_nodes = _at_nodes(model, displacements)
            of_classes = zip(model.problem.classes, displacements, strict=True)
            self._of_rigid = [u for cls, u in of_classes if cls.rigid]
        self._order = _order(model.scene.decomposition, model.scene.solver)

    def after(self, rigid: RigidBodies | None, displacements: Displacements) -> "IncrementModels":
        """Models of the increment that follows another state; these models stay as they are.

        Parameters
        ----------
        rigid
            The rigid bodies under the loads of that state; None for no loads.
        """
        following = copy(self)
        following._last, following._displacements = rigid, displacements
        return following

    def on(self, model: Model) -> Guess | None:
        """Initial guess: a combination of earlier answers, or the last one (collective).

        With friction multigrid begins with the last answer unless its loads are far: an earlier one
        to nearly equal loads, which came from the other side, slides the other way. Where the loads
        go on in the direction of the last increment, so does the answer. Slips are taken to be as
        long as in the last increment.
        """
        problem = model.problem
        follows = self._rough and not problem.factored and self._models.is_near_last(problem)
        near = self._extrapolated(model) if follows else self._models.on(model)
        if near is None and self._rows is not None:
            near = self._rows.on(model)
        if near is None or len(self._jumps) != len(near.multiplier):
            return near
        return replace(near, jumps=self._jumps)

    def _extrapolated(self, model: Model) -> Guess | None:
        """The last answer and a share of its change, as of the change of the loads (collective).

        None if the loads change otherwise than before.
        """
        share = self._models.change_of_loads(model.problem)
        if share is None or self._before is None or self._rows is None:
            return None
        last, before = self._rows.on(model), self._before.on(model)
        if last is None or before is None:
            return None
        assert last.displacements is not None
        assert before.displacements is not None
        pairs = zip(last.displacements, before.displacements, strict=True)
        return Guess(
            last.multiplier + share * (last.multiplier - before.multiplier),
            [u + share * (u - v) for u, v in pairs],
        )


def _order(decomposition: Decomposition, solver: SolverOptions) -> tuple[Decomposition, bool]:
    """Decomposition and kind of method, on which the classes of subdomains depend."""
    return decomposition, is_undecomposed(solver)


def _at_nodes(model: Model, displacements: Displacements) -> Array:
    """Displacements (owned, d) of the nodes that this rank owns (collective)."""
    exchange, d = model.node_exchange, model.scene.dimension
    copies = [displacements[cls][:, at].reshape(-1, d) for cls, at in model.place]
    of_nodes = np.zeros((exchange.last - exchange.first, d))
    arrived = exchange.to_owners(np.concatenate([np.zeros((0, d)), *copies]))
    of_nodes[exchange.nodes - exchange.first] = arrived
    return of_nodes


def _in_order_of(model: Model, of_nodes: Array, of_rigid: Displacements) -> Displacements:
    """Displacements of nodes and of rigid bodies in the classes of a model (collective)."""
    exchange = model.node_exchange
    rigid, forces = iter(of_rigid), zip(model.problem.classes, model.problem.forces, strict=True)
    result = [next(rigid) if cls.rigid else np.zeros_like(f) for cls, f in forces]
    copies = exchange.from_owners(of_nodes[exchange.nodes - exchange.first])
    ends = np.cumsum([len(s.nodes) for s in model.partition.subdomains])
    for (cls, at), u in zip(model.place, np.split(copies, ends[:-1]), strict=True):
        result[cls][:, at] = u.ravel()
    return result
