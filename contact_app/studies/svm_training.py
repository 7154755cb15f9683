"""Support vector machines without bias, trained through their dual (paper, section 4.2).

Samples x_i get a last component 1, so that the hyperplane's offset is part of its normal w. With
Z = diag(y) X̂ (samples by features) the dual of the l1 (hinge) loss is the box-constrained QP

    min ½ λᵀ Z Zᵀ λ - λᵀ 1   over  0 ≤ λ ≤ C,

and that of the l2 (squared hinge) loss has Z Zᵀ + I/C and no upper bound. The Gram matrix Z Zᵀ is
applied as two products with Z: memory is that of the data. From λ, w = Zᵀ λ; the duality gap ½‖w‖²
+ C/p Σ ξᵢᵖ + (½ λᵀHλ - λᵀ1) bounds the distance from the optimum.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from scipy import sparse

from meshes.arrays import Array
from solver import MPRGP, BoxQP, Result

LOSSES = ("l1", "l2")
#: Distance of the paper's initial guess from the upper bound (section 5.2), in units of C.
START = 100.0 * float(np.finfo(np.float64).eps)
#: Share of nonzeros above which the data are stored as a dense array.
DENSE = 0.25


class DataError(ValueError):
    """A data file that cannot be read; the message names file and line."""


@dataclass(frozen=True)
class Samples:
    """Labelled samples."""

    features: sparse.csr_array  # csr_array (samples, features)
    labels: Array  # (samples,) of ±1
    classes: tuple[float, float]


def read_libsvm(path: Path | str) -> Samples:
    """Read ``label index:value …`` lines; indices from 1 and ascending, ``#`` begins a comment.

    Raises
    ------
    DataError
    """
    path = Path(path)
    labels: list[float] = []
    columns: list[int] = []
    values: list[float] = []
    starts = [0]
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: cannot be read as text: {error}") from error
    for number, line in enumerate(text.splitlines(), 1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        where = f"{path}:{number}"
        labels.append(_number(words[0], f"{where}: the label"))
        previous = 0
        for word in words[1:]:
            index, colon, value = word.partition(":")
            if not colon or not index.isdecimal() or int(index) < 1:
                raise DataError(f"{where}: {word!r} is not index:value with an index from 1")
            if int(index) <= previous:
                raise DataError(f"{where}: index {index} follows {previous}; they must ascend")
            previous = int(index)
            columns.append(previous - 1)
            values.append(_number(value, f"{where}: the value of feature {index}"))
        starts.append(len(columns))
    if not labels:
        raise DataError(f"{path}: there are no samples in it")
    classes = sorted(set(labels))
    if len(classes) != 2:
        raise DataError(
            f"{path}: {len(classes)} different labels "
            f"({', '.join(f'{c:g}' for c in classes[:5])}); a binary classifier needs 2"
        )
    features = sparse.csr_array(
        (np.array(values), np.array(columns, dtype=np.int64), np.array(starts)),
        shape=(len(labels), max(columns, default=-1) + 1),
    )
    signs = np.where(np.array(labels) == classes[1], 1.0, -1.0)
    return Samples(features, signs, (classes[0], classes[1]))


def _number(text: str, what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise DataError(f"{what} is {text!r}; it must be a number") from None
    if not math.isfinite(value):
        raise DataError(f"{what} is {text}; it must be finite")
    return value


class GramOperator:
    """x -> Z Zᵀ x + shift x, with Z = diag(y) X̂ and X̂ the samples with a last component 1."""

    def __init__(self, samples: Samples, shift: float = 0.0) -> None:
        self.comm = MPI.COMM_SELF
        self.size = len(samples.labels)
        self.shift = shift
        ones = np.ones((self.size, 1))
        augmented = sparse.hstack([samples.features, sparse.csr_array(ones)], format="csr")
        signed = sparse.csr_array(augmented.multiply(samples.labels[:, None]))
        filled = signed.nnz / max(1, signed.shape[0] * signed.shape[1])
        self.Z: Any = signed.toarray() if filled > DENSE else signed
        self._transpose = self.Z.T if filled > DENSE else sparse.csr_array(self.Z.T)

    def apply(self, x: Array, out: Array) -> None:
        """Put the product with x into out."""
        out[:] = self.Z @ (self._transpose @ x)
        if self.shift:
            out += self.shift * x

    def normal(self, multiplier: Array) -> Array:
        """w = Zᵀ λ, the hyperplane's normal with its offset last."""
        return self._transpose @ multiplier

    def margins(self, normal: Array) -> Array:
        """Zw, y_i times the signed value of the classifier at sample i."""
        return self.Z @ normal


