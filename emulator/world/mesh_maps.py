"""Colours and normals of a mesh by texel and by vertex: pictures of glTF, vertex colours of glTF, PLY and OBJ.

Belongs here: reading and judging them, and looking a point of a triangle up. Not: triangles (gltf_file, mesh_files),
and what a colour reflects (physics.materials). Nothing of this is read unless a scenario's material asks for maps.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emulator.config.budgets import MeshBudget, TooMuch, raised
from emulator.world.gltf_guard import Judged, from_uri, number_of

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Picture = NDArray[np.uint8]
"(height, width, 3)"
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"Of linear red, green, blue with the primaries of sRGB (ITU-R BT.709)."
CLAMP, MIRRORED, REPEAT = 33071, 33648, 10497
"Wrapping of texture coordinates (glTF 2.0, 5.26)."
PILLOW = "pictures need Pillow: pip install 'lidaremu[report]'"


@dataclass(frozen=True)
class Wanted:
    """Parts of which colours and normals are asked for."""

    every: bool = False
    parts: tuple[str, ...] = ()
    "These too, or where all are wanted: all but these."

    def has(self, part: str) -> bool:
        """That part is one."""
        return (part in self.parts) != self.every


@dataclass(frozen=True)
class Sheet:
    """A picture on a part; `picture` -1: none."""

    picture: int = -1
    wrap: tuple[int, int] = (REPEAT, REPEAT)


@dataclass(frozen=True)
class PartMaps:
    """What one part has."""

    colour: Sheet = Sheet()
    factor: tuple[float, float, float] = (1.0, 1.0, 1.0)
    normal: Sheet = Sheet()
    scale: float = 1.0


@dataclass(frozen=True, eq=False)
class MeshMaps:
    """Colours and normals of all parts of a mesh."""

    uv: Floats
    "(v, 2) on pictures of colour, NaN where there is none."
    normal_uv: Floats
    colour: Floats
    "(v, 3) linear, NaN where there is none."
    pictures: tuple[Picture, ...] = ()
    parts: tuple[PartMaps, ...] = ()

    def luminance(self, part: int, corner: Ints, share: Floats) -> Floats:
        """(k,) of points of triangles with these corners (k, 3) and barycentric shares (k, 3): 0 black to 1 white."""
        maps = self.parts[part]
        rgb = np.tile(np.array(maps.factor), (len(corner), 1))
        own = np.einsum("kc,kcj->kj", share, self.colour[corner])
        rgb *= np.where(np.isnan(own), 1.0, own)
        if maps.colour.picture >= 0:
            texel = _texels(self.pictures[maps.colour.picture], maps.colour.wrap, self.uv, corner, share)
            rgb *= linear(texel / 255.0)
        return np.asarray(np.clip(rgb @ LUMINANCE, 0.0, 1.0))

    def normals(self, part: int, corner: Ints, share: Floats, place: Floats, flat: Floats) -> Floats:
        """(k, 3) unit normals by the texture, on the side of the faces' normals `flat`; `place` (k, 3, 3) corners."""
        maps = self.parts[part]
        texel = _texels(self.pictures[maps.normal.picture], maps.normal.wrap, self.normal_uv, corner, share)
        x, y, z = (texel / 127.5 - 1.0).T
        uv = self.normal_uv[corner]
        (u1, v1), (u2, v2) = (uv[:, 1] - uv[:, 0]).T, (uv[:, 2] - uv[:, 0]).T
        first, second = place[:, 1] - place[:, 0], place[:, 2] - place[:, 0]
        det = u1 * v2 - u2 * v1
        sign = np.where(det < 0.0, -1.0, 1.0)[:, None]
        right = _unit(sign * (first * v2[:, None] - second * v1[:, None]))
        up = _unit(-sign * (second * u1[:, None] - first * u2[:, None]))  # v grows downwards (glTF 2.0, 3.8.1)
        made = maps.scale * (x[:, None] * right + y[:, None] * up) + z[:, None] * flat
        length = np.linalg.norm(made, axis=1)
        sound = (det != 0.0) & (length > 1e-6)
        return np.asarray(np.where(sound[:, None], made / np.where(length > 0.0, length, 1.0)[:, None], flat))


def linear(value: Floats) -> Floats:
    """Light of a value in sRGB, both 0 to 1 (IEC 61966-2-1)."""
    return np.asarray(np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4))


def _unit(vector: Floats) -> Floats:
    return np.asarray(vector / np.maximum(np.linalg.norm(vector, axis=1), 1e-300)[:, None])


