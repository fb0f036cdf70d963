"""Files that are there whole, or not at all: written beside their place, and renamed when they are complete."""

import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def draft_of(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yields a path to write to, which takes the place of `path` at the end of the block; an exception leaves no trace.

    A reader, or a run that is stopped in the middle, never sees a part of a file. The draft has the same suffix,
    because many writers choose a format by it, and lies in the same folder, because only within one file system is a
    rename one operation, and because a scene file that is read back finds its code there. A file is replaced in one
    operation; of folders (Zarr stores) the old one is moved away first.

    Args:
        path: a file or a folder. What is neither (a pipe, a terminal) is written to as it is.

    Yields:
        The draft, a hidden name; the block makes a file or a folder of it.

    Raises:
        OSError: where nothing can be written.
    """
    # The file that a link leads to is replaced, not the link.
    target = Path(path).resolve()
    if target.exists() and not (target.is_file() or target.is_dir()):
        yield target
        return
    word = uuid.uuid4().hex[:12]  # two processes may write the same file at a time
    draft, replaced = (target.with_name(f".{word}.{part}{target.suffix}") for part in ("part", "replaced"))
    try:
        yield draft
        if draft.is_dir() and target.is_dir():
            target.rename(replaced)
        draft.replace(target)
    finally:
        for rest in (draft, replaced):
            if rest.is_dir():
                shutil.rmtree(rest, ignore_errors=True)
            else:
                rest.unlink(missing_ok=True)