def dual_problem(samples: Samples, loss: str = "l1", C: float = 1.0) -> BoxQP:
    """The dual QP (paper, equations 6 and 7)."""
    if loss not in LOSSES:
        raise ValueError(f"unknown loss {loss!r}; known are {', '.join(LOSSES)}")
    if not (C > 0.0 and math.isfinite(C)):
        raise ValueError(f"C is {C}; the penalty must be positive and finite")
    operator = GramOperator(samples, 0.0 if loss == "l1" else 1.0 / C)
    return BoxQP(operator, np.ones(operator.size), lower=0.0, upper=C if loss == "l1" else None)


def solve(
    samples: Samples, solver: MPRGP, loss: str = "l1", C: float = 1.0
) -> tuple[BoxQP, Result]:
    """Solve the dual from the paper's initial guess; from zero where there is no upper bound."""
    qp = dual_problem(samples, loss, C)
    start = np.full(qp.size, C * (1.0 - START)) if loss == "l1" else None
    return qp, solver.solve(qp, start)


def train(
    data: Path | str,
    loss: str = "l1",
    C: float = 1.0,
    expansion: str = "projcg",
    alpha_u: float = 1.9,
    rtol: float = 0.1,
    max_iterations: int = 100_000,
) -> dict[str, Any]:
    """Train on a LIBSVM file.

    Returns
    -------
    dict
        Data for JSON: counts, objective of the dual (minus that of the primal at the optimum),
        duality gap (absolute, and relative to the primal), training accuracy, normal.

    Raises
    ------
    DataError, ValueError
    """
    samples = read_libsvm(data)
    solver = MPRGP(expansion, alpha_u, rtol=rtol, max_iterations=max_iterations)
    qp, result = solve(samples, solver, loss, C)
    operator = qp.operator
    assert isinstance(operator, GramOperator)
    multiplier = result.x
    normal = operator.normal(multiplier)
    margins = operator.margins(normal)
    slack = np.maximum(0.0, 1.0 - margins)
    penalty = C * slack.sum() if loss == "l1" else 0.5 * C * float(slack @ slack)
    primal = 0.5 * float(normal @ normal) + penalty
    dual = 0.5 * float(normal @ normal) - float(multiplier.sum())
    if loss == "l2":
        dual += 0.5 * float(multiplier @ multiplier) / C
    gap = primal + dual
    counts = result.counts
    return {
        "data": str(data),
        "samples": len(samples.labels),
        "features": int(samples.features.shape[1]),
        "loss": loss,
        "C": C,
        "expansion": expansion,
        "converged": result.converged,
        "reason": str(result.reason),
        "counts": {
            "hessian": counts.hessian,
            "cg": counts.cg,
            "expansion": counts.expansion,
            "proportioning": counts.proportioning,
            "norm_estimation": counts.norm_estimation,
        },
        "objective": dual,
        "primal_objective": primal,
        "duality_gap": gap,
        "relative_duality_gap": gap / primal if primal > 0.0 else 0.0,
        "training_accuracy": float(np.mean(margins > 0.0)),
        "normal": normal[:-1].tolist(),
        "bias": float(normal[-1]),
    }
