"""Text that users read has the field's terms: pages, first lines of docstrings, messages and help."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent

BETTER = {
    r"\bgone on with\b": "resumed, resumes",
    r"\bkept on disk\b|\bkept[_/]": "cached on disk, disk cache",
    r"\btold by\b": "identified by, named by",
    r"\bcrews?\b": "worker pool",
    r"\bone_of_many\b": "batch setup",
    r"\bfighting[ _]drivers?\b|\bdrivers (that )?fight\b": "driver conflicts",
    r"\bbend[ _]of[ _]time\b": "time warp",
    r"\bworked_off\b": "queue, run_queue",
    r"\bfew_kernels\b": "loop fusion",
    r"\bbegun[ _]and[ _]seen\b": "update checks",
    r"\bwhat cannot be\b": "a violated invariant",
    r"\brepeat themselves\b": "periodic motion",
    r"\bnot used for longest\b": "least recently used",
    r"\bsoon rather than well\b": "compile time is favoured over run time",
    r"\bmay be given up\b": "say what does not hold",
    r"\bshares? of what is allowed\b": "violation over its limit",
    r"\bevery arrow\b": "each stage",
    r"\bhow numbers scatter\b|\bnumbers that scatter\b": "uncertain parameters",
    r"\bKNOWN_(SCENES|BUILDS)\b|\bknown_(scenes|builds)\b": "preparation, traced_functions",
    r"\b(behind_tracers|waiting_for|collecting_later|make_known|by_value|line_writer|NumbersNow)\b": "see the module",
}
"""What the project used to say, as regular expressions, and the term to search and to write."""

PAGES = [
    *ROOT.glob("*.md"),
    *(page for page in (ROOT / "docs").rglob("*.md") if "_build" not in page.parts),
]
SOURCES = sorted((ROOT / "spherejax").rglob("*.py"))
SAID_BY = {"help", "description", "epilog", "metavar"}
"""Arguments of the command line's parser that users read."""


def texts_of(path: Path) -> Iterator[tuple[int, str]]:
    """Lines of a page; of a source first lines of docstrings, and strings in raised errors, warnings and help."""
    if path.suffix == ".md":
        yield 1, path.read_text()
        return
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and (text := ast.get_docstring(node)):
            yield getattr(node, "lineno", 1), text.split("\n\n")[0]
        said: list[ast.AST] = [node] if isinstance(node, ast.Raise) else []
        if isinstance(node, ast.Call):
            said += [keyword.value for keyword in node.keywords if keyword.arg in SAID_BY]
            if getattr(node.func, "attr", getattr(node.func, "id", "")).startswith("warn"):
                said += node.args
        for part in said:
            for found in ast.walk(part):
                if isinstance(found, ast.Constant) and isinstance(found.value, str):
                    yield found.lineno, found.value


def old_words(path: Path) -> list[str]:
    """Where a file says what it should say otherwise."""
    found = []
    for line, text in texts_of(path):
        for pattern, better in BETTER.items():
            for match in re.finditer(pattern, text, re.IGNORECASE):
                at = line + text.count("\n", 0, match.start())
                found.append(f"{path.name}:{at}: {match[0]!r}; better: {better}")
    return found


def test_no_page_and_no_message_has_the_old_words():
    found = [where for path in (*PAGES, *SOURCES) for where in old_words(path)]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("page.md", "# Sweeps\n\nA store that is gone on with."),
        ("source.py", '"""What cannot be, at the end of any step, ends it."""'),
        ("source.py", "raise ValueError(f'{name}: only those of a film may be given up')"),
        ("source.py", "parser.add_argument('--out', help='store, can be gone on with')"),
        ("source.py", "warnings.warn('the program is kept on disk', stacklevel=2)"),
    ],
)
def test_old_words_are_seen(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    assert len(old_words(tmp_path / name)) == 1
