"""A page of HTML that needs nothing beside itself: headings, tables, pictures and a mechanism that turns.

Whatever a user named (bodies, joints, titles) is text here and never markup: everything passes through `escaped`. The
page forbids itself every request (`Content-Security-Policy`), and runs no script but the one whose digest it names.
"""

import base64
import hashlib
import html
import io
import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spherejax.files.paths.drafts import draft_of
from spherejax.foundations.errors import SceneError
from spherejax.output.paths import make_folder, require_free

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SUFFIX = ".html"

RESOLUTIONS = (120, 80, 55, 35)
"""Dots per inch of the pictures: the first with which all of them together are small enough."""

MOST_OF_PICTURES = 3_000_000
"""Bytes of all pictures, before they become text, which makes four of three; a page shall stay below 5 MB."""

MOST_ROWS = 400
"""Rows of a table; of a longer one the first are shown, and it says so."""


def escaped(value: Any) -> str:
    """Text for HTML, in elements and in quoted attributes."""
    return html.escape(str(value), quote=True)


def breakable(value: Any) -> str:
    """Text for a cell: names such as `joints.elbow.model.clearance` go on in the next line behind a dot or a dash."""
    return _BETWEEN_WORDS.sub(r"\1<wbr>", escaped(value))


_BETWEEN_WORDS = re.compile(r"(?<=\w)([._])(?=[A-Za-z])")


@dataclass(frozen=True)
class PageTable:
    """A table.

    Attributes:
        heads: of the columns.
        rows: cells as text.
        caption: what it is.
        numeric: whether all columns but the first are numbers, set to the right.
    """

    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    numeric: bool = False

    def html(self) -> str:
        """The markup."""
        caption = f"<caption>{escaped(self.caption)}</caption>" if self.caption else ""
        heads = "".join(f'<th scope="col">{escaped(head)}</th>' for head in self.heads)
        rows = "".join(
            f"<tr>{''.join(f'<td>{breakable(cell)}</td>' for cell in row)}</tr>\n" for row in self.rows[:MOST_ROWS]
        )
        left = len(self.rows) - MOST_ROWS
        more = f"<p>The first {MOST_ROWS:,} of {len(self.rows):,} rows.</p>" if left > 0 else ""
        kind = ' class="numeric"' if self.numeric else ""
        return (
            f'<div class="wide"><table{kind}>{caption}<thead><tr>{heads}</tr></thead>\n<tbody>{rows}</tbody></table>'
            f"</div>{more}"
        )


@dataclass(frozen=True)
class PageText:
    """Sentences, each a paragraph; of `fixed` ones the line breaks are kept."""

    sentences: Sequence[str]
    fixed: bool = False

    def html(self) -> str:
        """The markup."""
        if self.fixed:
            return f"<pre>{escaped(chr(10).join(self.sentences))}</pre>"
        return "".join(f"<p>{escaped(sentence)}</p>" for sentence in self.sentences)


@dataclass(frozen=True)
class PagePicture:
    """A figure of matplotlib, and what it shows, for those who do not see it."""

    figure: "Figure"
    shows: str

    def png(self, dpi: int) -> bytes:
        """As PNG."""
        data = io.BytesIO()
        self.figure.savefig(data, format="png", dpi=dpi, facecolor="white")
        return data.getvalue()

    def html(self, data: bytes) -> str:
        """The markup with the picture in it."""
        text = base64.b64encode(data).decode("ascii")
        # For a phone: narrower, letters would be smaller than they were drawn; wider, they gain nothing.
        inches = f"--inches: {self.figure.get_figwidth():.3g}"
        return f'<figure><img alt="{escaped(self.shows)}" style="{inches}" src="data:image/png;base64,{text}"></figure>'


