"""The folder of the cache: whose it is, what is in it, and how it stays small.

The files of the cache are code that is executed, so a folder in which somebody else could have written is not used
(`why_not_private`). In the folder stand `kept`, the entries of this cache, and `compiled-...`, JAX's compilation cache,
one for each kind of processor. This file imports no JAX.
"""

import hashlib
import os
import platform
import stat
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

MOST_BYTES = 2 * 2**30
"""Size above which the least recently used files are deleted [bytes]."""

LOOKED_AT_AGAIN_AFTER = 3600.0
"""Time after which a process that starts measures the size of the folder again [s]."""

ENTRIES = "kept"
"""The folder of entries within the cache; see `disk_cache`."""


class CacheFolder(NamedTuple):
    """A folder that was asked for.

    Attributes:
        path: without links.
        compiled: the folder within it for JAX's compilation cache.
        why_not: why it is not used, in words; empty where it is.
    """

    path: Path
    compiled: Path
    why_not: str


_in_use: list[Path] = []


def current() -> Path | None:
    """The folder of the cache; None where the disk cache is off."""
    return _in_use[-1] if _in_use else None


def entries() -> Path | None:
    """The folder of entries; None where the disk cache is off. It may not exist yet."""
    return _in_use[-1] / ENTRIES if _in_use else None


def use(path: Path) -> CacheFolder:
    """Keep entries in a folder from now on; where it is not private, nothing is kept.

    It is made where it is missing, with the folders above it.

    Args:
        path: the folder.

    Raises:
        OSError: where it cannot be made or written to; what was used before stays in use.
    """
    # One folder for each kind of processor: homes are shared between machines, compiled programs must not be.
    compiled = path.absolute() / f"compiled-{kind_of_processor()}"
    _make_private(compiled)
    if not os.access(compiled, os.W_OK):
        raise PermissionError(f"no permission to write to {compiled}")
    # Links are followed now: where they lead later is not looked at again.
    path, compiled = path.absolute().resolve(), compiled.resolve()
    why = why_not_private(compiled)
    if not why and (path / ENTRIES).exists():  # its files are looked at when they are opened
        why = why_not_private(path / ENTRIES, with_files=False)
    _in_use[:] = [] if why else [path]
    if not why:
        _make_room(path)
    return CacheFolder(path, compiled, why)


def _make_private(folder: Path) -> None:
    """Make a folder, and those above it that are missing, so that nobody else can enter, whatever the umask says."""
    for level in reversed((folder, *folder.parents)):
        if not level.exists():
            level.mkdir(mode=0o700, exist_ok=True)


def why_not_private(folder: Path, *, with_files: bool = True) -> str:
    """Why another user could have written a file of a folder, in words; empty where none could.

    The rules are those of ssh for its keys. The folder, its files and all folders above it belong to the user or to
    root, and others may write none of them. They may write a folder above that is sticky, such as `/tmp`, in which
    nobody moves what belongs to others. Where others cannot enter the folder, it does not matter whether they could
    write its files.

    "Others" are not the members of a group that has the user's name, is the user's main group, and has no further
    members: with a umask of 002, as on Debian and Fedora, all folders may be written by such a group.

    Args:
        folder: an absolute path without links, of a folder that exists. Systems without owners of files, such as
            Windows, have no answer but "".
        with_files: whether its files are looked at; it takes 2 us for each on a local disk.
    """
    if not hasattr(os, "getuid"):
        return ""
    own = folder.stat()
    if why := _why_others(folder, own, may_enter=True):
        return why
    for above in folder.parents:
        status = above.stat()
        # In a container this owner may be root; what counts is that others may not write.
        if _is_unmapped(status.st_uid) and not _is_open(status):
            continue
        if why := _why_others(above, status, may_enter=not status.st_mode & stat.S_ISVTX):
            return why
    if with_files:
        may_enter = bool(own.st_mode & (stat.S_IXGRP | stat.S_IXOTH))
        with os.scandir(folder) as entries:
            for entry in entries:
                if why := _why_others(Path(entry.path), entry.stat(follow_symlinks=False), may_enter=may_enter):
                    return why
    return ""


