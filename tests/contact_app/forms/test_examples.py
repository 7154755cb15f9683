"""The examples of the guide for forms of dolfinx run and say what theory says."""

import re
from pathlib import Path

import pytest

from tests.ranks import ROOT, execute

GUIDE = ROOT / "docs" / "guide"

EXAMPLE = """
import runpy, sys
del sys.argv[0]
runpy.run_path(sys.argv[0], run_name="__main__")
"""


def said(name: str, *arguments: str, ranks: int = 1) -> dict[str, list[float]]:
    """Numbers of each line that an example prints."""
    printed = execute(EXAMPLE, str(GUIDE / name), *arguments, ranks=ranks)
    lines = dict(line.split(": ", 1) for line in printed.splitlines() if ": " in line)
    assert lines["certified"] == "True"
    return {name: [float(n) for n in re.findall(r"-?\d+\.\d+", text)]
            for name, text in lines.items()}  # fmt: skip


@pytest.mark.mpi
def test_hertz_in_forms() -> None:
    found = said("hertz_with_forms.py")
    force, given = found["force on a quarter"]
    assert force == pytest.approx(given, rel=1e-6)
    peak, hertz = found["largest pressure"]
    assert peak == pytest.approx(hertz, rel=0.03)
    radius, hertz = found["contact radius"]
    assert radius == pytest.approx(hertz, rel=0.15)
    code = (GUIDE / "hertz_with_forms.py").read_text(encoding="utf-8").split('"""')[2]
    assert len([line for line in code.splitlines() if line]) <= 40
    assert said("hertz_with_forms.py", ranks=2) == found


def test_orthotropic_block() -> None:
    found = said("orthotropic_block.py")
    along, across = found["half length of the contact"]
    assert across > 1.5 * along
    assert found["force"][0] > 0.0


def test_the_notebook_plots(tmp_path: Path) -> None:
    picture = tmp_path / "layers.png"
    assert said("contact_of_layers.py", str(picture))["force per thickness"][0] > 0.0
    assert picture.stat().st_size > 10_000
