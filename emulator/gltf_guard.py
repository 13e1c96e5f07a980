"""glTF and GLB files judged before a library reads them: what they point to, and how much they ask for.

Belongs here: chunks, JSON, where buffers come from, sizes, the tree of nodes. Not: the triangles (mesh_files).
A buffer is in the file, in a `data:` text, or a file beside it: never outside its folder, never on a network. Pictures
are not read at all: of a material only its name counts.
"""

from __future__ import annotations

import base64
import binascii
import json
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

GLB_MAGIC, JSON_CHUNK, BINARY_CHUNK = b"glTF", b"JSON", b"BIN\0"
MOST_JSON_BYTES = 64_000_000
MOST_ITEMS = 100_000
"Nodes, meshes, accessors or buffers of one file."
MOST_EMPTY_COUNT = 10_000_000
"Elements of an accessor that has no data: the format lets it be all zeros."
COMPONENT_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
LISTS = ("nodes", "meshes", "accessors", "bufferViews", "buffers", "materials", "scenes")


def read_gltf(path: Path, most_bytes: int) -> tuple[bytes, dict[str, bytes]]:
    """JSON that is safe to be read, and its buffers by the names it now gives them. `ValueError` says what is wrong."""
    text, binary = _chunks(path.read_bytes()) if path.suffix.lower() == ".glb" else (path.read_bytes(), None)
    if len(text) > MOST_JSON_BYTES:
        raise ValueError(f"{len(text)} bytes of JSON; want at most {MOST_JSON_BYTES}")
    tree = json.loads(text.decode("utf-8-sig"))
    if not isinstance(tree, dict):
        raise ValueError("JSON that is no table; want a glTF")
    for name in LISTS:
        items = tree.get(name, [])
        if not isinstance(items, list) or not all(isinstance(item, dict) for item in items):
            raise ValueError(f"{name}; want a list of tables")
        if len(items) > MOST_ITEMS:
            raise ValueError(f"{len(items)} {name}; want at most {MOST_ITEMS}")
    _strip(tree)
    _check_nodes(tree.get("nodes", []))
    buffers = _buffers(tree, path.parent, binary, most_bytes)
    _check_accessors(tree, {number: len(data) for number, data in enumerate(buffers.values())})
    return json.dumps(tree).encode(), buffers


def _chunks(data: bytes) -> tuple[bytes, bytes | None]:
    if data[:4] != GLB_MAGIC or len(data) < 20:
        raise ValueError("no GLB header")
    found: dict[bytes, bytes] = {}
    at = 12
    while at + 8 <= len(data):
        size = int.from_bytes(data[at : at + 4], "little")
        if at + 8 + size > len(data):
            raise ValueError(f"a chunk of {size} bytes at byte {at}, of which {len(data) - at - 8} are there")
        found.setdefault(data[at + 4 : at + 8], data[at + 8 : at + 8 + size])
        at += 8 + size
    if JSON_CHUNK not in found:
        raise ValueError("no chunk of JSON")
    return found[JSON_CHUNK], found.get(BINARY_CHUNK)


def _strip(tree: dict[str, Any]) -> None:
    """Leave out what is not needed and could ask for more files: pictures, and all of a material but its name."""
    for key in ("images", "textures", "samplers", "animations", "skins", "cameras"):
        tree.pop(key, None)
    if "materials" in tree:
        tree["materials"] = [{"name": str(item["name"])} if "name" in item else {} for item in tree["materials"]]


def _check_nodes(nodes: list[dict[str, Any]]) -> None:
    """Every node has at most one parent, as the format wants it: else a short file could draw a mesh without end."""
    parents = [0] * len(nodes)
    for number, node in enumerate(nodes):
        children = node.get("children", [])
        if not isinstance(children, list):
            raise ValueError(f"node {number}: children; want a list")
        for child in children:
            if not isinstance(child, int) or not 0 <= child < len(nodes):
                raise ValueError(f"node {number}: child {child!r}; want one of {len(nodes)} nodes")
            parents[child] += 1
            if parents[child] > 1 or child == number:
                raise ValueError(f"node {child} has several parents; want a tree")


def _buffers(tree: dict[str, Any], folder: Path, binary: bytes | None, most_bytes: int) -> dict[str, bytes]:
    found: dict[str, bytes] = {}
    for number, buffer in enumerate(tree.get("buffers", [])):
        uri = buffer.get("uri")
        if uri is None:
            if number or binary is None:
                raise ValueError(f"buffer {number} without data")
            data = binary
        elif not isinstance(uri, str):
            raise ValueError(f"buffer {number}: uri; want a text")
        else:
            data = _from_uri(uri, folder, most_bytes)
        name = f"buffer{number}"
        found[name], buffer["uri"] = data, name
        if sum(map(len, found.values())) > most_bytes:
            raise ValueError(f"buffers of more than {most_bytes} bytes")
    return found


def _from_uri(uri: str, folder: Path, most_bytes: int) -> bytes:
    shown = uri if len(uri) <= 60 else uri[:57] + "..."
    if uri.startswith("data:"):
        head, comma, body = uri.partition(",")
        if not comma or not head.endswith(";base64"):
            raise ValueError(f"buffer {shown!r}; want base64")
        try:
            return base64.b64decode(body, validate=False)
        except (binascii.Error, ValueError):
            raise ValueError(f"buffer {shown!r}; want base64") from None
    place = folder.resolve()
    path = (place / unquote(uri)).resolve()
    if urlsplit(uri).scheme or uri.startswith(("/", "\\")) or not path.is_relative_to(place):
        raise ValueError(f"buffer {shown!r}; want a file in the folder of the mesh")
    if not path.is_file():
        raise ValueError(f"buffer {shown!r}: no such file")
    if path.stat().st_size > most_bytes:
        raise ValueError(f"buffer {shown!r}: {path.stat().st_size} bytes; want at most {most_bytes}")
    return path.read_bytes()


def _number(table: dict[str, Any], key: str, default: int = 0) -> int:
    value = table.get(key, default)
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise ValueError(f"{key} {value!r}; want a whole number from 0")
    return value


def _check_accessors(tree: dict[str, Any], sizes: dict[int, int]) -> None:
    """Nothing is read from where nothing is."""
    views = []
    for number, view in enumerate(tree.get("bufferViews", [])):
        end = _number(view, "byteOffset") + _number(view, "byteLength")
        if end > sizes.get(_number(view, "buffer"), -1):
            raise ValueError(f"bufferView {number} ends at byte {end}, behind its buffer")
        views.append(_number(view, "byteLength"))
    for number, accessor in enumerate(tree.get("accessors", [])):
        count = _number(accessor, "count")
        width = COMPONENT_BYTES.get(accessor.get("componentType"), 0) * COMPONENTS.get(accessor.get("type"), 0)
        if not width:
            raise ValueError(f"accessor {number}: neither componentType nor type that glTF knows")
        if "bufferView" not in accessor:
            if count > MOST_EMPTY_COUNT:
                raise ValueError(f"accessor {number}: {count} elements without data; want at most {MOST_EMPTY_COUNT}")
            continue
        view_number = _number(accessor, "bufferView")
        room = views[view_number] if view_number < len(views) else -1
        if _number(accessor, "byteOffset") + count * width > room and count:
            raise ValueError(f"accessor {number}: {count} elements of {width} bytes; its bufferView has {room} bytes")
