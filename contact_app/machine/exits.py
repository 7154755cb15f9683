"""The end of the program: exit codes, and the message and code of each exception.

On several ranks an exception occurs on all of them or on some. A rank with an exception waits a
moment for the others. If all arrive, rank 0 prints the message and all exit with one code.
Otherwise the rank prints its message and aborts the others, which would wait for it in some
exchange for ever.
"""

import errno
import os
import sys
import time
import traceback
from enum import IntEnum
from pathlib import Path
from typing import Any

from contact_app.errors import ConfigurationError, ContactError, NoEquilibriumError

PATIENCE = 5.0
"""Seconds that a rank with an exception waits for the exceptions of the others."""

MOMENT = 2.0
"""Seconds that other ranks wait for the message of rank 0 before MPI has begun."""

DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
FORBIDDEN = (errno.EACCES, errno.EPERM, errno.EROFS)

ENDING, PRINTED = 30_101, 30_102
"""Tags of messages between ending ranks; solvers use small tags, and MPI allows 32,767."""

LONGEST = 1000
"""Characters of a message that are sent to other ranks: few, so that sending does not block."""

PETSC_OUT_OF_MEMORY = 55
"""``PETSC_ERR_MEM``."""

REMEDY, LOGGED_IN = "remedy", "logged_in"
"""Attributes that an exception may have: a sentence for the user, the file with the traceback."""


class Exit(IntEnum):
    """Exit codes of ``contact-app``."""

    CERTIFIED = 0
    NOT_CERTIFIED = 1
    """Solved, but not certified or not converged; the results so far are written."""
    BAD_INPUT = 2
    NO_EQUILIBRIUM = 3
    COULD_NOT_RUN = 4
    """Disk, memory, permissions, or an internal error."""
    INTERRUPTED = 130
    """Ctrl-C before there were results to write (128 + SIGINT, as in shells)."""


def code_of(error: BaseException) -> Exit:
    """Exit code of an exception that ends the program."""
    if isinstance(error, NoEquilibriumError):
        return Exit.NO_EQUILIBRIUM
    if isinstance(error, ConfigurationError):
        return Exit.BAD_INPUT
    return Exit.COULD_NOT_RUN


def message_of(error: BaseException) -> str:
    """The message to the user: what happened and what to do."""
    remedy = getattr(error, REMEDY, None)
    return _what_happened(error) + (f"; {remedy}" if remedy else "")


def _what_happened(error: BaseException) -> str:
    """The sentence for the user on an error that ended the run."""
    if isinstance(error, ContactError):
        return str(error)
    if _is_memory(error):
        return (
            "the run ended: not enough memory; contact-app check says what a scene needs; use a "
            "coarser mesh, smaller subdomains or a larger machine"
        )
    if isinstance(error, OSError):
        return _of_system(error)
    text = f"{type(error).__name__}: {error}".strip().splitlines()[0].rstrip(": ")
    where = logged_in(error)
    place = f"the traceback is in {where}" if where else "the traceback is above"
    return (
        f"the run ended by an internal error of the program ({text}); {place}: please report it "
        "together with the scene"
    )


def _of_system(error: OSError) -> str:
    """The message for an error of the operating system, without HDF5's long output."""
    number = error.errno
    if isinstance(error, TimeoutError) and not number:  # from dolfinx's compiler, with a remedy
        return f"the run ended: {str(error).splitlines()[0]}"
    text = os.strerror(number) if number else str(error).splitlines()[0] or type(error).__name__
    where = f"{error.filename}: " if error.filename else ""
    if number in DISK_FULL:
        place = "there" if where else "on the disk"
        remedy = f"make room {place}, or name another directory with --output"
    elif number in FORBIDDEN:
        remedy = "change its permissions, or name another directory with --output"
    else:
        remedy = "look at this file or device, or name another directory with --output"
    return f"the run ended: {where}{text}; {remedy}"