@dataclass(frozen=True)
class PageMotion:
    """What the viewer shows: mechanisms as `output.report.motion` gives them."""

    mechanisms: Sequence[Mapping[str, Any]]

    def html(self) -> str:
        """The markup; the script finds its data beside it."""
        # A "<" in a name would end the element; as an escape it is the same text to JSON.
        text = json.dumps(list(self.mechanisms), allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
        return f'<div class="motion"><script type="application/json">{text}</script></div>'


@dataclass
class Section:
    """A heading and what stands below it; a `folded` one opens on a click."""

    title: str
    parts: list[PageTable | PageText | PagePicture | PageMotion]
    folded: bool = False


@dataclass
class Page:
    """A report.

    Attributes:
        title: what it is about.
        verdict: how it ended, one sentence.
        failed: what went wrong and what to do, in sentences; on top, in red.
        cautions: what is to be minded though nothing failed; below it, in amber.
        sections: in their order.
    """

    title: str
    verdict: str
    failed: list[str] = field(default_factory=list)
    cautions: list[str] = field(default_factory=list)
    sections: list[Section] = field(default_factory=list)

    def add(
        self, title: str, *parts: PageTable | PageText | PagePicture | PageMotion | None, folded: bool = False
    ) -> None:
        """Another section, of the parts that are not None; none without any."""
        there = [part for part in parts if part is not None and not (isinstance(part, PageTable) and not part.rows)]
        if there:
            self.sections.append(Section(title, there, folded))

    def html(self) -> str:
        """The whole file."""
        files = resources.files("spherejax.output.report")
        style, script = ((files / name).read_text(encoding="utf-8") for name in ("page.css", "viewer.js"))
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
        policy = f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{digest}'"
        pictures = self._pictures()
        parts = [self._section(number, section, pictures) for number, section in enumerate(self.sections)]
        entries = "".join(f'<a href="#s{i}">{escaped(one.title)}</a> ' for i, one in enumerate(self.sections))
        return (
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"<title>{escaped(self.title)}</title>\n<style>{style}</style>\n</head>\n<body>\n"
            f"<h1>{escaped(self.title)}</h1>\n{self._top()}<nav>{entries}</nav>\n{''.join(parts)}"
            f"<script>{script}</script>\n</body>\n</html>\n"
        )

    def _top(self) -> str:
        """The verdict, loud where something is wrong."""
        kind = "failed" if self.failed else "caution" if self.cautions else "fine"
        top = (
            f'<div class="verdict {kind}" role="{"alert" if self.failed else "status"}"><p>{escaped(self.verdict)}</p>'
        )
        top += "".join(f"<p>{escaped(each)}</p>" for each in self.failed) + "</div>\n"
        if self.cautions:
            entries = "".join(f"<li>{escaped(each)}</li>" for each in self.cautions)
            top += f'<div class="verdict caution" role="status"><p>To be minded:</p><ul>{entries}</ul></div>\n'
        return top

    def _section(self, number: int, section: Section, pictures: Mapping[int, bytes]) -> str:
        inside = "\n".join(
            part.html(pictures[id(part)]) if isinstance(part, PagePicture) else part.html() for part in section.parts
        )
        if section.folded:
            inside = f"<details><summary>Show</summary>{inside}</details>"
        return f'<section id="s{number}"><h2>{escaped(section.title)}</h2>\n{inside}\n</section>\n'

    def _pictures(self) -> dict[int, bytes]:
        """All pictures, as fine as fits."""
        every = [part for section in self.sections for part in section.parts if isinstance(part, PagePicture)]
        found: dict[int, bytes] = {}
        for dpi in RESOLUTIONS:
            found = {id(picture): picture.png(dpi) for picture in every}
            if sum(map(len, found.values())) <= MOST_OF_PICTURES:
                break
        return found

    def write(self, path: str | os.PathLike, *, overwrite: bool) -> Path:
        """Write the file.

        Raises:
            SceneError: as `target`, or where nothing can be written.
        """
        path = target(path, overwrite=overwrite)
        try:
            with draft_of(path) as draft:
                draft.write_text(self.html(), encoding="utf-8")
        except OSError as error:
            raise SceneError(f"cannot write {str(path)!r}: {error.strerror or error}") from error
        return path


def target(path: str | os.PathLike, *, overwrite: bool) -> Path:
    """The path of a report, with its folder made; called before what takes long.

    Raises:
        SceneError: for another ending, for an existing file without `overwrite`, or where no folder can be made.
    """
    path = Path(path).expanduser()
    if path.suffix.lower() != SUFFIX:
        raise SceneError(f"{str(path)!r}: a report is a page for a browser; give it the ending {SUFFIX}")
    require_free(path, overwrite=overwrite)
    make_folder(path.parent)
    return path


def pairs(rows: Iterable[tuple[str, Any]], caption: str = "") -> PageTable:
    """A table of names and values."""
    return PageTable(("quantity", "value"), [(name, str(value)) for name, value in rows], caption)
