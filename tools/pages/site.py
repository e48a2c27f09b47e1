"""The documentation as a site: pages of `service/docs`, references made from the code, and the gallery, for MkDocs."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import guidefield
from guidefield.cli import documentation
from guidefield.messages.schemas import describe_message, make_schemas

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
DOCS = ROOT / "service" / "docs"
PICTURES = ROOT / "tools" / "pictures" / "made"

MADE_PAGES = {"Reference": ("messages", "api"), "Background": ("gallery",)}
"""Pages that are made here, by the chapter that they are in."""

CHAPTERS = {chapter: (*names, *MADE_PAGES.get(chapter, ())) for chapter, names in documentation.CHAPTERS.items()} | {
    "Project": ("contributing", "changelog", "security")
}
"""Pages in a reader's order."""


PROJECT_PAGES = {
    "index": "README.md",
    "contributing": "CONTRIBUTING.md",
    "changelog": "CHANGELOG.md",
    "security": "SECURITY.md",
}

ROOM_TITLES = {
    "engine": "Plan in this process",
    "client": "Ask a service",
    "stream.in_process": "Streams",
    "messages.requests": "Requests",
    "messages.replies": "Replies",
    "messages.streams": "Messages of streams",
    "messages.scene": "Obstacles and scenes",
    "messages.scene_changes": "Changes of scenes",
    "messages.values": "Values",
    "messages.certify_reply": "Executed motions",
    "arrays": "Runs as arrays",
    "endpoint.service": "Serve",
    "errors": "Errors",
}
"""Sections of the API's page, by the module that holds the public names."""

CAPTIONS = {
    "shelf": "A Panda reaches between the boards of a bookshelf",
    "window": "A UR5 reaches through a window",
    "door": "A Panda waits for a door",
    "gates": "A chain of six links passes three gates",
    "stream": "A Panda serves at a table while boxes drift through",
    "kitchen": "A Panda takes a can from a shelf and puts it on a table",
    "objectives": "The same request with each objective",
    "failure": "A start in collision: the bodies are red",
    "tab": "A tab of a recording",
    "seed": "A scene of the thesis, light at the start and dark at the goal",
}
"""Captions of pictures, by their names or the first part of these."""

PAGE = ".md"

FENCE = re.compile(r"^```(\w+) ([^\n]+)$", re.MULTILINE)
LINK = re.compile(r"(\]\()(?!https?://|#|mailto:)([^)#\s]+)")
LAYER = re.compile(r"^    (\w+)\[\"(.*)\"\]$", re.MULTILINE)
DIAGRAM = re.compile(r"^```mermaid\n(.*?)^```\n", re.DOTALL | re.MULTILINE)