def _texels(picture: Picture, wrap: tuple[int, int], uv: Floats, corner: Ints, share: Floats) -> Floats:
    """(k, 3) of 0 to 255: that texel in which each point lies."""
    at = np.einsum("kc,kcj->kj", share, uv[corner])
    height, width = picture.shape[:2]
    column, row = (_wrapped(at[:, k], wrap[k], size) for k, size in ((0, width), (1, height)))
    return np.asarray(picture[row, column], np.float64)


def _wrapped(at: Floats, how: int, size: int) -> Ints:
    if how == MIRRORED:
        turn = np.mod(at, 2.0)
        at = np.where(turn > 1.0, 2.0 - turn, turn)
    elif how == REPEAT:
        at = at - np.floor(at)
    return np.clip(np.floor(np.clip(at, 0.0, 1.0) * size), 0, size - 1).astype(np.int64)


def of_colours(colour: Floats, parts: int) -> MeshMaps:
    """A mesh of which only vertex colours are known, (v, 3) in sRGB from 0 to 1."""
    none = np.full((len(colour), 2), np.nan)
    return MeshMaps(none, none, linear(np.clip(colour, 0.0, 1.0)), (), (PartMaps(),) * parts)


# ---------------------------------------------------------------- glTF


class Textures:
    """Pictures and materials of a judged glTF."""

    def __init__(self, found: Judged, path: Path, budget: MeshBudget, files: ExitStack) -> None:
        self._found, self._tree, self._folder, self._files = found, found.tree, path.parent, files
        self._budget, self._left = budget, budget.pixels
        self._known: dict[int, int] = {}
        self.pictures: list[Picture] = []

    def of(self, number: int | None) -> tuple[PartMaps, int, int]:
        """What the material of that number has, and of which TEXCOORD its pictures are: of colour, of normals."""
        if number is None:
            return PartMaps(), 0, 0
        table = self._tree["materials"][number]
        where = f"material {table.get('name', number)!r}"[:80]
        pbr = table.get("pbrMetallicRoughness", {})
        if not isinstance(pbr, dict):
            raise ValueError(f"{where}: pbrMetallicRoughness; want a table")
        factor = pbr.get("baseColorFactor", [1.0, 1.0, 1.0, 1.0])
        if not isinstance(factor, list) or len(factor) != 4 or not all(
            type(one) in (int, float) and 0.0 <= one <= 1.0 for one in factor
        ):  # fmt: skip
            raise ValueError(f"{where}: baseColorFactor; want four numbers from 0 to 1")
        colour, which = self._sheet(pbr, "baseColorTexture", where)
        normal, other = self._sheet(table, "normalTexture", where)
        scale = table.get("normalTexture", {}).get("scale", 1.0) if normal.picture >= 0 else 1.0
        if type(scale) not in (int, float):
            raise ValueError(f"{where}: normalTexture.scale; want a number")
        return PartMaps(colour, tuple(map(float, factor[:3])), normal, float(scale)), which, other  # type: ignore[arg-type]

    def _sheet(self, table: dict[str, Any], key: str, where: str) -> tuple[Sheet, int]:
        if key not in table:
            return Sheet(), 0
        info = table[key]
        if not isinstance(info, dict):
            raise ValueError(f"{where}: {key}; want a table")
        if "KHR_texture_transform" in info.get("extensions", {}):
            raise ValueError(f"{where}: {key} with KHR_texture_transform; want texture coordinates as they are")
        texture = self._item("textures", info, "index", f"{where}: {key}")
        if "source" not in texture:
            raise ValueError(f"{where}: {key}: a texture without source; want a PNG or JPEG")
        wrap = (REPEAT, REPEAT)
        if "sampler" in texture:
            sampler = self._item("samplers", texture, "sampler", f"{where}: {key}")
            wrap = sampler.get("wrapS", REPEAT), sampler.get("wrapT", REPEAT)
            if not {*wrap} <= {CLAMP, MIRRORED, REPEAT}:
                raise ValueError(f"{where}: {key}: wrap {wrap}; want {CLAMP}, {MIRRORED} or {REPEAT}")
        image = self._item("images", texture, "source", f"{where}: {key}")
        number = number_of(texture, "source")
        if number not in self._known:
            self._known[number] = len(self.pictures)
            self.pictures.append(self._picture(image, f"{where}: {key}", normals=key == "normalTexture"))
        return Sheet(self._known[number], wrap), number_of(info, "texCoord")

    def _item(self, name: str, table: dict[str, Any], key: str, where: str) -> dict[str, Any]:
        items, number = self._tree.get(name, []), number_of(table, key, -1) if key in table else -1
        if not isinstance(items, list) or not 0 <= number < len(items) or not isinstance(items[number], dict):
            count = len(items) if isinstance(items, list) else 0
            raise ValueError(f"{where}: {name} {number}; want one of {count}")
        item: dict[str, Any] = items[number]
        return item

    def _picture(self, image: dict[str, Any], where: str, normals: bool) -> Picture:
        if "bufferView" in image:
            views = self._tree["bufferViews"]
            number = number_of(image, "bufferView")
            if number >= len(views):
                raise ValueError(f"{where}: bufferView {number}; want one of {len(views)}")
            view = views[number]
            data = self._found.buffers[view["buffer"]][1](view.get("byteOffset", 0), number_of(view, "byteLength"))
        elif isinstance(image.get("uri"), str):
            try:
                size, read = from_uri(image["uri"], self._folder, True, self._files)
            except TooMuch:
                raise
            except ValueError as error:
                raise ValueError(f"{where}: {str(error).replace('buffer', 'picture', 1)}") from None
            self._budget.need("bytes", size, "bytes of a picture")
            data = read(0, size)
        else:
            raise ValueError(f"{where}: a picture without data; want a uri or a bufferView")
        picture = _decoded(data, where, normals, self._left, self._budget)
        self._left -= picture.shape[0] * picture.shape[1]
        return picture


