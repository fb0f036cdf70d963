"""On which line of a TOML text each key stands: parsers tell lines for broken syntax only, not for a wrong value.

The text has been parsed before, so its syntax is known to be right; what is left is to walk over it.
"""

import re
from bisect import bisect_left

KeyPath = tuple[str | int, ...]
"""Keys from the top of the file to a value; positions in lists count from 0."""

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_SPACE = re.compile(r"[ \t]*")
_BLANK = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_NUMBER_OR_WORD = re.compile(r"[^,\]}#\r\n]+")
_STRING = re.compile(
    r'"""(?:[^\\]|\\.)*?"""(?:"{1,2}(?!"))?'
    r"|'''.*?'''(?:'{1,2}(?!'))?"
    r'|"(?:[^"\\\n]|\\.)*"'
    r"|'[^'\n]*'",
    re.DOTALL,
)

_MARK = re.compile(rf"{_STRING.pattern}|#[^\n]*|[\[\]{{}}\n]", re.DOTALL)
"""What counts for the depth of brackets: brackets, ends of lines, and strings and comments, in which they do not."""


def key_lines(text: str) -> dict[KeyPath, int]:
    """The line, counted from 1, on which each key, table and list entry of a legal TOML text begins."""
    return _Walk(text).lines


def line_too_deep(text: str, deepest: int) -> int | None:
    """The line on which brackets stand in more brackets than the deepest, in any text; None where there are none.

    To be asked before a text is parsed: parsers, and the walk below, go down with the brackets, and the stack ends.
    """
    depth, line = 0, 1
    for found in _MARK.finditer(text):
        mark = found.group()
        line += mark.count("\n")
        depth += (mark in "[{") - (mark in "]}")
        if depth > deepest:
            return line
    return None


class _Walk:
    """One pass over the text; `at` is the next character."""

    def __init__(self, text: str):
        self.text, self.at = text, 0
        self.ends = [found.start() for found in re.finditer("\n", text)]
        self.lines: dict[KeyPath, int] = {}
        self.table: KeyPath = ()
        self.n_entries: dict[KeyPath, int] = {}
        self._skip(_BLANK)
        while self.at < len(text):
            self._header() if text[self.at] == "[" else self._pair(self.table)
            self._skip(_BLANK)

    def _header(self) -> None:
        """`[a.b]` or `[[a.b]]`."""
        line = self._line()
        is_list = self.text.startswith("[[", self.at)
        self.at += 2 if is_list else 1
        keys = self._dotted_key()
        self.at += 2 if is_list else 1
        path: KeyPath = ()
        for key in keys[:-1]:
            path = self._newest((*path, key))
        path = (*path, keys[-1])
        self.lines.setdefault(path, line)
        if is_list:
            self.n_entries[path] = self.n_entries.get(path, 0) + 1
        self.table = self._newest(path)
        self.lines.setdefault(self.table, line)

    def _newest(self, path: KeyPath) -> KeyPath:
        """The path itself, or that of the newest entry where it is a list of tables."""
        return (*path, self.n_entries[path] - 1) if path in self.n_entries else path

    def _pair(self, table: KeyPath) -> None:
        """`a.b = value`."""
        line = self._line()
        keys = self._dotted_key()
        for n in range(1, len(keys) + 1):
            self.lines.setdefault((*table, *keys[:n]), line)
        self.at += 1  # the equals sign
        self._skip(_SPACE)
        self._value((*table, *keys))

    def _value(self, path: KeyPath) -> None:
        opening = self.text[self.at]
        if opening == "[":
            self._list(path)
        elif opening == "{":
            self._inline_table(path)
        else:
            self._skip(_STRING if opening in "\"'" else _NUMBER_OR_WORD)

    def _list(self, path: KeyPath) -> None:
        self.at += 1
        self._skip(_BLANK)
        position = 0
        while self.text[self.at] != "]":
            self.lines[(*path, position)] = self._line()
            self._value((*path, position))
            self._skip_comma()
            position += 1
        self.at += 1

    def _inline_table(self, path: KeyPath) -> None:
        self.at += 1
        self._skip(_BLANK)
        while self.text[self.at] != "}":
            self._pair(path)
            self._skip_comma()
        self.at += 1

    def _skip_comma(self) -> None:
        self._skip(_BLANK)
        if self.text[self.at] == ",":
            self.at += 1
            self._skip(_BLANK)

    def _dotted_key(self) -> list[str]:
        keys = []
        while True:
            self._skip(_SPACE)
            quoted = self.text[self.at] in "\"'"
            key = self._skip(_STRING if quoted else _BARE)
            keys.append(_unquoted(key) if quoted else key)
            self._skip(_SPACE)
            if self.text[self.at] != ".":
                return keys
            self.at += 1

    def _skip(self, pattern: re.Pattern[str]) -> str:
        found = pattern.match(self.text, self.at)
        if found is None:
            return ""
        self.at = found.end()
        return found.group()

    def _line(self) -> int:
        return bisect_left(self.ends, self.at) + 1


def _unquoted(key: str) -> str:
    """A quoted key as the parser reads it."""
    import tomllib

    return next(iter(tomllib.loads(f"{key} = 0")))
