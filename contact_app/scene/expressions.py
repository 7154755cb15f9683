"""Boundaries and fields by expression: arithmetic in x, y and z, parsed, never executed.

The text is parsed by Python's own grammar into a tree, every node of which must be on a short
list; the tree is then evaluated with numpy on all points at once. Other names than the variables,
attribute access, subscripts, and calls of other functions than the listed ones are refused before
anything is evaluated. Numbers are floating point, so that repeated powers overflow to infinity at
once.

Where a number has no value, as sqrt(-1), a comparison with it is neither true nor false. Kleene's
three-valued logic applies: `x <= 0 or log(x) < 1` is decided everywhere, and so is `x > 0 and
log(x) < 1`. Points that stay undecided are not on the boundary, which causes a warning.
"""

import ast
import functools
import operator
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

LONGEST = 500
DEEPEST = 40

FUNCTIONS: dict[str, Callable[..., Any]] = {
    "abs": np.abs,
    "sqrt": np.sqrt,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "exp": np.exp,
    "log": np.log,
    "atan2": np.arctan2,
    "hypot": np.hypot,
    "min": np.minimum,
    "max": np.maximum,
}
ARGUMENTS = {"atan2": 2, "hypot": 2, "min": 2, "max": 2}
CONSTANTS = {"pi": np.pi}

_ARITHMETIC: dict[type, Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: np.divide,
    ast.Pow: np.power,
}
_LOGIC = (ast.BitAnd, ast.BitOr)
_COMPARISON: dict[type, Callable[..., Any]] = {
    ast.Lt: np.less,
    ast.LtE: np.less_equal,
    ast.Gt: np.greater,
    ast.GtE: np.greater_equal,
    ast.Eq: np.equal,
    ast.NotEq: np.not_equal,
}

ALLOWED = (
    "numbers, x, y, z, pi, + - * / **, < <= > >= == !=, and or not, parentheses and "
    + ", ".join(FUNCTIONS)
)


Decided = tuple[Any, Any]
"""Masks of points where a condition is true, and where it is false; both False where undecided."""


class ExpressionError(ValueError):
    """The text is not an expression this module accepts."""


class UndecidedWarning(UserWarning):
    """An expression has no value at some of the points where it was evaluated."""


@dataclass(frozen=True)
class _Checked:
    """A checked expression of one kind: `number` or `condition`."""

    kind: ClassVar[str]
    otherwise: ClassVar[str]
    """Message on an expression of the other kind."""

    text: str
    tree: ast.expr = field(repr=False)

    @classmethod
    def parse(cls, text: str, variables: tuple[str, ...] = ("x", "y", "z")) -> Self:
        """Parse and check a text; nothing is evaluated.

        Raises
        ------
        ExpressionError
            The message gives the fault and what is allowed.
        """
        tree, kind = _parsed(text, variables)
        if kind != cls.kind:
            raise ExpressionError(cls.otherwise)
        return cls(text, tree)


