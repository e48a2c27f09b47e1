"""Check mesh files that a client sent, and name them by their content, so that no name of theirs becomes a path.

Some kinds name others: an .obj its materials, these their textures, a .dae and a .ply its textures, a .gltf its
buffers. Whoever opens such a file opens these. So each must have been sent, too, and its name is replaced by the one
that it has here; that of a .ply's texture is left out if it wasn't sent. Some readers go by the content of a file,
others by its suffix: each is checked as the kind of its content (`kinds.py`), and gets that suffix.

Files are untrusted: a further kind in `MESHES` that can name other files needs a function in `_REWRITERS` and an entry
in `_NAMED`. Any further kind also needs its mark in `kinds.py`, and an entry in `READERS` of `reading.py`.
"""

from __future__ import annotations

import functools
import hashlib
import json
import posixpath
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from urllib.parse import unquote

from lxml import etree

from guidefield.errors import RobotInvalid
from guidefield.robot.mesh_files.kinds import recognize

MAX_MESHES = 1_000  # most files with a robot; clients learn this and the next (`endpoint/rules.py`)
MAX_MESH_BYTES = 32 * 2**20

MESHES = (".dae", ".glb", ".gltf", ".obj", ".off", ".ply", ".stl")
"""Kinds of mesh file that are taken from a client; a .3mf is a packed archive and isn't."""
COMPANIONS = (".bin", ".bmp", ".jpeg", ".jpg", ".mtl", ".png", ".tga")
"""Kinds of file that a mesh may name (`_NAMED` says which); their suffix counts alone, none is read as a mesh."""
_IMAGES = (".bmp", ".jpeg", ".jpg", ".png", ".tga")
_NAMED = {".dae": _IMAGES, ".gltf": (".bin", *_IMAGES), ".mtl": _IMAGES, ".obj": (".mtl",), ".ply": _IMAGES}
"""Kinds of file that each kind may name: a reader takes a named file for what belongs there, whatever its suffix."""

_OBJ_NAMES = re.compile(rb"^([ \t]*mtllib[ \t]+)([^\n]+)", re.MULTILINE | re.IGNORECASE)
_MTL_NAMES = re.compile(rb"^([ \t]*(?:map_\w+|bump|disp|decal|norm|refl)[ \t]+)([^\n]+)", re.MULTILINE | re.IGNORECASE)
_PLY_TEXTURE = re.compile(rb"^([ \t]*(?:comment|obj_info)\b[^\n]*?texturefile)([^\n]*)", re.MULTILINE | re.IGNORECASE)
_LINE_ENDS = re.compile(rb"[\r\v\f\x00\x1c-\x1e]")
"""What one reader or another takes for the end of a line, besides a line feed."""
_GLB_MAGIC, _GLB_JSON = b"glTF", b"JSON"


@dataclass(frozen=True)
class NamedByContent:
    """Files that were sent, by new names."""

    files: Mapping[str, bytes]  # content by new name, which is its hash and the kind of file
    names: Mapping[str, str]  # new names by the URIs as sent


def name_by_content(meshes: Mapping[str, bytes]) -> NamedByContent:
    """Check what a client sent beside a URDF, by URI, and name it by its content.

    Raises:
        RobotInvalid: if there are too many or too large files, a file is of an unknown kind, can't be read, or names a
            file that wasn't sent; says which URI.
    """
    if len(meshes) > MAX_MESHES:
        raise RobotInvalid(f"{len(meshes)} meshes were sent, at most {MAX_MESHES} are read", limit=MAX_MESHES)
    naming = _Naming(meshes)
    for uri in meshes:
        naming.name_of(uri)
    return NamedByContent(naming.files, naming.names)


@dataclass
class _Naming:
    meshes: Mapping[str, bytes]
    files: dict[str, bytes] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)

    def name_of(self, uri: str) -> str:
        if uri not in self.names:
            kind, content = self._recognize(uri)
            if kind in _REWRITERS:
                content = _REWRITERS[kind](content, uri, functools.partial(self._referred, uri, kind))
            if kind in MESHES and (read := recognize(content, kind)) != (kind, content):
                raise _fault(uri, f"is ambiguous: it is checked as {kind} and would be read as {read[0]}")
            name = f"{hashlib.sha256(content).hexdigest()}{kind}"
            self.files[name], self.names[uri] = content, name
        return self.names[uri]

    def _recognize(self, uri: str) -> tuple[str, bytes]:
        suffix, content = _suffix(uri), self.meshes[uri]
        if len(content) > MAX_MESH_BYTES:
            raise _fault(uri, f"has {len(content)} bytes, at most {MAX_MESH_BYTES} are read", limit=MAX_MESH_BYTES)
        kind, content = recognize(content, suffix) if suffix in MESHES else (suffix, content)
        if kind not in (*MESHES, *COMPANIONS):
            raise _fault(uri, f"has the content of a {kind} file, which can't be sent; those are {', '.join(MESHES)}")
        return kind, content

    def _referred(self, uri: str, kind: str, reference: str) -> str:
        beside = _beside(uri, reference)
        if beside not in self.meshes:
            raise _fault(uri, f"names {reference[:200]!r}, which was not sent", names=reference[:200])
        if _suffix(beside) not in _NAMED[kind]:
            kinds = ", ".join(_NAMED[kind])
            raise _fault(uri, f"names {reference[:200]!r}; a {kind} may name {kinds}", names=reference[:200])
        return self.name_of(beside)