def _decoded(data: bytes, where: str, normals: bool, left: int, budget: MeshBudget) -> Picture:
    try:
        from PIL import Image
    except ImportError:
        raise ValueError(f"{where}: {PILLOW}") from None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of many pixels: judged here
        Image.MAX_IMAGE_PIXELS = None
        try:
            image = Image.open(io.BytesIO(data), formats=("PNG", "JPEG", "WEBP"))
        except OSError:
            raise ValueError(f"{where}: not a picture that can be read; want a PNG or JPEG") from None
        if image.width * image.height > left:
            most = f"{budget.pixels} in all its pictures {raised('pixels')}"
            raise TooMuch(f"{where}: {image.width} x {image.height} pixels; want at most {most}")
        allowed = ("RGB", "RGBA") if normals else ("RGB", "RGBA", "L", "LA", "P")
        if image.mode not in allowed:
            what = "a normal map" if normals else "a colour texture"
            raise ValueError(f"{where}: {what} of colours {image.mode}; want {', '.join(allowed)}, 8 bit each")
        try:
            return np.asarray(image.convert("RGB"), np.uint8)
        except (OSError, SyntaxError) as error:
            raise ValueError(f"{where}: a broken picture ({str(error)[:80]}); want a sound one") from None


def check(maps: MeshMaps | None, part: int, name: str, faces: Ints, colours: bool, normals: bool) -> str:
    """Why a part of these faces (k, 3) has not what is wanted of it; empty: it has."""
    if maps is None:
        return f"{name} has neither pictures nor vertex colours; want a glTF, PLY or OBJ that has"
    own, corner = maps.parts[part], np.unique(faces)
    if colours and own.colour.picture < 0 and np.isnan(maps.colour[corner]).any():
        return f"{name} has neither a baseColorTexture nor vertex colours; want one of them for maps.reflectance"
    if colours and own.colour.picture >= 0 and np.isnan(maps.uv[corner]).any():
        return f"{name} has a baseColorTexture and no texture coordinates; want TEXCOORD_n for it"
    if normals and own.normal.picture < 0:
        return f"{name} has no normalTexture; want one for maps.normals"
    if normals and np.isnan(maps.normal_uv[corner]).any():
        return f"{name} has a normalTexture and no texture coordinates; want TEXCOORD_n for it"
    return ""


def parts_told(parts: Sequence[PartMaps]) -> list[list[Any]]:
    """As JSON."""
    return [
        [one.colour.picture, *one.colour.wrap, *one.factor, one.normal.picture, *one.normal.wrap, one.scale]
        for one in parts
    ]


def parts_read(reported: list[list[Any]], pictures: int) -> tuple[PartMaps, ...]:
    """From JSON; `ValueError` for what cannot be."""
    found = []
    for c, cs, ct, r, g, b, n, ns, nt, scale in reported:
        if not (-1 <= int(c) < pictures and -1 <= int(n) < pictures):
            raise ValueError("pictures")
        factor = float(r), float(g), float(b)
        found.append(
            PartMaps(Sheet(int(c), (int(cs), int(ct))), factor, Sheet(int(n), (int(ns), int(nt))), float(scale))
        )
    return tuple(found)
