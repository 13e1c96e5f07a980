"""glTF and GLB files judged before their numbers are read: what they point to, and how much they ask for.

Belongs here: chunks, JSON, where buffers come from, sizes, the tree of nodes, what nodes draw in all. Not: the numbers
themselves (gltf_file). A buffer is in the file, in a `data:` text, or a file beside it: never outside its folder, never
on a network. Of a material only its name counts here; its pictures, where they are asked for, are read by mesh_maps.
Bytes that nothing draws are not read either, however long a buffer is.
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from emulator.config.budgets import MeshBudget, PlainFile, TooMuch, loads_json, raised

GLB_MAGIC, JSON_CHUNK, BINARY_CHUNK = b"glTF", b"JSON", b"BIN\0"
MOST_CHUNKS = 1000
"Of a GLB: two are defined."
COMPONENT_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
LISTS = ("nodes", "meshes", "accessors", "bufferViews", "buffers", "materials", "scenes")
POINTS, LINES, TRIANGLES, STRIP, FAN = 0, 1, 4, 5, 6
"Modes of a primitive (glTF 2.0, 5.24.4) that anybody draws."
PACKED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression")
"Extensions that pack triangles."

Read = Callable[[int, int], bytes]
"So many bytes from there."


@dataclass(frozen=True)
class Judged:
    """A glTF of which every number that a reader follows lies where it says."""

    tree: dict[str, Any]
    buffers: list[tuple[int, Read]]
    "Size of each, and its bytes."
    nodes: list[int]
    "Those that the scene shows, parents before their children."
    parents: dict[int, int]


def judged(path: Path, budget: MeshBudget, files: ExitStack) -> Judged:
    """The JSON of a glTF that may be followed. `ValueError` says what is wrong, `TooMuch` what is too much.

    Files that it reads from stay open as long as `files`.
    """
    file = files.enter_context(PlainFile(path))
    budget.need("bytes", file.size, "bytes")
    binary: tuple[int, Read] | None = None
    if path.suffix.lower() == ".glb":
        text, binary = _chunks(file, budget)
    else:
        budget.need("json_bytes", file.size, "bytes of JSON")
        text = file.read()
    values = sum(text.count(mark) for mark in (b",", b"[", b"{"))
    budget.need("json_values", values, "commas and brackets of JSON")
    tree = loads_json(text.decode("utf-8-sig"))
    del text
    if not isinstance(tree, dict):
        raise ValueError("JSON that is no table; want a glTF")
    for name in LISTS:
        items = tree.setdefault(name, [])
        if not isinstance(items, list) or not all(isinstance(item, dict) for item in items):
            raise ValueError(f"{name}; want a list of tables")
        budget.need("items", len(items), name)
    buffers = _buffers(tree, path, file.size, binary, budget, files)
    _check_accessors(tree, [size for size, _ in buffers])
    nodes, parents = _order(tree)
    _check_drawn(tree, nodes, budget)
    return Judged(tree, buffers, nodes, parents)


def _chunks(file: PlainFile, budget: MeshBudget) -> tuple[bytes, tuple[int, Read] | None]:
    if file.size < 20 or file.read(0, 4) != GLB_MAGIC:
        raise ValueError("no GLB header")
    found: dict[bytes, tuple[int, int]] = {}
    at = 12
    for _ in range(MOST_CHUNKS):
        if at + 8 > file.size:
            break
        head = file.read(at, 8)
        size = int.from_bytes(head[:4], "little")
        if at + 8 + size > file.size:
            raise ValueError(f"a chunk of {size} bytes at byte {at}, of which {file.size - at - 8} are there")
        found.setdefault(head[4:], (at + 8, size))
        at += 8 + size
    if JSON_CHUNK not in found:
        raise ValueError("no chunk of JSON")
    start, size = found[JSON_CHUNK]
    budget.need("json_bytes", size, "bytes of JSON")
    text = file.read(start, size)
    if BINARY_CHUNK not in found:
        return text, None
    begin, length = found[BINARY_CHUNK]
    return text, (length, lambda first, count: file.read(begin + first, count))


# ---------------------------------------------------------------- nodes and what they draw


def _order(tree: dict[str, Any]) -> tuple[list[int], dict[int, int]]:
    """Nodes of the scene, parents first, and the parent of each.

    Every node has at most one parent, as the format wants it: else a short file could draw a mesh without end.
    """
    nodes = tree["nodes"]
    parents: dict[int, int] = {}
    for number, node in enumerate(nodes):
        for child in _indices(node, "children", len(nodes), f"node {number}", "child"):
            if child in parents or child == number:
                raise ValueError(f"node {child} has several parents; want a tree")
            parents[child] = number
    scenes = tree["scenes"]
    if not scenes:
        return [], parents
    chosen = number_of(tree, "scene")
    if chosen >= len(scenes):
        raise ValueError(f"scene {chosen}; want one of {len(scenes)}")
    waiting = list(reversed(_indices(scenes[chosen], "nodes", len(nodes), f"scene {chosen}", "node")))
    found: dict[int, None] = {}
    while waiting:
        number = waiting.pop()
        if number not in found:
            found[number] = None
            waiting.extend(nodes[number].get("children", []))
    for number in found:  # one that the scene names as well is a child all the same
        if number in parents and parents[number] not in found:
            del parents[number]
    return _parents_first(list(found), parents), parents


def _parents_first(found: list[int], parents: dict[int, int]) -> list[int]:
    """`ValueError` for nodes in a circle; each node is looked at once."""
    done: dict[int, None] = {}
    for number in found:
        chain = []
        at: int | None = number
        while at is not None and at not in done:
            chain.append(at)
            if len(chain) > len(found):
                raise ValueError(f"node {number} is its own parent's parent; want a tree")
            at = parents.get(at)
        done.update(dict.fromkeys(reversed(chain)))
    return list(done)


def _indices(table: dict[str, Any], key: str, below: int, where: str, what: str) -> list[int]:
    items = table.get(key, [])
    if not isinstance(items, list):
        raise ValueError(f"{where}: {key}; want a list")
    for item in items:
        if not isinstance(item, int) or isinstance(item, bool) or not 0 <= item < below:
            raise ValueError(f"{where}: {what} {_short(item)}; want one of {below} nodes")
    return items


def drawn(tree: dict[str, Any], mesh: int) -> Iterator[tuple[int, dict[str, Any], int, int, int]]:
    """Primitives of a mesh that have triangles: number, table, mode, accessor of its corners, number of triangles."""
    for number, primitive in enumerate(primitives_of(tree, mesh)):
        mode = number_of(primitive, "mode", TRIANGLES)
        attributes = primitive.get("attributes", {})
        if mode not in (TRIANGLES, STRIP, FAN):
            continue
        place = f"mesh {mesh}, primitive {number}"
        extensions = primitive.get("extensions")
        packed = [name for name in PACKED if isinstance(extensions, dict) and name in extensions]
        if packed:
            raise ValueError(f"{place}: packed by {packed[0]}; want plain triangles")
        if not isinstance(attributes, dict) or "POSITION" not in attributes:
            raise ValueError(f"{place}: no POSITION; want one")
        corners = _accessor(tree, attributes, "POSITION", place)
        if tree["accessors"][corners].get("type") != "VEC3":
            raise ValueError(f"{place}: POSITION is accessor {corners}; want one of VEC3")
        of = corners
        if "indices" in primitive:
            of = _accessor(tree, primitive, "indices", place)
            if tree["accessors"][of].get("type") != "SCALAR" or tree["accessors"][of]["componentType"] == 5126:
                raise ValueError(f"{place}: indices are accessor {of}; want one of whole numbers")
        for one in {corners, of}:
            if "bufferView" not in tree["accessors"][one]:
                raise ValueError(f"{place}: accessor {one} of {tree['accessors'][one]['count']} elements without data")
        count = tree["accessors"][of]["count"]
        if mode == TRIANGLES and count % 3:
            raise ValueError(f"{place}: {count} corners; want three for each triangle")
        triangles = count // 3 if mode == TRIANGLES else max(0, count - 2)
        if triangles:
            yield number, primitive, mode, corners, triangles


def primitives_of(tree: dict[str, Any], mesh: int) -> list[dict[str, Any]]:
    """Tables of a mesh's primitives."""
    found = tree["meshes"][mesh].get("primitives", [])
    if not isinstance(found, list) or not all(isinstance(item, dict) for item in found):
        raise ValueError(f"mesh {mesh}: primitives; want a list of tables")
    return found


