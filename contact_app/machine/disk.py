"""Reservation of room on the disk before a file is written.

A library that meets a full disk in the middle of a file may fail in its own way; HDF5 crashes when
it closes the file. Here blocks are reserved first (``posix_fallocate``), and a lack of blocks is an
ordinary error. If the file system cannot reserve blocks, its free blocks are counted.
"""

import errno
import os
import shutil
from pathlib import Path

from contact_app.errors import CouldNotRunError
from contact_app.machine.exits import DISK_FULL

UNSUPPORTED = (errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS)


def reserve(descriptor: int, size: int) -> None:
    """Reserve room for the first `size` bytes of a file; its length may grow.

    Raises
    ------
    OSError
        With the number ENOSPC, EDQUOT or EFBIG if there is not enough room.
    """
    try:
        os.posix_fallocate(descriptor, 0, size)
    except OSError as error:
        if error.errno not in UNSUPPORTED:
            raise
        system, file = os.fstatvfs(descriptor), os.fstat(descriptor)
        if system.f_bavail * system.f_frsize < size - 512 * file.st_blocks:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)) from None


def reserve_for(path: Path, descriptor: int, size: int) -> None:
    """Reserve room for the file of a result.

    Raises
    ------
    CouldNotRunError
        Disk, quota or limit on files are exhausted.
    """
    try:
        reserve(descriptor, size)
    except OSError as error:
        if error.errno not in DISK_FULL:
            raise
        raise no_room(path, size) from error


def free_bytes(directory: Path) -> int:
    """Bytes that this user can still write to the file system of a directory."""
    return shutil.disk_usage(directory).free


def refuse_without_room(directory: Path, name: str, needed: int) -> None:
    """Raise an error if a file will not fit into a directory, before it is computed.

    Raises
    ------
    CouldNotRunError
    """
    free = free_bytes(directory)
    if free < needed:
        raise no_room(directory / name, needed, free)


def no_room(path: Path, needed: int, free: int | None = None) -> CouldNotRunError:
    """The error of a file that does not fit."""
    free = free_bytes(path.parent) if free is None else free
    return CouldNotRunError(
        f"{path.parent}: the disk is full: {path.name} needs {_size(needed)}, {_size(free)} are "
        "free; make room there, name another directory with --output, or write fewer fields "
        "(output.fields, output.xdmf: false)"
    )


def _size(count: float) -> str:
    """A number of bytes in words: ``1.2 GB``."""
    units = ["bytes", "kB", "MB", "GB", "TB"]
    while count >= 1000.0 and len(units) > 1:
        count /= 1000.0
        units.pop(0)
    return f"{count:.3g} {units[0]}"
