"""Equations as MathML, written at build time: browsers show it themselves, without a script or a network.

The usual choice, MathJax, comes from a server or as megabytes of scripts, and shows its errors to the reader only; here
an equation that is not understood stops the build. Few systems have a font with mathematical tables, so the glyphs that
the pages use are taken along, as a subset of STIX Two Math (SIL Open Font License; the package ziamath brings it).
"""

import importlib.resources
import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

from docutils import nodes
from fontTools import subset
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.errors import SphinxError

FONT = "math.woff"
"""Name in the static folder; the style sheet refers to it."""

ALWAYS = "0123456789+-=()[]{}|,./ \u221a\u2212\u2032"
"""What an equation may show without saying so, first of all the radical of a root."""


ALPHABETS = (
    (0x61, 0x7A, 0x1D44E),
    (0x41, 0x5A, 0x1D434),
    (0x3B1, 0x3C9, 0x1D6FC),
    (0x391, 0x3A9, 0x1D6E2),
)
"""First and last letter of an alphabet (Latin and Greek, small and capital), and its first mathematical italic."""


PARTS = {
    "mfrac": 2,
    "mroot": 2,
    "msub": 2,
    "msup": 2,
    "mover": 2,
    "munder": 2,
    "msubsup": 3,
    "munderover": 3,
}
"""How many parts an element must have; the translator leaves out what an equation lacks."""


def mathml(latex: str, *, as_block: bool) -> str:
    """An equation in MathML."""
    try:
        written = convert(latex, display="block" if as_block else "inline")
    except Exception as error:
        raise SphinxError(
            f"equation {latex!r}: {type(error).__name__} {error}"
        ) from error
    unknown = re.search(r"<m[iot][^>]*>(\\[A-Za-z]+)", written)
    if unknown:
        raise SphinxError(f"equation {latex!r}: {unknown[1]} is not understood")
    if latex.count("{") != latex.count("}") or any(
        len(node) != PARTS.get(node.tag, len(node)) for node in nodes_of(written)
    ):
        raise SphinxError(f"equation {latex!r}: something is missing")
    return _tightened(written)


def _tightened(written: str) -> str:
    """Bars, slashes and signs without the space of a relation: MathML cannot know which kind they are."""
    written = re.sub(
        r'<mo(?: stretchy="false")?>(&#x0007C;|/|&#x0002F;)</mo>',
        r'<mo stretchy="false" lspace="0" rspace="0">\1</mo>',
        written,
    )
    return re.sub(
        r"(&#x00028;</mo>)<mo>(&#x02212;|&#x0002D;|-)</mo>",
        r'\1<mo form="prefix">\2</mo>',
        written,
    )


def nodes_of(written: str) -> Iterator[ElementTree.Element]:
    """The elements of an equation, with their names alone."""
    for node in ElementTree.fromstring(written).iter():
        node.tag = node.tag.rpartition("}")[2]
        yield node


def visit_inline(translator, node: nodes.math) -> None:
    """Write an inline equation."""
    _write(translator, mathml(node.astext(), as_block=False))


def visit_block(translator, node: nodes.math_block) -> None:
    """Write a displayed equation."""
    _write(
        translator,
        f'<div class="equation">{mathml(node.astext(), as_block=True)}</div>\n',
    )


def _write(translator, written: str) -> None:
    translator.body.append(written)
    raise nodes.SkipNode


def write_font(app: Sphinx, failure: Exception | None) -> None:
    """The part of the font that the equations of all pages use."""
    if failure is not None or app.builder.format != "html":
        return
    pages = Path(app.outdir).rglob("*.html")
    equations = [
        found
        for page in pages
        for found in re.findall(r"<math.*?</math>", page.read_text(), re.DOTALL)
    ]
    plain = re.sub(r"<[^>]*>", "", "".join(equations))
    letters = {
        int(code, 16) for code in re.findall(r"&#x([0-9A-Fa-f]+);", plain)
    } | set(map(ord, plain + ALWAYS))
    options = subset.Options(flavor="woff", layout_features=["*"], notdef_outline=True)
    with importlib.resources.as_file(
        importlib.resources.files("ziamath.fonts") / "STIXTwoMath-Regular.ttf"
    ) as path:
        font = subset.load_font(str(path), options)
    chosen = subset.Subsetter(options)
    chosen.populate(unicodes=letters | set(map(_italic, letters)))
    chosen.subset(font)
    subset.save_font(font, str(Path(app.outdir) / "_static" / FONT), options)


def _italic(code: int) -> int:
    """The mathematical italic letter with which browsers show a single letter."""
    if chr(code) == "h":
        return 0x210E
    for first, last, start in ALPHABETS:
        if first <= code <= last:
            return start + code - first
    return code


def setup(app: Sphinx) -> dict:
    """Register the renderer."""
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
    app.connect("build-finished", write_font)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