def _accessor(tree: dict[str, Any], table: dict[str, Any], key: str, place: str) -> int:
    number = number_of(table, key)
    if number >= len(tree["accessors"]):
        raise ValueError(f"{place}: {key} is accessor {number}; want one of {len(tree['accessors'])}")
    return number


def _check_drawn(tree: dict[str, Any], nodes: list[int], budget: MeshBudget) -> None:
    """What all nodes draw together keeps the budget; so do the bytes that are read for it."""
    cost: dict[int, tuple[int, int, int]] = {}
    triangles = vertices = primitives = draws = 0
    wanted: set[int] = set()
    for number in nodes:
        if "mesh" not in tree["nodes"][number]:
            continue
        mesh = number_of(tree["nodes"][number], "mesh")
        if mesh >= len(tree["meshes"]):
            raise ValueError(f"node {number}: mesh {mesh}; want one of {len(tree['meshes'])}")
        if mesh not in cost:
            primitives += len(primitives_of(tree, mesh))
            budget.need("items", primitives, "primitives")
            found = list(drawn(tree, mesh))
            corners = {one for _, _, _, one, _ in found}
            reached = sum(tree["accessors"][one]["count"] for one in corners)
            cost[mesh] = (len(found), sum(one[4] for one in found), reached)
            wanted |= corners | {one[1]["indices"] for one in found if "indices" in one[1]}
        draws, triangles, vertices = (sum(pair) for pair in zip((draws, triangles, vertices), cost[mesh], strict=True))
        budget.need("draws", draws, "primitives drawn by nodes")
        budget.need("triangles", triangles, "triangles")
        budget.need("vertices", vertices, "vertices")
    elements = sum(tree["accessors"][one]["count"] for one in wanted)
    most = 3 * budget.triangles + budget.vertices
    if elements > most:
        raise TooMuch(f"{elements} elements of accessors; want at most {most} {raised('triangles')}")


