"""The paper's SVM benchmark: 219 rows on three data sets (section 5.2, Figures 4 to 6).

The data sets are published on the LIBSVM data set page
(https://www.csie.ntu.edu.tw/~cjlin/libsvmtools/datasets/binary.html) as ``australian_scale``,
``diabetes_scale`` and ``ionosphere_scale``, features scaled to [-1, 1]; saved as
``australian.libsvm``, ``diabetes.libsvm`` and ``ionosphere.libsvm`` in one directory
:func:`reproduce_svm` reads them. Sets that were scaled from the original tables with more digits
are first rounded to the published digits (``published.py``).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from contact_app.studies.paper import Comparison, Row, draw, paper_rows, write_csv
from contact_app.studies.published import as_published
from contact_app.studies.svm_training import DataError, read_libsvm, solve
from solver import MPRGP

FIGURES = {"australian": 4, "diabetes": 5, "ionosphere": 6}
#: Relative tolerance of the benchmark.
RTOL = 0.1


@dataclass(frozen=True)
class Report:
    """Result of the training."""

    comparisons: tuple[Comparison, ...]
    files: tuple[Path, ...]
    """The CSV and the figures."""

    def summary(self) -> list[str]:
        """Sentences on the agreement."""
        rows = self.comparisons
        regular = [row for row in rows if not row.paper.expansion.endswith("-opt")]
        lines = [
            f"{sum(row.exact for row in rows)} of {len(rows)} rows agree in all counts",
            f"{sum(row.within(0.05) for row in rows)} of {len(rows)} agree within 5 % "
            "in Hessian multiplications",
            f"without the opt rows, which are chaotic in round-off: {_agreement(regular)}",
        ]
        for benchmark in FIGURES:
            for expansion in ("grgr-opt", "gfgr-opt", "gfgf-opt"):
                matching = [r for r in rows if (r.paper.benchmark, r.paper.expansion)
                         == (benchmark, expansion)]  # fmt: skip
                measured = median(row.measured.hessian for row in matching)
                paper = median(row.paper.hessian for row in matching)
                lines.append(
                    f"{benchmark} {expansion}: median {measured:g} beside the paper's {paper:g} "
                    f"({100 * (measured / paper - 1):+.0f} %)"
                )
        return lines


def _agreement(rows: Sequence[Comparison]) -> str:
    exact, near = sum(row.exact for row in rows), sum(row.within(0.05) for row in rows)
    return f"{exact} of {len(rows)} exact, {near} within 5 %"


def find_data(data_dir: Path | None) -> Path:
    """The directory with the data sets: the given one, or the one next to a clone of the project.

    Raises
    ------
    DataError
        The message says where the sets are published.
    """
    beside = Path(__file__).resolve().parents[3] / "shared" / "reference" / "svm"
    directory = data_dir or beside
    missing = [name for name in FIGURES if not (directory / f"{name}.libsvm").is_file()]
    if missing:
        raise DataError(
            f"{directory}: no {missing[0]}.libsvm; the sets are published at "
            "https://www.csie.ntu.edu.tw/~cjlin/libsvmtools/datasets/binary.html as NAME_scale; "
            "save them as NAME.libsvm in one directory and name it with --data"
        )
    return directory


def reproduce_svm(output_dir: Path | str, data_dir: Path | str | None = None) -> Report:
    """Run all rows, write ``svm_counts.csv`` and Figures 4 to 6.

    Raises
    ------
    DataError
    """
    directory = find_data(None if data_dir is None else Path(data_dir))
    output = Path(output_dir)
    output.mkdir(parents=True, exist_ok=True)
    comparisons: list[Comparison] = []
    written = [output / "svm_counts.csv"]
    for name, number in FIGURES.items():
        samples = as_published(read_libsvm(directory / f"{name}.libsvm"), name)
        pairs = []
        for paper in paper_rows(name):
            solver = MPRGP(paper.expansion, paper.alpha_u or 1.9, rtol=RTOL)
            counts = solve(samples, solver)[1].counts
            pairs.append(
                Comparison(
                    Row(
                        name,
                        paper.expansion,
                        paper.alpha_u,
                        None,
                        counts.hessian,
                        counts.cg,
                        counts.expansion,
                        counts.proportioning,
                    ),
                    paper,
                )  # fmt: skip
            )
        comparisons += pairs
        figure = output / f"figure{number}_{name}.png"
        draw(figure, f"Figure {number}: {name}", pairs)
        written.append(figure)
    write_csv(written[0], comparisons)
    return Report(tuple(comparisons), tuple(written))