def build_site(target: Path, source: Path) -> None:
    """Write the pages into `source`, and have MkDocs build the site into `target`.

    Raises:
        subprocess.CalledProcessError: if MkDocs fails, or warns of a link that leads nowhere.
    """
    shutil.rmtree(source, ignore_errors=True)
    pages = source / "pages"
    shutil.copytree(PICTURES, pages / "pictures")
    for name, text in make_pages().items():
        (pages / f"{name}.md").write_text(text)
    for file in find_linked_files():
        (pages / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / file, pages / file)
    shutil.copyfile(DOCS / "wire.schema.json", pages / "wire.schema.json")
    shutil.copyfile(HERE / "site.css", pages / "site.css")
    settings = source / "mkdocs.yml"
    settings.write_text(json.dumps(make_settings(pages, target), indent=1))  # JSON is YAML
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "-f", str(settings)]
    subprocess.run(command, check=True, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"})  # advertisement of a successor


def make_pages() -> dict[str, str]:
    """Make every page in Markdown, by its name in the site."""
    pages = {path.stem: path.read_text() for path in DOCS.glob("*.md")}
    pages |= {name: (ROOT / file).read_text() for name, file in PROJECT_PAGES.items()}
    pages = {name: adapt_page(text) for name, text in pages.items()}
    pages["wire"] = link_messages(pages["wire"])
    return pages | {"messages": make_messages_page(), "api": make_api_page(), "gallery": make_gallery_page()}


def adapt_page(text: str) -> str:
    """Adapt links, code blocks and diagrams of a page to the site."""
    text = FENCE.sub(lambda fence: f"```{fence[1]}{file_title(fence[2])}", text)
    text = DIAGRAM.sub(lambda diagram: make_layers_table(diagram[1]), text)
    return LINK.sub(lambda link: f"{link[1]}{site_target(link[2])}", text)


def file_title(words: str) -> str:
    """The title of a code block whose words end with the name of a file."""
    name = words.rsplit(maxsplit=1)[-1]
    return f' title="{name}"' if "." in name else ""


def site_target(target: str) -> str:
    """Return where a link of a page leads within the site."""
    name = target.rpartition("/")[2]
    stems = {file: f"{page}.md" for page, file in PROJECT_PAGES.items()}
    if name in stems:
        return stems[name]
    if name.endswith(".webp"):
        return f"pictures/{name}"
    if name.endswith(".md"):
        return name
    return target.removeprefix("../../")


def find_linked_files() -> list[Path]:
    """Find the files of the source that pages link to, other than pages and pictures; paths from the root."""
    texts = [path.read_text() for path in (*DOCS.glob("*.md"), *(ROOT / file for file in PROJECT_PAGES.values()))]
    targets = {site_target(link[2]) for text in texts for link in LINK.finditer(text)}
    return sorted(Path(target) for target in targets if "/" in target and not target.startswith("pictures/"))


def make_layers_table(diagram: str) -> str:
    """Make a table of the diagram of layers, from the top down."""
    layers = dict(LAYER.findall(diagram))
    order = re.findall(r"^    (\w+ -->.*)$", diagram, re.MULTILINE)
    names = order[0].split(" --> ") if order else list(layers)
    rows = [
        "<br>".join(part.strip().replace("<b>", "**").replace("</b>", "**") for part in layers[name].split("|"))
        for name in names
    ]
    return "| layers, from the top down |\n|---|\n" + "".join(f"| {row} |\n" for row in rows)


def link_messages(text: str) -> str:
    """Link the messages that a page names in code to their descriptions."""
    names = "|".join(sorted(make_schemas()["$defs"], key=len, reverse=True))
    return re.sub(rf"(?<!\[)`({names})`", lambda name: f"[`{name[1]}`](messages{PAGE}#{name[1].lower()})", text)


def make_messages_page() -> str:
    """Describe every message with its fields, in alphabetical order."""
    names = sorted(make_schemas()["$defs"])
    known = re.compile(rf"\b({'|'.join(sorted(names, key=len, reverse=True))})\b")
    sections = []
    for name in names:
        _, _, text = describe_message(name).partition("\n")
        rows = [
            re.sub(r"^(\| `\w+` \| )([^|]*)", lambda row: row[1] + known.sub(link_message, row[2]), line)
            for line in text.splitlines()
        ]
        sections.append(f"## {name}\n" + "\n".join(rows))
    return (
        "# Messages\n\nEvery message of [the wire](wire.md), with the type, default and meaning of each field. "
        "[JSON Schema of all](wire.schema.json).\n\n" + "\n\n".join(sections) + "\n"
    )


def link_message(name: re.Match[str]) -> str:
    """Link a message on the same page."""
    return f"[{name[1]}](#{name[1].lower()})"


def make_api_page() -> str:
    """Describe the public names of the package, by their docstrings."""
    rooms = guidefield._ROOMS
    titles = {**{room: room for room in rooms}, **ROOM_TITLES}
    order = [*ROOM_TITLES, *(room for room in rooms if room not in ROOM_TITLES)]
    sections = [
        f"## {titles[room]}\n\n"
        + "\n\n".join(f"::: guidefield.{room}.{name}" for name in sorted(rooms[room], key=reading_order))
        for room in order
    ]
    return (
        "# Python API\n\nAll of these are names of `guidefield`: `from guidefield import answer, Client`.\n\n"
        + "\n\n".join(sections)
        + "\n"
    )


def reading_order(name: str) -> tuple[bool, bool]:
    """The key by which public names of a section are sorted: functions first, what is for asyncio last."""
    return name[0].isupper(), name.startswith("Async")


def make_gallery_page() -> str:
    """Show every picture of the gallery."""
    pictures = [
        f'![{caption(path.stem)}](pictures/{path.name}){{ width="560" loading=lazy }}'
        f"\n\n*{caption(path.stem)}* (`{path.stem}`)"
        for path in sorted(PICTURES.glob("*.webp"), key=lambda path: (list(CAPTIONS).index(subject(path)), path.stem))
    ]
    return (
        "# Gallery\n\nEach picture is of a real plan. `tools/gallery` plans them all again and takes the pictures "
        "without a display; `tools/gallery --only shelf` takes one.\n\n" + "\n\n".join(pictures) + "\n"
    )


def subject(path: Path) -> str:
    """The key of a picture's caption; an unknown picture raises KeyError."""
    return path.stem if path.stem in CAPTIONS else next(key for key in CAPTIONS if path.stem.startswith(f"{key}_"))


def caption(stem: str) -> str:
    """The caption of a picture."""
    return CAPTIONS[subject(Path(stem))]


def make_settings(pages: Path, target: Path) -> dict[str, object]:
    """Make the settings of MkDocs: those of `mkdocs.yml`, folders, and the pages in a reader's order."""
    return {
        "INHERIT": str(HERE / "mkdocs.yml"),
        "docs_dir": str(pages),
        "site_dir": str(target),
        "nav": [
            {"Start": f"index{PAGE}"},
            *({chapter: [f"{name}{PAGE}" for name in names]} for chapter, names in CHAPTERS.items()),
        ],
        "plugins": {"mkdocstrings": {"handlers": {"python": {"paths": [str(ROOT / "service")]}}}},
    }
