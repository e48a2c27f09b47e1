"""`guidefield docs`: list the pages of the documentation, or show one, or a message, in the terminal.

A new page of service/docs goes into `CHAPTERS`.
"""

from __future__ import annotations

import os
import re
from importlib import resources
from typing import ClassVar

from rich import box
from rich.console import Console, ConsoleOptions, RenderResult
from rich.markdown import Markdown, MarkdownElement, TableElement
from rich.table import Table

from guidefield.errors import UnknownObject
from guidefield.messages.faults import MAX_QUOTED_CHARACTERS, suggest
from guidefield.messages.schemas import describe_message, make_schemas

CHAPTERS = {
    "Guide": ("quickstart", "robots", "scenes", "goals", "motions", "steps", "stream", "execution"),
    "Service": ("service", "operation", "recordings", "client", "ros", "mcp", "platforms"),
    "Proof": ("certify", "certificate", "referee"),
    "Reference": ("wire", "glossary"),
    "Background": ("algorithm", "benchmarks", "comparison"),
}
"""Subjects of the pages in a reader's order."""

_PACKAGE = "guidefield.docs"  # into which service/docs is installed
_LESS_OPTIONS = "FRX"  # options of `less`, as git sets them: colours, and no paging of a page that fits on the screen


def list_subjects() -> tuple[str, ...]:
    """List the subjects of the pages, in a reader's order."""
    return tuple(subject for subjects in CHAPTERS.values() for subject in subjects)


def read_page(subject: str) -> str:
    """Read the page about a subject, or describe a message such as PlanRequest, in Markdown.

    Raises:
        UnknownObject: if there is no such page or message; with the subjects.
    """
    available, messages = list_subjects(), make_schemas()["$defs"]
    if subject in messages:
        return describe_message(subject)
    if subject not in available:
        hint = suggest(subject, available) or suggest(subject, messages)
        raise UnknownObject(
            f"there is no page about {subject[:MAX_QUOTED_CHARACTERS]!r}; {hint}"
            f"there are {', '.join(available)}; and messages, such as PlanRequest",
            subject=subject[:MAX_QUOTED_CHARACTERS],
            available=list(available),
        )
    return resources.files(_PACKAGE).joinpath(f"{subject}.md").read_text(encoding="utf-8")


def first_sentence(text: str) -> str:
    """Return the first sentence of a page below its heading."""
    paragraph = text.split("\n\n")[1].replace("\n", " ")
    return re.split(r"(?<=[.!?]) ", paragraph, maxsplit=1)[0]


class _Table(TableElement):
    """A table of a page that cuts nothing off: a narrow terminal folds cells, but no name in the first column."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        for table in super().__rich_console__(console, options):
            assert isinstance(table, Table), "a table is rendered as one"
            for column in table.columns:
                column.overflow = "fold"
            names = [str(cell) for cell in table.columns[0].cells]
            table.columns[0].no_wrap = not any(" " in name for name in names)
            yield table


class Page(Markdown):
    """A page of the documentation for a terminal."""

    elements: ClassVar[dict[str, type[MarkdownElement]]] = {**Markdown.elements, "table_open": _Table}


def pages_table() -> Table:
    """Make a table of the subjects with the first sentence of each page."""
    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("subject", no_wrap=True)
    table.add_column("what it tells", overflow="fold")
    for subject in list_subjects():
        table.add_row(subject, Markdown(first_sentence(read_page(subject))))
    return table


def show_page(subject: str, out: Console) -> None:
    """Print the page about a subject; in a terminal, through a pager."""
    text = Page(read_page(subject))
    if not out.is_terminal:
        out.print(text)
        return
    os.environ.setdefault("LESS", _LESS_OPTIONS)
    with out.pager(styles=True):
        out.print(text)