class Expression(_Checked):
    """A condition on points.

    Examples
    --------
    >>> import numpy as np
    >>> top = Expression.parse("z > 0.5 and x**2 + y**2 <= 1")
    >>> top(np.array([[0.0, 0.0, 1.0], [2.0, 0.0, 1.0]])).tolist()
    [True, False]
    """

    kind = "condition"
    otherwise = "is a number, not a condition; compare it, as in `z < 0.1`"

    def __call__(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether each of the points (n, 3) satisfies the condition, (n,).

        Warns
        -----
        UndecidedWarning
            The expression has no value at a point, which counts as not satisfying it.
        """
        with np.errstate(all="ignore"):
            true, false = _condition(self.tree, dict(zip("xyz", points.T, strict=True)))
        if len(points) and not np.all(true | false):  # one text for all calls: one warning
            message = f"`{_source(self.tree)}` has no value at some points, which are left out"
            warnings.warn(message, UndecidedWarning, stacklevel=2)
        return np.broadcast_to(true, len(points)).copy()


class FieldExpression(_Checked):
    """A number at points.

    Examples
    --------
    >>> import numpy as np
    >>> FieldExpression.parse("20 + 5 * x")(np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])).tolist()
    [20.0, 30.0]
    """

    kind = "number"
    otherwise = "is a condition, not a number, as in `20 + 5 * x`"

    @property
    def constant(self) -> bool:
        """Whether the field is constant."""
        return not any(isinstance(n, ast.Name) and n.id in "xyz" for n in ast.walk(self.tree))

    def times(self, factor: float) -> "FieldExpression":
        """The field times a number."""
        if factor in (0.0, 1.0):
            return self if factor else FieldExpression("0", ast.Constant(0.0))
        tree = ast.BinOp(ast.Constant(factor), ast.Mult(), self.tree)
        return FieldExpression(f"{factor:g} * ({self.text})", tree)

    @property
    def vanishes(self) -> bool:
        """Whether the field is zero everywhere."""
        return self.constant and not self(np.zeros((1, 3))).any()

    def __call__(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """The number at each of the points (n, 3), (n,); NaN or infinite where it has no value."""
        with np.errstate(all="ignore"):
            value = _number(self.tree, dict(zip("xyz", points.T, strict=True)))
        return np.broadcast_to(np.asarray(value, float), len(points)).copy()


def _parsed(text: str, variables: tuple[str, ...]) -> tuple[ast.expr, str]:
    """The tree of a text, and whether it is a `number` or a `condition`."""
    if len(text) > LONGEST:
        raise ExpressionError(f"is longer than {LONGEST} characters")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # SyntaxWarning of Python, as in `1or x`
            tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise ExpressionError(f"is no expression ({text!r}); allowed: {ALLOWED}") from None
    if _depth(tree) > DEEPEST:
        raise ExpressionError(f"is nested deeper than {DEEPEST} levels")
    return tree, _check(tree, variables)


def _depth(tree: ast.AST) -> int:
    """Levels of a tree, counted without recursion."""
    level: list[ast.AST] = [tree]
    depth = 0
    while level:
        level = [child for node in level for child in ast.iter_child_nodes(node)]
        depth += 1
    return depth


def _check(node: ast.expr, variables: tuple[str, ...]) -> str:
    """Whether a node is a `number` or a `condition`; raises where it is neither."""

    def check(child: ast.expr, expected: str) -> str:
        problem = _check(child, variables)
        if problem != expected:
            logic = isinstance(node, ast.BinOp) and isinstance(node.op, _LOGIC)
            raise ExpressionError(
                f"uses `{_source(child)}`, a {problem}, where a {expected} belongs"
                + ("; put comparisons in parentheses around & and |" if logic else "")
            )
        return problem

    match node:
        case ast.Constant(value=bool()):
            return "condition"
        case ast.Constant(value=int() | float() as constant):
            try:
                float(constant)
            except OverflowError:
                raise ExpressionError("has a number that is too large") from None
            return "number"
        case ast.Name(id=name) if name in variables or name in CONSTANTS:
            return "number"
        case ast.Name(id=name):
            raise ExpressionError(f"uses the name {name!r}; allowed: {', '.join(variables)}, pi")
        case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=operand):
            return check(operand, "number")
        case ast.UnaryOp(op=ast.Not() | ast.Invert(), operand=operand):
            return check(operand, "condition")
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _ARITHMETIC:
            check(left, "number")
            return check(right, "number")
        case ast.BinOp(left=left, op=op, right=right) if isinstance(op, _LOGIC):
            check(left, "condition")
            return check(right, "condition")
        case ast.BoolOp(values=values):
            for value in values:
                check(value, "condition")
            return "condition"
        case ast.Compare(left=left, ops=ops, comparators=right) if all(
            type(op) in _COMPARISON for op in ops
        ):
            for value in (left, *right):
                check(value, "number")
            return "condition"
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]) if name in FUNCTIONS:
            if len(args) != ARGUMENTS.get(name, 1):
                raise ExpressionError(
                    f"calls {name} with {len(args)} arguments; it takes {ARGUMENTS.get(name, 1)}"
                )
            for value in args:
                check(value, "number")
            return "number"
        case ast.BinOp(op=ast.BitXor()):
            raise ExpressionError("uses ^; write ** for a power, as in x**2")
    raise ExpressionError(f"uses `{_source(node)}`, which is not allowed; allowed: {ALLOWED}")


def _number(node: ast.expr, values: dict[str, Any]) -> Any:
    """Value of a number at all points, NaN where it has none."""
    match node:
        case ast.Constant(value=int(value) | float(value)):
            return np.float64(value)
        case ast.Name(id=name):
            return values[name] if name in values else CONSTANTS[name]
        case ast.UnaryOp(op=op, operand=operand):
            return (-1.0 if isinstance(op, ast.USub) else 1.0) * _number(operand, values)
        case ast.BinOp(left=left, op=op, right=right):
            return _ARITHMETIC[type(op)](_number(left, values), _number(right, values))
        case ast.Call(func=ast.Name(id=name), args=args):
            return FUNCTIONS[name](*(_number(v, values) for v in args))
    raise AssertionError("checked when it was parsed")


def _condition(node: ast.expr, values: dict[str, Any]) -> Decided:
    """Masks of points at which a condition is true, and at which it is false."""
    match node:
        case ast.Constant(value=bool(value)):
            return np.bool_(value), np.bool_(not value)
        case ast.UnaryOp(operand=operand):
            return _condition(operand, values)[::-1]
        case ast.BinOp(left=left, op=op, right=right):
            parts = (_condition(v, values) for v in (left, right))
            return functools.reduce(_both if isinstance(op, ast.BitAnd) else _either, parts)
        case ast.BoolOp(op=op, values=operands):
            parts = (_condition(v, values) for v in operands)
            return functools.reduce(_both if isinstance(op, ast.And) else _either, parts)
        case ast.Compare(left=left, ops=ops, comparators=right):
            numbers = [_number(v, values) for v in (left, *right)]
            pairs = zip(ops, numbers[:-1], numbers[1:], strict=True)
            return functools.reduce(_both, (_compare(op, a, b) for op, a, b in pairs))
    raise AssertionError("checked when it was parsed")


def _compare(op: ast.cmpop, a: Any, b: Any) -> Decided:
    holds = _COMPARISON[type(op)](a, b)
    defined = ~(np.isnan(a) | np.isnan(b))
    return holds & defined, ~holds & defined


def _both(a: Decided, b: Decided) -> Decided:
    return a[0] & b[0], a[1] | b[1]


def _either(a: Decided, b: Decided) -> Decided:
    return a[0] | b[0], a[1] & b[1]


def _source(node: ast.expr) -> str:
    text = ast.unparse(node)
    return text if len(text) <= 60 else text[:57] + "..."
