"""Files that appear complete or not at all."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def part_of(path: Path) -> Path:
    """Name of a file while it is being written.

    >>> str(part_of(Path("out/summary.json")))
    'out/.summary.json.part'
    """
    return path.with_name(f".{path.name}.part")


@contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """Context manager with a temporary name for a file, which is renamed at the end of the block.

    If the block ends by an exception, the incomplete file is removed and an older file stays.
    """
    part = part_of(path)
    try:
        yield part
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
