"""The numerics need neither dolfinx nor YAML nor scenes: their tests run without."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]

WITHOUT = """
import sys
for name in ("dolfinx", "ufl", "basix", "ffcx", "pydantic", "yaml", "ruamel", "meshio", "typer",
             "matplotlib", "contact_app", "meshes"):
    sys.modules[name] = None
import pytest
sys.exit(pytest.main(["--collect-only", "-q", "-p", "no:cacheprovider", "tests/solver"]))
"""


def test_tests_of_the_solver_import_nothing_of_the_application() -> None:
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT], cwd=ROOT, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stdout
    assert "test_rows.py" in done.stdout