def _why_others(path: Path, status: os.stat_result, *, may_enter: bool) -> str:
    """Why others than the user and root could have written something, in words."""
    if status.st_uid not in (0, os.getuid()):
        return f"{str(path)!r} belongs to {_user(status.st_uid)}"
    return f"others may write to {str(path)!r}" if may_enter and _is_open(status) else ""


def _is_open(status: os.stat_result) -> bool:
    """Whether somebody besides its owner and root may write."""
    by_group = status.st_mode & stat.S_IWGRP and not _is_private(status.st_gid)
    return bool(status.st_mode & stat.S_IWOTH or by_group)


@cache
def _is_private(group: int) -> bool:
    """Whether nobody but the user, and root, is in a group."""
    import grp
    import pwd

    try:
        user, entry = pwd.getpwuid(os.getuid()), grp.getgrgid(group)
    except KeyError:  # a container that does not know its user
        return False
    is_users = (entry.gr_name, group) == (user.pw_name, user.pw_gid)
    return set(entry.gr_mem) <= {user.pw_name, "root"} and (is_users or group == 0)


def _user(uid: int) -> str:
    import pwd

    try:
        return f"the user {pwd.getpwuid(uid).pw_name!r}"
    except KeyError:
        return f"another user ({uid})"


@cache
def _is_unmapped(uid: int) -> bool:
    """Whether this number stands for all users that a container does not know, root among them.

    So in Apptainer without privileges: folders above a home belong to "nobody" there.
    """
    try:
        rows = Path("/proc/self/uid_map").read_text().splitlines()
        overflow = int(Path("/proc/sys/kernel/overflowuid").read_text())
        ranges = [range(int(first), int(first) + int(n)) for first, _, n in map(str.split, rows)]
    except (OSError, ValueError):
        return False
    return uid == overflow and not any(uid in numbers for numbers in ranges)


def _make_room(folder: Path) -> None:
    """Delete the least recently used files where the folder is larger than `MOST_BYTES`.

    JAX has a bound of its own, for which it reads two files for each that is there whenever it writes one.
    """
    looked = folder / "looked-at"
    try:
        if looked.exists() and time.time() - looked.stat().st_mtime < LOOKED_AT_AGAIN_AFTER:
            return
        looked.touch()  # first, so that of processes that start together one makes room
        files = [file for part in (ENTRIES, "compiled-*") for file in folder.glob(f"{part}/*")]
        # The later of both times: file systems may be mounted without times of access, or with coarse ones.
        by_age = sorted((max(of.st_atime, of.st_mtime), of.st_size, file) for file, of in _sized(files))
        total = sum(size for _, size, _ in by_age)
        for _, size, file in by_age:
            if total <= MOST_BYTES:
                return
            file.unlink(missing_ok=True)
            total -= size
    except OSError:  # another process makes room as well, or the folder may be read only
        return


def _sized(files: list[Path]) -> Iterator[tuple[Path, os.stat_result]]:
    for file in files:
        with suppress(FileNotFoundError):
            yield file, file.stat()


_WORDS_OF_PROCESSORS = frozenset(
    ["processor", "model name", "flags", "Features", "CPU implementer", "CPU architecture", "CPU variant", "CPU part"]
)
"""Fields of /proc/cpuinfo that tell processors apart: x86 has a name and flags, ARM features and numbers for a name."""


def _name_of_apples() -> str:
    """The processor of a Mac, e.g. "Apple M2"; `platform.processor` says "arm" of all of them.

    A home that was copied from an M4 to an M1 contains programs that an M1 cannot run.
    """
    import subprocess

    command = ["/usr/sbin/sysctl", "-n", "machdep.cpu.brand_string"]
    try:
        return subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=10, check=True).stdout
    except (OSError, subprocess.SubprocessError):
        return platform.processor()


@cache
def kind_of_processor() -> str:
    """A short name of what the compiler makes its code for."""
    words = {"machine": platform.machine(), "system": platform.system()}
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
            for line in file:  # one processor after the other, each in as many lines; all are of a kind
                name = line.partition(":")[0].strip()
                if name == "processor" and name in words:
                    break
                if name in _WORDS_OF_PROCESSORS:
                    words[name] = line
    except OSError:
        words["name"] = platform.processor() if sys.platform != "darwin" else _name_of_apples()
    return hashlib.sha256(repr(sorted(words.items())).encode()).hexdigest()[:8]
