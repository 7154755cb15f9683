"""The README's example runs as it stands there."""

import re
from pathlib import Path

import solver

README = Path(solver.__file__).with_name("README.md")


def test_the_example_runs(capsys):
    (code,) = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.S)
    assert len([line for line in code.splitlines() if line.strip()]) <= 11
    names: dict = {}
    exec(compile(code, str(README), "exec"), names)
    first, second = capsys.readouterr().out.splitlines()
    assert "below the tolerance" in first
    assert second.startswith("True -100.0")
    assert names["result"].converged


def test_every_strategy_and_file_it_names_exists():
    text = README.read_text(encoding="utf-8")
    for name in solver.expansion_names():
        assert name in text or name.split("-")[0] in text
    for file in re.findall(r"^\| (`.*?\.py`(?:, `.*?\.py`)*)", text, re.M):
        for part in re.findall(r"`(.*?)`", file):
            assert (README.parent / part).is_file(), part