def _is_memory(error: BaseException) -> bool:
    if isinstance(error, MemoryError):
        return True
    if isinstance(error, OSError):
        return error.errno == errno.ENOMEM
    petsc = type(error).__module__.startswith("petsc4py")
    return petsc and getattr(error, "ierr", 0) == PETSC_OUT_OF_MEMORY


def is_own_failure(error: BaseException) -> bool:
    """Whether an exception is an internal error, which needs a traceback."""
    return not isinstance(error, ContactError | OSError) and not _is_memory(error)


def mark_logged(error: BaseException, path: Path) -> None:
    """Remember that the traceback of an exception is in a file."""
    setattr(error, LOGGED_IN, path)


def logged_in(error: BaseException) -> Path | None:
    """The file with the traceback of an exception, if there is one."""
    file = getattr(error, LOGGED_IN, None)
    return file if isinstance(file, Path) else None


def end(error: BaseException) -> Exit:
    """Print the message of an exception and return the exit code, or abort all ranks.

    Called by each rank with an exception.
    """
    code, message = code_of(error), message_of(error)
    if is_own_failure(error) and logged_in(error) is None:
        traceback.print_exception(error)
    world = _world()
    if world is None:
        _print_without_mpi(message, of_all=isinstance(error, ContactError))
        return code
    messages = _exchanged(world, (int(code), message[:LONGEST]))
    if messages is None:
        print_message(message, world.rank)
        world.Abort(int(code))
        return code  # not reached
    if world.rank == 0:
        for rank, (_, text) in messages.items():
            if rank == 0 or text != messages[0][1]:
                print_message(text, rank)
        for rank in range(1, world.size):
            world.send(None, dest=rank, tag=PRINTED)
    else:
        world.recv(source=0, tag=PRINTED)  # the first rank that exits ends the others
    return Exit(max(number for number, _ in messages.values()))


def add_remedy(error: BaseException, sentence: str) -> None:
    """Add a sentence to the message of an exception."""
    setattr(error, REMEDY, sentence)


def _world() -> Any:
    """MPI's world communicator if MPI has begun with several ranks, otherwise None."""
    module = sys.modules.get("mpi4py.MPI")
    if module is None or not module.Is_initialized() or module.Is_finalized():
        return None
    world = module.COMM_WORLD
    return world if world.size > 1 else None


def _exchanged(world: Any, message: tuple[int, str]) -> dict[int, tuple[int, str]] | None:
    """Code and message of every rank, by rank; None if some do not arrive in `PATIENCE` seconds.

    Uses point-to-point messages: ranks without an exception may be inside any collective operation,
    which another collective would corrupt.
    """
    others = [rank for rank in range(world.size) if rank != world.rank]
    sent = [world.isend(message, dest=rank, tag=ENDING) for rank in others]
    messages, began = {world.rank: message}, time.monotonic()
    while len(messages) < world.size:
        for rank in others:
            if rank not in messages and world.iprobe(source=rank, tag=ENDING):
                messages[rank] = world.recv(source=rank, tag=ENDING)
        if time.monotonic() - began > PATIENCE:
            return None
        time.sleep(0.01)
    for request in sent:
        request.wait()
    return dict(sorted(messages.items()))


def _print_without_mpi(message: str, of_all: bool) -> None:
    """Print the message before MPI has begun, when the first rank that exits ends the others."""
    rank = rank_by_environment()
    if rank > 0 and of_all:
        time.sleep(MOMENT)
        return
    print_message(message, rank)


def rank_by_environment() -> int:
    """Rank under mpirun or srun, without MPI, which takes its time to load."""
    for name in ("OMPI_COMM_WORLD_RANK", "PMIX_RANK", "PMI_RANK"):
        if os.environ.get(name, "").isdigit():
            return int(os.environ[name])
    return 0


def print_message(message: str, rank: int = 0) -> None:
    """Print a message; control characters are shown as codes."""
    if rank > 0:
        message = f"rank {rank}: {message}"
    shown = (
        c if c.isprintable() or c == "\n" else c.encode("unicode_escape").decode() for c in message
    )
    print("".join(shown), file=sys.stderr, flush=True)