# ---------------------------------------------------------------- buffers


def _buffers(
    tree: dict[str, Any],
    path: Path,
    size: int,
    binary: tuple[int, Read] | None,
    budget: MeshBudget,
    files: ExitStack,
) -> list[tuple[int, Read]]:
    found: list[tuple[int, Read]] = []
    known: dict[str, tuple[int, Read]] = {}
    used = {view.get("buffer") for view in tree["bufferViews"] if isinstance(view.get("buffer"), int)}
    for number, buffer in enumerate(tree["buffers"]):
        uri = buffer.get("uri")
        if uri is None:
            packed = buffer.get("extensions")
            if isinstance(packed, dict) and any(name in packed for name in PACKED):
                found.append((0, partial(_part, b"")))  # what is unpacked goes there: a reader of it is refused by name
                continue
            if number or binary is None:
                raise ValueError(f"buffer {number} without data")
            found.append(binary)
            continue
        if not isinstance(uri, str):
            raise ValueError(f"buffer {number}: uri; want a text")
        if uri not in known:
            known[uri] = from_uri(uri, path.parent, number in used, files)
            size += known[uri][0]
            budget.need("bytes", size, "bytes in all its buffers")
        found.append(known[uri])
    return found


def _part(data: bytes, first: int, count: int) -> bytes:
    return data[first : first + count]


