"""Options of PETSc for one object."""

from petsc4py import PETSc


class lent_options:
    """Context manager that sets options in PETSc's database."""

    def __init__(self, prefix: str, options: dict[str, object]) -> None:
        self._names = {prefix + name: value for name, value in options.items()}
        self._options = PETSc.Options()

    def __enter__(self) -> None:
        for name, value in self._names.items():
            self._options[name] = value

    def __exit__(self, *ended: object) -> None:
        for name in self._names:
            self._options.delValue(name)
