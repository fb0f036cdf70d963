"""The commit of the user's working folder, read from git's own files.

The program git is not run: it executes commands that the repository's configuration names (`core.fsmonitor`,
`core.pager`, filters), and the working folder may be somebody else's archive.
"""

import re
from pathlib import Path

UNKNOWN = "unknown"

_HASH = re.compile(r"[0-9a-f]{40}|[0-9a-f]{64}")
"""A commit: SHA-1 or SHA-256."""

_BRANCH = re.compile(r"refs/[\w.+@=-]+(?:/[\w.+@=-]+)*")
"""A reference whose file lies within the repository; git forbids `..` in it as well."""

LARGEST = 16 * 2**20
"""Bytes of a file beyond which it is not read: `packed-refs` has 60 for each reference."""


def commit_of(folder: Path) -> str:
    """The commit that is checked out in a folder, its first twelve digits; "unknown" where there is none.

    Changes that are not committed are not seen: only git itself can compare files with its index.

    Args:
        folder: the working folder; the repository may be a parent of it.
    """
    try:
        repository = next((each for each in (folder, *folder.parents) if (each / ".git").exists()), None)
        return UNKNOWN if repository is None else _head(_git_folder(repository / ".git"))
    except (OSError, ValueError):  # no permission, a link to itself, a text that is none
        return UNKNOWN


def _git_folder(git: Path) -> Path:
    """The folder of a repository's data: `.git` itself or, for a worktree or a submodule, the folder that it names."""
    if git.is_dir():
        return git
    kind, _, named = _text(git).partition(":")
    if kind != "gitdir":
        raise ValueError(f"{git} does not name a folder")
    return git.parent / named.strip()


def _head(git: Path) -> str:
    head = _text(git / "HEAD")
    if not head.startswith("ref:"):
        return _short(head)
    branch = head.removeprefix("ref:").strip()
    if not _BRANCH.fullmatch(branch) or ".." in branch:
        return UNKNOWN
    # Branches of a worktree lie in the repository that it belongs to.
    shared = git / _text(git / "commondir") if (git / "commondir").exists() else git
    for place in (git, shared):
        if (place / branch).is_file():
            return _short(_text(place / branch))
    if (shared / "packed-refs").is_file():
        for line in _text(shared / "packed-refs").splitlines():
            commit, _, name = line.partition(" ")
            if name == branch:
                return _short(commit)
    return UNKNOWN  # a branch without a commit, or references in a table (reftable)


def _short(commit: str) -> str:
    return commit[:12] if _HASH.fullmatch(commit) else UNKNOWN


def _text(file: Path) -> str:
    if not file.is_file() or file.stat().st_size > LARGEST:  # a pipe would be waited for
        raise ValueError(f"{file} is no file of git's")
    return file.read_text(encoding="utf-8").strip()
