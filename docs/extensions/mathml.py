"""Equations as MathML, written at build time by Docutils: browsers show it themselves, without a script or a network.

An equation that the translator does not understand stops the build. The usual choice, MathJax, comes from a server or
as some megabytes of scripts, and shows its errors to the reader only.
"""

from docutils import nodes
from docutils.utils.math import latex2mathml, pick_math_environment
from sphinx.application import Sphinx
from sphinx.errors import SphinxError


def mathml(latex: str, *, as_block: bool) -> str:
    """An equation in MathML."""
    if as_block and "\\begin{" not in latex:
        environment = pick_math_environment(latex)
        latex = f"\\begin{{{environment}}}{latex}\\end{{{environment}}}"
    try:
        return latex2mathml.tex2mathml(latex, as_block=as_block)
    except Exception as error:
        raise SphinxError(f"equation {latex!r}: {error}") from error


def visit_inline(translator, node: nodes.math) -> None:
    """Write an inline equation."""
    translator.body.append(mathml(node.astext(), as_block=False))
    raise nodes.SkipNode


def visit_block(translator, node: nodes.math_block) -> None:
    """Write a displayed equation."""
    translator.body.append(f'<div class="equation">{mathml(node.astext(), as_block=True)}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict:
    """Register the renderer."""
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
