"""Runs the code of the documentation: every block of a page, from top to bottom, in one namespace and one folder.

    python docs/examples.py                 # all pages
    python docs/examples.py howto/fit.md    # one
    python docs/examples.py --show index.md # and what its code prints

* `python` blocks are executed; they share their names.
* `console` blocks are lines that begin with `spherejax`: they are run as commands.
* `{code-block}` with a `:caption:` is a file of that name, which is written into the folder first.
* `text` blocks are what the block before them prints. Numbers are rounded to the digits that the page shows, `~` stands
  before one that differs from machine to machine, `...` for lines left out; white space does not count.
* `sh` blocks are for the reader (installation, Jupyter) and are not run; they hold no `spherejax` command.
"""

import contextlib
import io
import os
import re
import shlex
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).resolve().parent
FENCE = re.compile(
    r"^```(?P<head>\S[^\n]*)\n(?P<body>.*?)^```[ ]*$", re.MULTILINE | re.DOTALL
)
CAPTION = re.compile(r"^:caption: (.*)$", re.MULTILINE)
SHOWN_ONLY = ("sh", "none")


class Block(NamedTuple):
    """A block of code.

    Attributes:
        language: as behind the fence.
        file: the name of the file that it is; empty where it is none.
        code: the text.
        line: number of its first line on the page.
    """

    language: str
    file: str
    code: str
    line: int


class ExampleError(Exception):
    """An example failed; the message names page and line."""


def pages() -> list[Path]:
    """All pages that have something to run."""
    found = [path for path in sorted(HERE.rglob("*.md")) if "_build" not in path.parts]
    return [path for path in found if any(True for _ in blocks(path.read_text()))]


def blocks(text: str, also_shown: tuple[str, ...] = ()) -> Iterator[Block]:
    """The blocks of a page that are run, or compared with what is printed.

    Args:
        text: the page.
        also_shown: further languages whose blocks are not run.
    """
    for match in FENCE.finditer(text):
        head, body = match["head"].strip(), match["body"]
        line = text.count("\n", 0, match.start("body")) + 1
        if head in ("python", "console", "text"):
            yield Block(head, "", body, line)
        elif head.startswith("{code-block}"):
            caption = CAPTION.search(body)
            if caption is None:
                raise ExampleError(
                    f"line {line}: a code-block without :caption: is no file; use a plain fence"
                )
            content = body[caption.end() :].lstrip("\n")
            yield Block(
                head.removeprefix("{code-block}").strip(),
                caption[1].strip(),
                content,
                line,
            )
        elif not head.startswith("{") and head not in (*SHOWN_ONLY, *also_shown):
            raise ExampleError(
                f"line {line}: blocks of {head!r} are not run; see docs/examples.py for those that are"
            )


def run_page(
    path: Path, folder: Path, *, show: bool = False, also_shown: tuple[str, ...] = ()
) -> None:
    """Run all blocks of a page, in a folder of its own; `show` prints what they print; the rest is as in `blocks`."""
    namespace: dict = {"__name__": "__main__"}
    printed = ""
    with contextlib.chdir(folder):
        sys.path.insert(0, str(folder))
        try:
            for block in blocks(path.read_text(), also_shown):
                where = f"{path.relative_to(HERE.parent)}, line {block.line}"
                if block.file:
                    Path(block.file).write_text(block.code)
                elif block.language == "text":
                    compare(block.code, printed, where)
                else:
                    printed = run_block(block, namespace, where)
                    if show and printed:
                        print(f"{where} prints\n{printed}")
        finally:
            sys.path.remove(str(folder))


def run_block(block: Block, namespace: dict, where: str) -> str:
    """Run Python or commands; what they print."""
    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        try:
            if block.language == "python":
                exec(
                    compile("\n" * (block.line - 1) + block.code, where, "exec"),
                    namespace,
                )
            else:
                run_commands(block.code)
        except Exception as error:
            raise ExampleError(f"{where}: {traceback.format_exc()}") from error
    return output.getvalue()


def run_commands(lines: str) -> None:
    """Run lines that begin with `spherejax`; a trailing backslash continues a line."""
    from spherejax.cli import main

    for line in lines.replace("\\\n", " ").splitlines():
        words = shlex.split(line, comments=True)
        if not words:
            continue
        if words[0] != "spherejax":
            raise ExampleError(
                f"a console block runs spherejax alone, and not {line!r}"
            )
        code = main(words[1:])
        if code:
            raise ExampleError(f"{line!r} ended with exit code {code}")


def compare(expected: str, printed: str, where: str) -> None:
    """Raise when what was printed is not what the page shows.

    A page shows numbers as a reader wants them: rounded. A number stands for whatever rounds to its digits, and `~3.2`
    for what is measured and differs from machine to machine, or hangs on rounding: up to thirty times more or less.
    """
    match = re.fullmatch(pattern_of(expected), " ".join(printed.split()), re.DOTALL)
    shown = SHOWN_NUMBER.findall(" ".join(expected.split()))
    if match is None or not all(map(is_rounded, shown, match.groups())):
        raise ExampleError(
            f"{where}: the page shows\n{expected}\nand the code prints\n{printed}"
        )


NUMBER = (
    r"(?<![\w.])[-+]?(?:\d{1,3}(?:,\d{3})+|\d+)(?:\.\d*)?(?:[eE][-+]?\d+)?(?![\w]*\d)"
)
SHOWN_NUMBER = re.compile(r"(?!~0(?![\w.]))~?" + NUMBER + r"(?![\w.]*\.\.)")
"""On a page; digits that go on in an ellipsis are text, and so is the `~` of a printed `~0`."""


def pattern_of(expected: str) -> str:
    """The regular expression of what a page shows: a group for each number, anything for `...`, and any white space."""
    text = " ".join(expected.split())
    parts, end = [], 0
    for number in SHOWN_NUMBER.finditer(text):
        parts += [_plain(text[end : number.start()]), f"({NUMBER})"]
        end = number.end()
    return "".join([*parts, _plain(text[end:])])


def _plain(text: str) -> str:
    """Text by itself; brackets and commas of arrays are spaced as their numbers are wide."""
    found = ".*?".join(re.escape(part) for part in text.split("..."))
    return (
        re.sub(r"(?:\\ )+", r"\\s*", found)
        .replace(r"\[", r"\[\s*")
        .replace(r"\]", r"\s*\]")
    )


def is_rounded(shown: str, printed: str) -> bool:
    """Whether a number on a page is the printed one, rounded to the digits that the page shows."""
    shown, printed = shown.replace(",", ""), printed.replace(",", "")
    if shown.startswith("~"):
        about, value = abs(float(shown[1:])), abs(float(printed))
        return about / 30 <= value <= 30 * about
    mantissa, _, exponent = shown.lower().partition("e")
    decimals = len(mantissa.partition(".")[2])
    unit = 10.0 ** (int(exponent or 0) - decimals)
    return abs(float(shown) - float(printed)) <= 0.5000001 * unit


def main(names: list[str]) -> int:
    """Run the pages named, or all; the number of those that fail."""
    os.environ.setdefault("MPLBACKEND", "Agg")
    failed, show = 0, "--show" in names
    names = [name for name in names if name != "--show"]
    for path in [HERE / name for name in names] or pages():
        started = time.process_time()
        with tempfile.TemporaryDirectory() as folder:
            try:
                run_page(path, Path(folder), show=show)
                print(
                    f"{path.relative_to(HERE)}: {time.process_time() - started:.1f} s of processor time",
                    flush=True,
                )
            except ExampleError as error:
                failed += 1
                print(error, file=sys.stderr)
    return failed


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
