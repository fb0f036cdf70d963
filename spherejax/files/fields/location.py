"""Where a value stands in a scene file, and errors that say so."""

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

from spherejax.files.fields.key_lines import KeyPath, key_lines, line_too_deep
from spherejax.foundations.errors import SceneError

DEEPEST = 50
"""How deep values may stand in values: a table in a function in a spring in a force is six."""


class Source(NamedTuple):
    """A text that was read.

    Attributes:
        path: the file.
        lines: line of each key.
    """

    path: Path
    lines: Mapping[KeyPath, int]


class FilePlace(NamedTuple):
    """A key of a file.

    Attributes:
        source: the file.
        keys: from the top of the file to the key.
    """

    source: Source
    keys: KeyPath = ()

    def __truediv__(self, key: str | int) -> "FilePlace":
        """A key below this one."""
        return FilePlace(self.source, (*self.keys, key))

    @property
    def line(self) -> int:
        """The line of the key, or of the nearest table above it that is written in the file."""
        for n in range(len(self.keys), 0, -1):
            if self.keys[:n] in self.source.lines:
                return self.source.lines[self.keys[:n]]
        return 1

    def fail(self, what: str) -> NoReturn:
        """Raise `SceneError` with file, line and key."""
        words = [f"[{key}]" if isinstance(key, int) else f".{key}" for key in self.keys]
        name = "".join(word if len(word) < 60 else f"{word[:57]}..." for word in words).removeprefix(".")
        raise SceneError(f"{self.source.path}:{self.line}: {name + ': ' if name else ''}{what}")


def read_toml(path: Path) -> tuple[dict[str, Any], FilePlace]:
    """The tables of a file, and the place of its top.

    Raises:
        SceneError: for a file that cannot be read, or is no TOML, with the line.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise SceneError(f"cannot read {str(path)!r}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise SceneError(f"{path}: is no UTF-8 text ({error.reason}); save it as UTF-8") from error
    text = text.removeprefix("\ufeff").replace("\r\n", "\n")
    line = line_too_deep(text, DEEPEST)
    if line is not None:
        raise SceneError(f"{path}:{line}: brackets in brackets, more than {DEEPEST} deep; no scene needs that")
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise SceneError(f"{path}: is no TOML: {error}") from error
    except ValueError as error:  # integers of more digits than Python reads
        long = re.search(r"[0-9_]{4300,}", text)
        line = 1 + text.count("\n", 0, long.start() if long else 0)
        raise SceneError(f"{path}:{line}: a number of thousands of digits; numbers have 64 bits ({error})") from error
    top = FilePlace(Source(path, key_lines(text)))
    _check_depth(tables, top)
    return tables, top


def _check_depth(tables: dict[str, Any], top: FilePlace) -> None:
    """Refuse tables in tables without end, written with dots; without recursion, for that is what they exhaust."""
    waiting: list[tuple[Any, FilePlace]] = [(tables, top)]
    while waiting:
        value, place = waiting.pop()
        if len(place.keys) > DEEPEST:
            FilePlace(place.source, place.keys[:3]).fail(
                f"tables in tables, more than {DEEPEST} deep; no scene needs that"
            )
        if isinstance(value, dict):
            waiting += [(entry, place / key) for key, entry in value.items()]
        elif isinstance(value, list) and any(isinstance(entry, dict | list) for entry in value):
            waiting += [(entry, place / i) for i, entry in enumerate(value)]
