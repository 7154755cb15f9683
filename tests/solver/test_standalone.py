"""The numerics need neither dolfinx nor YAML nor scenes: their tests run without."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

HIDDEN = """
import sys
for name in ("dolfinx", "ufl", "basix", "ffcx", "pydantic", "yaml", "ruamel", "meshio", "typer",
             "rich", "h5py", "matplotlib", "contact_app", "meshes"):
    sys.modules[name] = None
"""
"""A `sitecustomize.py` with which nobody can import them, in processes of tests either."""


@pytest.mark.parametrize(
    "words", [["--collect-only"], pytest.param(["-k", "not standalone"], marks=pytest.mark.slow)]
)
def test_tests_of_the_solver_need_nothing_of_the_application(
    words: list[str], tmp_path: Path
) -> None:
    (tmp_path / "sitecustomize.py").write_text(HIDDEN)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-v", "-p", "no:cacheprovider", *words, "tests/solver"],
        cwd=ROOT, capture_output=True, text=True, timeout=600,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
    assert "test_rows.py" in done.stdout