def from_uri(uri: str, folder: Path, used: bool, files: ExitStack) -> tuple[int, Read]:
    shown = _short(uri)
    if uri.startswith("data:"):
        head, comma, body = uri.partition(",")
        if not comma or not head.endswith(";base64"):
            raise ValueError(f"buffer {shown}; want base64")
        try:
            data = base64.b64decode(body, validate=False) if used else b""
        except (binascii.Error, ValueError):
            raise ValueError(f"buffer {shown}; want base64") from None
        return len(data), partial(_part, data)
    place = folder.resolve()
    path = (place / unquote(uri)).resolve()
    if urlsplit(uri).scheme or uri.startswith(("/", "\\")) or not path.is_relative_to(place):
        raise ValueError(f"buffer {shown}; want a file in the folder of the mesh")
    try:
        file = files.enter_context(PlainFile(path))
    except FileNotFoundError:
        raise ValueError(f"buffer {shown}: no such file") from None
    except TooMuch as error:
        raise TooMuch(f"buffer {shown}: {error}") from None
    return file.size, file.read


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:56] + "...'"


def number_of(table: dict[str, Any], key: str, default: int = 0) -> int:
    """A whole number from 0, or `ValueError`."""
    value = table.get(key, default)
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise ValueError(f"{key} {_short(value)}; want a whole number from 0")
    return value


def _check_accessors(tree: dict[str, Any], sizes: list[int]) -> None:
    """Nothing is read from where nothing is."""
    views: list[tuple[int, int]] = []
    for number, view in enumerate(tree["bufferViews"]):
        end = number_of(view, "byteOffset") + number_of(view, "byteLength")
        buffer, stride = number_of(view, "buffer"), number_of(view, "byteStride")
        extensions = view.get("extensions")
        packed = [name for name in PACKED if isinstance(extensions, dict) and name in extensions]
        if packed:
            raise ValueError(f"bufferView {number}: packed by {packed[0]}; want plain triangles")
        if buffer >= len(sizes) or end > sizes[buffer]:
            raise ValueError(f"bufferView {number} ends at byte {end}, behind its buffer")
        if stride > 252:  # glTF 2.0, 5.11.4
            raise ValueError(f"bufferView {number}: byteStride {stride}; want at most 252")
        views.append((end - view.get("byteOffset", 0), stride))
    for number, accessor in enumerate(tree["accessors"]):
        count = number_of(accessor, "count")
        width = width_of(accessor)
        if not width:
            raise ValueError(f"accessor {number}: neither componentType nor type that glTF knows")
        place = f"accessor {number}"
        if "bufferView" in accessor:
            _check_room(place, accessor, count, width, views)
        sparse = accessor.get("sparse")
        if sparse is None:
            continue
        if not isinstance(sparse, dict) or not all(isinstance(sparse.get(key), dict) for key in ("indices", "values")):
            raise ValueError(f"{place}: sparse; want a table with indices and values")
        changed = number_of(sparse, "count")
        if changed > count:
            raise ValueError(f"{place}: {changed} sparse elements; want at most {count}")
        kind = sparse["indices"].get("componentType")
        if kind not in (5121, 5123, 5125):
            raise ValueError(f"{place}: sparse indices; want whole numbers")
        _check_room(f"{place}, sparse indices", sparse["indices"], changed, COMPONENT_BYTES[kind], views)
        _check_room(f"{place}, sparse values", sparse["values"], changed, width, views)


def width_of(accessor: dict[str, Any]) -> int:
    """Bytes of one element; 0 for what glTF does not know."""
    kind, shape = accessor.get("componentType"), accessor.get("type")
    known = isinstance(kind, int) and isinstance(shape, str)
    return COMPONENT_BYTES.get(kind, 0) * COMPONENTS.get(shape, 0) if known else 0  # type: ignore[arg-type]


def _check_room(place: str, table: dict[str, Any], count: int, width: int, views: list[tuple[int, int]]) -> None:
    view = number_of(table, "bufferView", len(views))
    room, stride = views[view] if view < len(views) else (-1, 0)
    if count and number_of(table, "byteOffset") + (count - 1) * max(stride, width) + width > room:
        raise ValueError(f"{place}: {count} elements of {width} bytes; its bufferView has {room} bytes")
