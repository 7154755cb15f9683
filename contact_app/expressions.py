"""Boundaries by expression: arithmetic and comparisons in x, y and z, parsed, never executed.

The text is parsed by Python's own grammar into a tree, every node of which must be on a short
list; the tree is then evaluated with numpy on all points at once. Names other than the variables,
attribute access, subscripts, calls of anything but the listed functions: all refused before
anything is evaluated. Numbers are floating point, so that towers of powers overflow to infinity
at once instead of growing.
"""

from __future__ import annotations

import ast
import operator
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

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
_LOGIC: dict[type, Callable[..., Any]] = {ast.BitAnd: np.logical_and, ast.BitOr: np.logical_or}
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


class ExpressionError(ValueError):
    """The text is not an expression this module accepts."""


@dataclass(frozen=True)
class Expression:
    """A condition on points.

    Examples
    --------
    >>> import numpy as np
    >>> top = Expression.parse("z > 0.5 and x**2 + y**2 <= 1")
    >>> top(np.array([[0.0, 0.0, 1.0], [2.0, 0.0, 1.0]])).tolist()
    [True, False]
    """

    text: str
    tree: ast.expr

    @classmethod
    def parse(cls, text: str, variables: tuple[str, ...] = ("x", "y", "z")) -> Expression:
        """Parse and check a text; nothing is evaluated.

        Raises
        ------
        ExpressionError
            With what is wrong and what is allowed.
        """
        if len(text) > LONGEST:
            raise ExpressionError(f"is longer than {LONGEST} characters")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of Python's own taste, as in `1or x`
                tree = ast.parse(text.strip(), mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise ExpressionError(f"is no expression ({text!r}); allowed: {ALLOWED}") from None
        if _depth(tree) > DEEPEST:
            raise ExpressionError(f"is nested deeper than {DEEPEST} levels")
        kind = _check(tree, variables)
        if kind != "condition":
            raise ExpressionError("is a number, not a condition; compare it, as in `z < 0.1`")
        return cls(text, tree)

    def __call__(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether each of the points (n, 3) satisfies the condition, (n,)."""
        with np.errstate(all="ignore"):
            result = _evaluate(self.tree, dict(zip("xyz", points.T, strict=True)))
        return np.broadcast_to(np.asarray(result, dtype=bool), len(points)).copy()


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

    def check(child: ast.expr, wanted: str) -> str:
        found = _check(child, variables)
        if found != wanted:
            logic = isinstance(node, ast.BinOp) and type(node.op) in _LOGIC
            raise ExpressionError(
                f"uses `{_source(child)}`, a {found}, where a {wanted} belongs"
                + ("; put comparisons in parentheses around & and |" if logic else "")
            )
        return found

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
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _LOGIC:
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
    raise ExpressionError(f"uses `{_source(node)}`, which is not allowed; allowed: {ALLOWED}")


def _evaluate(node: ast.expr, values: dict[str, Any]) -> Any:
    result: Any
    match node:
        case ast.Constant(value=bool(value)):
            return value
        case ast.Constant(value=int(value) | float(value)):
            return np.float64(value)
        case ast.Name(id=name):
            return values[name] if name in values else CONSTANTS[name]
        case ast.UnaryOp(op=op, operand=operand):
            value = _evaluate(operand, values)
            if isinstance(op, ast.USub):
                return -value
            return value if isinstance(op, ast.UAdd) else np.logical_not(value)
        case ast.BinOp(left=left, op=op, right=right):
            function = _ARITHMETIC.get(type(op)) or _LOGIC[type(op)]
            return function(_evaluate(left, values), _evaluate(right, values))
        case ast.BoolOp(op=op, values=operands):
            function = np.logical_and if isinstance(op, ast.And) else np.logical_or
            result = _evaluate(operands[0], values)
            for operand in operands[1:]:
                result = function(result, _evaluate(operand, values))
            return result
        case ast.Compare(left=left, ops=ops, comparators=right):
            result = True
            first = _evaluate(left, values)
            for comparison, second in zip(ops, (_evaluate(v, values) for v in right), strict=True):
                result = np.logical_and(result, _COMPARISON[type(comparison)](first, second))
                first = second
            return result
        case ast.Call(func=ast.Name(id=name), args=args):
            return FUNCTIONS[name](*(_evaluate(v, values) for v in args))
    raise AssertionError("checked when it was parsed")


def _source(node: ast.expr) -> str:
    text = ast.unparse(node)
    return text if len(text) <= 60 else text[:57] + "..."
