"""Settings of all tests: slow ones only on request, MPI as root or missing."""

import os
import shutil

import pytest
from hypothesis import HealthCheck, settings

# A verdict of CI is about the change: the same examples every time; elsewhere new ones each time.
# How fast examples are made says more of what else the machine is doing than of the test.
busy = {"suppress_health_check": [HealthCheck.too_slow], "deadline": None}
settings.register_profile("ci", derandomize=True, **busy)
settings.register_profile("here", **busy)
settings.load_profile("ci" if os.environ.get("CI") else "here")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--slow", action="store_true", help="run the slow tests as well")


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("--slow"):
        config.option.markexpr = config.option.markexpr.replace("not slow", "")
    # Processes that pytest-xdist starts fill the cores: none needs threads of its own.
    if getattr(config.option, "numprocesses", None):
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Ranks that wait let others run: tests start more of them than there are cores.
    os.environ.setdefault("OMPI_MCA_mpi_yield_when_idle", "1")
    # All ranks are on this machine and need no network.
    os.environ.setdefault("OMPI_MCA_btl", "^tcp")
    # Open MPI refuses to start as root, as in a container, unless told.
    if os.geteuid() == 0:
        os.environ.setdefault("OMPI_ALLOW_RUN_AS_ROOT", "1")
        os.environ.setdefault("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1")


def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.get_closest_marker("mpi") and shutil.which("mpirun") is None:
        pytest.skip("mpirun is not installed")
