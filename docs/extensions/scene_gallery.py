"""Directive `gallery`: every scene of `sj.gallery` with its picture, what it is, and the call that makes it."""

import inspect
from pathlib import Path

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.errors import SphinxError

import spherejax as sj

PICTURES = Path(__file__).resolve().parents[1] / "pictures"


class SceneGallery(Directive):
    """One card a scene, in the order of their names."""

    def run(self) -> list[nodes.Node]:
        """Make the cards."""
        return [
            nodes.container("", *map(self.card, sj.gallery.__all__), classes=["scenes"])
        ]

    def card(self, name: str) -> nodes.container:
        """Picture, link and first sentence."""
        if not (PICTURES / f"scene_{name}.png").exists():
            raise SphinxError(
                f"the gallery's scene {name!r} has no picture: run `python docs/pictures.py scene_{name}`"
            )
        sentence = (
            (inspect.getdoc(getattr(sj.gallery, name)) or "")
            .split("\n\n")[0]
            .replace("\n", " ")
        )
        card = nodes.container(classes=["scene"])
        text = StringList(
            [
                f"![The mechanism {name}, in space](pictures/scene_{name}.png)",
                "",
                f"{{py:func}}`sj.gallery.{name} <spherejax.gallery.{name}>`",
                "",
                sentence,
            ]
        )
        self.state.nested_parse(text, self.content_offset, card)
        return card


def setup(app: Sphinx) -> dict:
    """Register the directive."""
    app.add_directive("gallery", SceneGallery)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
