"""Directories for compiled forms if the home directory cannot be written.

dolfinx compiles each form to a library below ``$XDG_CACHE_HOME`` or ``~/.cache`` and reads options
below ``$XDG_CONFIG_HOME`` or ``~/.config``; matplotlib does the same. In a container, for a user
without a home, or with a full quota these directories are not writable. Then one directory of this
user below the system's directory for temporary files is used: ``contact-app-<user number>``.
Libraries in it are loaded as code, so it is used only if it is a real directory of this user with
no access for others (mode 0700); otherwise a new one with a random name is made.
"""

import os
import stat
import tempfile
from functools import cache
from pathlib import Path

from contact_app.errors import CouldNotRunError
from contact_app.machine.disk import reserve

ENOUGH = 1 << 20
"""Least free bytes of a cache: a handful of compiled forms."""


@cache
def usable_caches() -> tuple[str, ...]:
    """Set the environment to usable directories; return sentences on the changes.

    Called once per process, before dolfinx is imported.

    Raises
    ------
    CouldNotRunError
        No directory can be written.
    """
    messages: list[str] = []
    home = _home()
    if home is None:
        home = own_directory()
        os.environ["HOME"] = str(home)
        messages.append(f"there is no home directory: {home} is used")
    cache_home = Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache")
    if not _writable(cache_home / "fenics"):
        private = own_directory()
        os.environ["XDG_CACHE_HOME"] = str(private)
        messages.append(f"{cache_home} cannot be written: compiled forms are kept in {private}")
    elif not os.environ.get("XDG_CACHE_HOME", "x"):
        del os.environ["XDG_CACHE_HOME"]  # empty: dolfinx would use the working directory
    config_home = Path(os.environ.get("XDG_CONFIG_HOME") or home / ".config")
    if not _readable(config_home):
        private = own_directory()
        os.environ["XDG_CONFIG_HOME"] = str(private)
        messages.append(f"{config_home} cannot be read: options of dolfinx there are not used")
    elif "MPLCONFIGDIR" not in os.environ and not _allowed(config_home / "matplotlib"):
        # else matplotlib makes a directory for each process and logs it on the terminal
        os.environ["MPLCONFIGDIR"] = str(own_directory() / "matplotlib")
    return tuple(messages)


def _home() -> Path | None:
    """The home directory; None for a user without one."""
    try:
        return Path.home()
    except RuntimeError:
        return None


def _writable(directory: Path) -> bool:
    """Whether files can be made in a directory, which is made if it is not there."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=directory) as file:
            reserve(file.fileno(), ENOUGH)
    except OSError:
        return False
    return True


def _allowed(directory: Path) -> bool:
    """Whether files may be made in a directory or, if it does not exist, in its nearest parent."""
    existing = next(place for place in (directory, *directory.parents) if place.exists())
    return os.access(existing, os.W_OK | os.X_OK)


def _readable(directory: Path) -> bool:
    """Whether a file in a directory can be opened, or certainly does not exist."""
    for name in ("ffcx", "dolfinx"):
        try:
            with (directory / name / "none").open():
                pass
        except FileNotFoundError:
            continue
        except OSError:
            return False
    return True


@cache
def own_directory() -> Path:
    """A directory of this user alone below the system's directory for temporary files."""
    try:
        private = Path(tempfile.gettempdir()) / f"contact-app-{os.geteuid()}"
        private.mkdir(mode=0o700, exist_ok=True)
        if _is_private(private) and _writable(private):
            return private
        return Path(tempfile.mkdtemp(prefix="contact-app-"))
    except OSError as error:
        raise CouldNotRunError(
            f"no directory for compiled forms can be written ({error}); let HOME, XDG_CACHE_HOME "
            "or TMPDIR name a directory that can be"
        ) from error


def _is_private(directory: Path) -> bool:
    """Whether it is a real directory of this user without access for others."""
    status = directory.lstat()
    real, owned = stat.S_ISDIR(status.st_mode), status.st_uid == os.geteuid()
    return real and owned and not status.st_mode & 0o077
