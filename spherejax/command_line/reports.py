"""The option `--report`: a page of HTML about what a command has made."""

from __future__ import annotations

import argparse
from typing import Any

import spherejax as sj


def add_report(group, what: str) -> None:
    """The option, in a group of files."""
    group.add_argument(
        "--report", metavar="FILE", help=f"write a page about {what}, with the mechanism in space: .html"
    )


def check_report(options: argparse.Namespace) -> None:
    """Refuse a path that cannot be written, before anything is computed."""
    if options.report is not None:
        from spherejax.output.report.page import target

        target(options.report, overwrite=options.overwrite)


def write_report(options: argparse.Namespace, result: Any, title: str, scene: sj.Scene | None = None) -> None:
    """Write the page where one is asked for."""
    if options.report is not None:
        path = sj.report(result, options.report, scene=scene, title=title, overwrite=options.overwrite)
        print(f"wrote {path}")
