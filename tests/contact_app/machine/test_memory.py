"""Memory: the estimate grows as it should, and every limit on the process is seen."""

import resource
import subprocess
import sys
from pathlib import Path

import pytest

from contact_app.machine import memory


def test_the_estimate_grows_with_every_part() -> None:
    base = memory.needed_bytes(1000, 100)
    assert memory.needed_bytes(2000, 100) > base
    assert memory.needed_bytes(1000, 200) > base
    assert memory.needed_bytes(1000, 100, ((500, 3),)) > base
    assert memory.factor_bytes(1e6, 3) > memory.factor_bytes(1e6, 2)


def test_something_is_left_here() -> None:
    assert memory.available_bytes() > 1e7


GROUPS = {
    "v2": ("0::/job/task\n", "", "memory.max", "memory.current"),
    "v1": ("5:cpu:/x\n4:memory,hugetlb:/job/task\n", "memory", "memory.limit_in_bytes",
           "memory.usage_in_bytes"),
}  # fmt: skip


@pytest.mark.parametrize("version", GROUPS)
@pytest.mark.parametrize("level", ["", "job", "job/task"])
def test_the_tightest_of_nested_control_groups_counts(
    tmp_path: Path, version: str, level: str
) -> None:
    groups, mount, limit, used = GROUPS[version]
    own = tmp_path / "own"
    own.write_text(groups)
    (tmp_path / mount / "job" / "task").mkdir(parents=True)
    here = tmp_path / mount / level
    assert memory.control_group(tmp_path, own) == float("inf")
    (tmp_path / mount / "job" / "task" / limit).write_text("max\n")
    (here / limit).write_text("5000\n")
    (here / used).write_text("3000\n")
    (here / "memory.stat").write_text("anon 2000\ninactive_file 500\n")
    assert memory.control_group(tmp_path, own) == 2500.0
    (here / used).write_text("9000\n")
    assert memory.control_group(tmp_path, own) == 0.0


def test_a_limit_on_address_space_counts() -> None:
    program = "from contact_app.machine.memory import available_bytes; print(available_bytes())"
    limit = 3_000_000_000
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True,
        cwd=Path(__file__).parents[3],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit)),
    )  # fmt: skip
    assert 0.0 < float(done.stdout) < limit
