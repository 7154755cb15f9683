"""Errors of quadratic programs, with messages for the author of the program."""


class QPError(ValueError):
    """A quadratic program has no solution, or its data are inconsistent."""


class NotFiniteError(QPError):
    """A NaN or an infinity in the data or in a Hessian multiplication."""


class IndefiniteError(QPError):
    """The Hessian has a direction of negative curvature, so the problem is not convex."""


class UnboundedError(QPError):
    """The cost falls without limit along a feasible direction.

    Attributes
    ----------
    component : int
        Global number of the component that moves most along the direction.
    """

    def __init__(self, message: str, component: int = -1) -> None:
        super().__init__(message)
        self.component = component