def _beside(uri: str, reference: str) -> str:
    scheme, separator, path = uri.rpartition("://")
    named = reference.replace("\\", "/")
    return scheme + separator + posixpath.normpath(posixpath.join(posixpath.dirname(path), named))


def _suffix(uri: str) -> str:
    suffix = PurePosixPath(uri).suffix.lower()
    if suffix not in (*MESHES, *COMPANIONS):
        raise _fault(uri, f"is of no kind that can be sent; those are {', '.join((*MESHES, *COMPANIONS))}")
    return suffix


_Referred = Callable[[str], str]


def _rewrite_lines(names: re.Pattern[bytes], word: bytes, content: bytes, uri: str, referred: _Referred) -> bytes:
    def line(match: re.Match[bytes]) -> bytes:
        words = match[2].decode(errors="replace").strip()
        options, _, name = words.rpartition(" ") if words.startswith("-") else ("", "", words)
        return match[1] + " ".join([*options.split(), referred(name)]).encode()

    content = _LINE_ENDS.sub(b"\n", content)
    if b"\\\n" in content:
        raise _fault(uri, "has lines that go on after a backslash")
    names_found = sum(
        match[0].lower().count(word) == 1 for match in names.finditer(content) if word in match[0].lower()
    )
    if content.lower().count(word) != names_found:
        raise _fault(uri, f"has {word.decode()!r} where it doesn't begin a line that names a file")
    return names.sub(line, content)


def _rewrite_gltf(content: bytes, uri: str, referred: _Referred) -> bytes:
    def entries(pairs: list[tuple[str, object]]) -> dict[str, object]:
        if len(found := dict(pairs)) < len(pairs):  # which of them counts depends on the reader
            raise _fault(uri, "has a key twice in an object of its JSON")
        return found

    try:
        document = json.loads(content, object_pairs_hook=entries)
        parts = [document]
        while parts:
            part = parts.pop()
            if isinstance(part, dict) and isinstance(reference := part.get("uri"), str):
                part["uri"] = reference if reference.startswith("data:") else referred(unquote(reference))
            inner = part.values() if isinstance(part, dict) else part
            parts.extend(item for item in inner if isinstance(item, dict | list))
    except (ValueError, TypeError, AttributeError, RecursionError):
        raise _fault(uri, "is no glTF document") from None
    return json.dumps(document).encode()


def _check_glb(content: bytes, uri: str, _referred: _Referred) -> bytes:
    def refuse(reference: str) -> str:
        raise _fault(uri, f"names {reference[:200]!r}; a .glb must hold all that it needs", names=reference[:200])

    length = int.from_bytes(content[12:16], "little")
    if content[:4] != _GLB_MAGIC or content[16:20] != _GLB_JSON or 20 + length > len(content):
        raise _fault(uri, "is no binary glTF")
    _rewrite_gltf(content[20 : 20 + length], uri, refuse)
    return content


def _rewrite_dae(content: bytes, uri: str, referred: _Referred) -> bytes:
    """Replace the names of images in a Collada document; it must not refer to other documents."""
    if b"<!DOCTYPE" in content or b"<!ENTITY" in content:
        raise _fault(uri, "must not have a <!DOCTYPE>, nor entities")
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False)
    try:
        root = etree.fromstring(content, parser)
    except etree.XMLSyntaxError as error:
        raise _fault(uri, f"is not XML: {error.msg}") from None
    for element in root.iter(etree.Element):
        url = element.get("url", "")
        if url and not url.startswith("#"):
            raise _fault(uri, f"names {url[:200]!r}, which is outside the document", names=url[:200])
        if etree.QName(element).localname in ("init_from", "ref") and not len(element):
            _rename_image(element, referred)
    rewritten: bytes = etree.tostring(root, xml_declaration=True, encoding="utf-8")
    return rewritten


def _rename_image(element: etree._Element, referred: _Referred) -> None:
    """Replace the name in an image's <init_from>; a surface's has the id of an image of the same document."""
    text = (element.text or "").strip()
    parent = element.getparent()
    inside_image = parent is not None and etree.QName(parent).localname in ("image", "init_from")
    if text and inside_image:
        element.text = referred(unquote(text.removeprefix("file://")))


def _rewrite_ply(content: bytes, _uri: str, referred: _Referred) -> bytes:
    """Replace the name of a texture in a header, or leave it out: most PLY files come without theirs."""
    head, end, body = content.partition(b"end_header")

    def line(match: re.Match[bytes]) -> bytes:
        try:
            return match[1] + b" " + referred(match[2].decode(errors="replace").strip()).encode()
        except RobotInvalid:
            return b"comment"

    return _PLY_TEXTURE.sub(line, head) + end + body


_REWRITERS: dict[str, Callable[[bytes, str, _Referred], bytes]] = {
    ".obj": functools.partial(_rewrite_lines, _OBJ_NAMES, b"mtllib"),
    ".mtl": functools.partial(_rewrite_lines, _MTL_NAMES, b"map_"),
    ".gltf": _rewrite_gltf,
    ".glb": _check_glb,
    ".dae": _rewrite_dae,
    ".ply": _rewrite_ply,
}


def _fault(uri: str, message: str, **details: object) -> RobotInvalid:
    return RobotInvalid(f"mesh {uri[:200]!r} {message}", uri=uri[:200], **details)
