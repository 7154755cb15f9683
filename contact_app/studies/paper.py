"""The paper's counts (Appendix A), and their comparison with counts of this solver."""

import csv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from contact_app.studies.tables import plotting

COLUMNS = (
    "benchmark",
    "expansion",
    "alpha_u",
    "outer",
    "hessian",
    "cg",
    "expansion_steps",
    "proportioning",
)


#: Counts above this are left out of figures, as the paper leaves out its 2322.
OUTLIER = 2000


@dataclass(frozen=True)
class Row:
    """One row of the paper's tables, or of this solver for the same settings."""

    benchmark: str
    expansion: str
    alpha_u: float | None  # None if the expansion has no multiple
    outer: int | None  # None without outer iterations
    hessian: int
    cg: int
    expansion_steps: int
    proportioning: int

    @property
    def counts(self) -> tuple[int, int, int, int]:
        """Hessian multiplications, CG, expansion and proportioning steps."""
        return self.hessian, self.cg, self.expansion_steps, self.proportioning


@dataclass(frozen=True)
class Comparison:
    """Our row and the paper's."""

    measured: Row
    paper: Row

    @property
    def exact(self) -> bool:
        """All four counts agree."""
        return self.measured.counts == self.paper.counts

    def within(self, share: float) -> bool:
        """Hessian multiplications agree within a share."""
        return abs(self.measured.hessian - self.paper.hessian) <= share * self.paper.hessian


def paper_rows(benchmark: str) -> list[Row]:
    """The paper's rows: 73 for ``contact``, 73 for each of the three data sets."""
    resource = files("contact_app.studies").joinpath("data/paper_counts.csv")
    text = resource.read_text(encoding="utf-8")
    rows = (_row(fields) for fields in csv.DictReader(text.splitlines()))
    return [row for row in rows if row.benchmark == benchmark]


def _row(fields: dict[str, str]) -> Row:
    return Row(
        fields["benchmark"],
        fields["expansion"],
        float(fields["alpha_u"]) if fields["alpha_u"] else None,
        int(fields["outer"]) if fields["outer"] else None,
        *(int(fields[name]) for name in COLUMNS[4:]),
    )


def write_csv(path: Path, comparisons: Iterable[Comparison]) -> None:
    """Write our rows in the columns of the paper's, and the paper's counts after them."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([*COLUMNS, *(f"paper_{name}" for name in COLUMNS[3:])])
        for pair in comparisons:
            measured = [getattr(pair.measured, name) for name in COLUMNS]
            writer.writerow([*measured, *(getattr(pair.paper, name) for name in COLUMNS[3:])])


def draw(path: Path, title: str, comparisons: Sequence[Comparison]) -> None:
    """Hessian multiplications over α_u: measured solid, the paper's dashed (Figures 3 to 6)."""
    pyplot = plotting()
    figure, axes = pyplot.subplots(figsize=(8.0, 5.5), layout="constrained")
    names = list(dict.fromkeys(pair.paper.expansion for pair in comparisons))
    highest = 0.0
    for color, name in enumerate(names):
        rows = [pair for pair in comparisons if pair.paper.expansion == name]
        style = {"color": f"C{color}"}
        counts = [pair.paper.hessian for pair in rows] + [pair.measured.hessian for pair in rows]
        highest = max(highest, *(count for count in counts if count < OUTLIER))
        if rows[0].paper.alpha_u is None:
            axes.axhline(rows[0].measured.hessian, label=name, **style)
            axes.axhline(rows[0].paper.hessian, linestyle="--", alpha=0.7, **style)
            continue
        alpha = [pair.paper.alpha_u for pair in rows]
        axes.plot(alpha, [pair.measured.hessian for pair in rows], ".-", label=name, **style)
        published = [pair.paper.hessian for pair in rows]
        axes.plot(alpha, published, "x--", alpha=0.7, **style)
    axes.set_ylim(0.0, 1.1 * highest)
    axes.set_xlabel("α_u")
    axes.set_ylabel("Hessian multiplications")
    axes.set_title(f"{title} (solid: this solver, dashed: the paper)")
    axes.legend()
    figure.savefig(path, dpi=150)
    pyplot.close(figure)
