"""Materials by name: reflectance per wavelength, reflection model, parameters, source; and what they send back.

Here: the table that ships with the package, the check of materials a user adds, and `SurfaceTable`, which evaluates
whole arrays of hits at once. Not here: the reflection models themselves (brdf).
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from importlib import resources
from types import MappingProxyType
from typing import Any, Literal, get_args

import numpy as np

from emulator.physics import brdf, sheeting
from emulator.physics.arrays import Bools, Floats, Ints, floats, indexes
from emulator.physics.constants import WATER_INDEX_905
from emulator.physics.foliage import LAWS, RATIOS, Foliage

Model = Literal["lambert", "oren_nayar", "phong", "ggx", "coated", "mirror", "glass", "retro"]
MODELS: tuple[str, ...] = get_args(Model)
WAVELENGTH_TOLERANCE_NM = 45.0
"A reflectance holds this far from the wavelength it is given for (850 to 950 nm for 905); farther is refused."


@dataclass(frozen=True)
class Maps:
    """What a mesh's own colours and normals mean on this material."""

    reflectance: tuple[float, float] | None = None
    "Of black and of white; linear in luminance between them."
    normals: bool = False

    @property
    def levels(self) -> Floats:
        """(`LEVELS`,) reflectances of the steps between black and white; none where colours mean nothing."""
        return np.zeros(0) if self.reflectance is None else np.linspace(*self.reflectance, LEVELS)


LEVELS = 256
"Steps of luminance."


class MaterialError(ValueError):
    """A material that cannot be: carries the key, what was found and what is allowed."""

    def __init__(self, key: str, found: object, allowed: str) -> None:
        super().__init__(f"{key}: {found}; want {allowed}")
        self.key, self.found, self.allowed = key, found, allowed


@dataclass(frozen=True)
class Material:
    """One surface. Parameters that its model does not use keep their defaults."""

    name: str
    rho: tuple[tuple[float, float], ...]
    "(wavelength in nm, diffuse reflectance) in rising order; one pair of wavelength 0 holds for every wavelength."
    model: Model = "lambert"
    range_905: tuple[float, float] | None = None
    "Spread of rho over specimens of that name."
    slope_rad: float = 0.0
    "Oren-Nayar: standard deviation of the slopes."
    f0: float = brdf.COAT_OUTSIDE
    "GGX lobe: mirror reflectance at normal incidence."
    roughness: float = 0.1
    "GGX lobe: alpha."
    lobe_share: float = 1.0
    "GGX: share of the surface that has the lobe."
    rho_specular: float = 0.0
    "Phong: energy in the lobe."
    exponent: float = 20.0
    "Phong."
    specular: float | None = None
    "Mirror: share sent on in the mirror direction; None: Fresnel's for `index`."
    index: float = 1.5
    "Refractive index of glass, or of the liquid of a mirror."
    internal: float = 1.0
    "Glass: what one pass inside the pane leaves."
    retro_cd_lx_m2: float = 0.0
    "Coefficient R_A of retroreflective sheeting."
    retro_class: str = ""
    "Class of `sheeting.yaml` by which it falls with the angles of entrance and observation; empty: it does not."
    wet: bool = False
    "Covered with a film of water: darker diffuse part."
    foliage: Foliage | None = None
    "A closed body of it is full of leaves, and no surface; `rho` is that of a leaf."
    maps: Maps | None = None
    evidence: str = "user"
    source: str = ""

    def reflectance(self, wavelength_nm: float) -> float:
        """Diffuse reflectance at this wavelength, wetness included; refuses a wavelength that it has no value for.

        The value given for the nearest wavelength is taken, if that is within `WAVELENGTH_TOLERANCE_NM`; nothing is
        interpolated, because spectra have bands between 905 and 1550 nm.
        """
        nearest, rho = min(self.rho, key=lambda pair: abs(pair[0] - wavelength_nm))
        if nearest != 0.0 and abs(nearest - wavelength_nm) > WAVELENGTH_TOLERANCE_NM:
            known = ", ".join(f"{nm:g}" for nm, _ in self.rho)
            raise MaterialError(
                f"materials.{self.name}.rho",
                f"no value for {wavelength_nm:g} nm",
                f"one within {WAVELENGTH_TOLERANCE_NM:g} nm of it; given for {known} nm",
            )
        return float(brdf.wet_reflectance(rho, WATER_INDEX_905)) if self.wet else rho


# ------------------------------------------------------------------------------- table and users' materials
def known_materials() -> tuple[str, ...]:
    """Names of the materials that ship with the package, in the order of their table."""
    return tuple(_texts())


def builtin_materials() -> Mapping[str, Material]:
    """The materials that ship with the package, by name; read-only."""
    return MappingProxyType({name: _builtin(name) for name in _texts()})


def material(name: str, extra: Mapping[str, Material] = MappingProxyType({})) -> Material:
    """A material by name, the user's own first; an unknown name is refused with the nearest known one."""
    found = extra.get(name) or (_builtin(name) if name in _texts() else None)
    if found is None:
        names = [*extra, *known_materials()]
        near = difflib.get_close_matches(name, names, 1)
        raise MaterialError(
            "material", name, f"a known one (did you mean {near[0]}?)" if near else f"one of {', '.join(names)}"
        )
    return found


def material_from_mapping(name: str, entry: Mapping[str, Any]) -> Material:
    """A user's material from the mapping in a scenario.

    Keys: those of `materials.yaml`; `rho` is one number for every wavelength or a mapping of nm to numbers.
    ``like: NAME`` starts from a known material and changes only the keys given. ``k_over_s`` (number or mapping)
    instead of rho: Kubelka-Munk layer; under model `coated` its clear coat is added by Saunderson's formula.
    """
    where = f"materials.{name}"
    if not isinstance(entry, Mapping):
        raise MaterialError(where, repr(entry), "a mapping with rho and model")
    base: Material | None = None
    if "like" in entry:
        try:
            base = material(str(entry["like"]))
        except MaterialError as error:
            raise MaterialError(f"{where}.like", error.found, error.allowed) from None
    for key in entry:
        if key not in _KEYS:
            near = difflib.get_close_matches(str(key), _KEYS, 1)
            raise MaterialError(f"{where}.{key}", "unknown key", near[0] if near else f"one of {', '.join(_KEYS)}")
    made = base or Material(name, ())
    if "foliage" in entry:
        return _leafy(name, entry, base)
    if made.foliage is not None:
        for key in ("rho", "k_over_s", "model"):
            if key in entry:
                raise MaterialError(f"{where}.{key}", f"given for leaves, like {made.name}", "foliage.leaf_reflectance")
    model = entry.get("model", made.model)
    if model not in MODELS:
        raise MaterialError(f"{where}.model", repr(model), f"one of {', '.join(MODELS)}")
    fields: dict[str, Any] = {"name": name, "model": model}
    for key in ("source", "evidence"):
        if key in entry:
            fields[key] = str(entry[key])
        elif base is None or key == "evidence":
            fields[key] = "user" if key == "evidence" else ""
    for key, (low, high, text) in _NUMBERS.items():
        if key in entry:
            fields[key] = _number(f"{where}.{key}", entry[key], low, high, text)
    if "specular" in entry:
        value = entry["specular"]
        fields["specular"] = None if value == "fresnel" else _number(f"{where}.specular", value, 0, 1, _SHARE)
    elif base is None and model == "mirror" and "index" not in entry:
        raise MaterialError(f"{where}.specular", "missing", "a share from 0 to 1, or fresnel with an index")
    if "retro_class" in entry:
        known = sheeting.classes()
        if entry["retro_class"] not in known:
            raise MaterialError(f"{where}.retro_class", repr(entry["retro_class"]), f"one of {', '.join(known)}")
        fields["retro_class"] = str(entry["retro_class"])
        if "retro_cd_lx_m2" not in entry:
            fields["retro_cd_lx_m2"] = known[fields["retro_class"]].reference_cd_lx_m2
        if model != "retro":
            raise MaterialError(f"{where}.retro_class", repr(entry["retro_class"]), "none, or model retro")
    if "wet" in entry:
        if not isinstance(entry["wet"], bool):
            raise MaterialError(f"{where}.wet", repr(entry["wet"]), "true or false")
        fields["wet"] = entry["wet"]
    if "range" in entry:
        pair = entry["range"]
        if not isinstance(pair, Sequence) or isinstance(pair, str) or len(pair) != 2:
            raise MaterialError(f"{where}.range", repr(pair), "two numbers, least and largest")
        low, high = (_number(f"{where}.range", value, 0.0, 1.0, _SHARE) for value in pair)
        fields["range_905"] = (min(low, high), max(low, high))
    elif base is not None:
        fields["range_905"] = None if "rho" in entry or "k_over_s" in entry else base.range_905
    if "rho" in entry and "k_over_s" in entry:
        raise MaterialError(f"{where}.k_over_s", "given beside rho", "one of the two")
    if "rho" in entry:
        fields["rho"] = _spectrum(f"{where}.rho", entry["rho"], 0.0, 1.0, _SHARE)
    elif "k_over_s" in entry:
        pairs = _spectrum(f"{where}.k_over_s", entry["k_over_s"], 0.0, math.inf, "a number >= 0")
        layer = tuple((nm, float(brdf.kubelka_munk(x))) for nm, x in pairs)
        if model == "coated":
            layer = tuple((nm, float(brdf.saunderson_diffuse(rho))) for nm, rho in layer)
        fields["rho"] = layer
    elif base is None:
        raise MaterialError(f"{where}.rho", "missing", "a number from 0 to 1, or a mapping of wavelength in nm to one")
    if "maps" in entry:
        fields["maps"] = _maps(f"{where}.maps", entry["maps"], model)
    result = replace(made, **fields)
    if result.model == "retro" and result.retro_cd_lx_m2 <= 0.0:
        raise MaterialError(f"{where}.retro_cd_lx_m2", "missing", "a number > 0, in cd/lx/m2")
    return result


_SHARE = "a number from 0 to 1"
_BESIDE_FOLIAGE = ("like", "foliage", "wet", "source", "evidence")
_FOLIAGE = ("leaf_area_density_m2_m3", "leaf_angle", "leaf_reflectance", "leaf_size_m")


def _leafy(name: str, entry: Mapping[str, Any], base: Material | None) -> Material:
    """A material that is leaves; what is not given is that of `like`."""
    where, given = f"materials.{name}.foliage", entry["foliage"]
    for key in entry:
        if key not in _BESIDE_FOLIAGE:
            allowed = f"foliage with {', '.join(_BESIDE_FOLIAGE[2:])} alone; leaves reflect as foliage.leaf_reflectance"
            raise MaterialError(f"materials.{name}.{key}", "given beside foliage", f"{allowed} says")
    if not isinstance(given, Mapping):
        raise MaterialError(where, repr(given), f"a mapping with {', '.join(_FOLIAGE)}")
    for key in given:
        if key not in _FOLIAGE:
            near = difflib.get_close_matches(str(key), _FOLIAGE, 1)
            raise MaterialError(f"{where}.{key}", "unknown key", near[0] if near else f"one of {', '.join(_FOLIAGE)}")
    fields: dict[str, Any] = {}
    limits = {"leaf_area_density_m2_m3": (0.0, 1000.0, ""), "leaf_size_m": (0.001, 2.0, " m")}
    for key, (low, high, unit) in limits.items():
        if key in given:
            text = f"a number from {low:g} to {high:g}{unit}"
            fields[key] = _number(f"{where}.{key}", given[key], low, high, text)
    if "leaf_angle" in given:
        fields["leaf_angle"] = _law(f"{where}.leaf_angle", given["leaf_angle"])
    known = None if base is None else base.foliage
    if known is None and "leaf_area_density_m2_m3" not in given:
        raise MaterialError(f"{where}.leaf_area_density_m2_m3", "missing", "a number from 0 to 1000")
    leaves = Foliage(**fields) if known is None else replace(known, **fields)
    rho = () if base is None else base.rho
    if "leaf_reflectance" in given:
        rho = _spectrum(f"{where}.leaf_reflectance", given["leaf_reflectance"], 0.0, 1.0, _SHARE)
    elif base is None:
        raise MaterialError(
            f"{where}.leaf_reflectance", "missing", "a number from 0 to 1, or a mapping of wavelength in nm to one"
        )
    if "wet" in entry and not isinstance(entry["wet"], bool):
        raise MaterialError(f"materials.{name}.wet", repr(entry["wet"]), "true or false")
    wet = entry.get("wet", False if base is None else base.wet)
    source, evidence = str(entry.get("source", "")), str(entry.get("evidence", "user"))
    return Material(name, rho, wet=wet, foliage=leaves, source=source, evidence=evidence)


_UNMAPPED = ("glass", "mirror", "retro")


def _maps(where: str, given: object, model: str) -> Maps:
    allowed = "a mapping with reflectance: [of black, of white] and normals: true, one of them or both"
    if not isinstance(given, Mapping) or not given or set(given) - {"reflectance", "normals"}:
        raise MaterialError(where, repr(given), allowed)
    if model in _UNMAPPED:
        raise MaterialError(where, f"given for model {model}", "another model")
    pair, normals = given.get("reflectance"), given.get("normals", False)
    if not isinstance(normals, bool):
        raise MaterialError(f"{where}.normals", repr(normals), "true or false")
    if pair is None:
        if not normals:
            raise MaterialError(where, repr(given), allowed)
        return Maps(None, True)
    if not isinstance(pair, Sequence) or isinstance(pair, str) or len(pair) != 2:
        raise MaterialError(f"{where}.reflectance", repr(pair), "two numbers from 0 to 1, of black and of white")
    black, white = (_number(f"{where}.reflectance", one, 0.0, 1.0, _SHARE) for one in pair)
    return Maps((black, white), normals)


def _law(where: str, value: object) -> str | float:
    """A distribution of leaf inclinations."""
    ratio = f"ellipsoidal: a number from {RATIOS[0]:g} to {RATIOS[1]:g}"
    if isinstance(value, Mapping):
        if list(value) != ["ellipsoidal"]:
            raise MaterialError(where, repr(dict(value)), f"{ratio}, or one of {', '.join(LAWS)}")
        return _number(f"{where}.ellipsoidal", value["ellipsoidal"], *RATIOS, f"a number from {RATIOS[0]:g} to 100")
    if not isinstance(value, str) or value not in LAWS:
        near = difflib.get_close_matches(str(value), LAWS, 1)
        raise MaterialError(where, repr(value), f"{near[0]}" if near else f"one of {', '.join(LAWS)}, or {ratio}")
    return value


_NUMBERS: Mapping[str, tuple[float, float, str]] = MappingProxyType(
    {
        "slope_rad": (0.0, math.pi / 2.0, "a number from 0 to 1.57"),
        "f0": (0.0, 1.0, _SHARE),
        "roughness": (
            brdf.MIN_ROUGHNESS,
            1.0,
            f"a number from {brdf.MIN_ROUGHNESS} to 1; a smoother surface is model mirror",
        ),
        "lobe_share": (0.0, 1.0, _SHARE),
        "rho_specular": (0.0, 1.0, _SHARE),
        "exponent": (0.0, 1e6, "a number from 0 to 1e6"),
        "index": (1.0, 4.0, "a number from 1 to 4"),
        "internal": (0.0, 1.0, _SHARE),
        "retro_cd_lx_m2": (0.0, 2000.0, "a number from 0 to 2000, in cd/lx/m2"),
    }
)
_KEYS = (
    "rho",
    "k_over_s",
    "model",
    "like",
    "range",
    "specular",
    "wet",
    "foliage",
    "maps",
    "retro_class",
    "source",
    "evidence",
    *_NUMBERS,
)


def _number(where: str, value: object, low: float, high: float, allowed: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high or value == math.inf:
        raise MaterialError(where, repr(value), allowed)
    return float(value)


def _spectrum(where: str, value: object, low: float, high: float, allowed: str) -> tuple[tuple[float, float], ...]:
    if not isinstance(value, Mapping):
        return ((0.0, _number(where, value, low, high, allowed)),)
    if not value:
        raise MaterialError(where, "an empty mapping", f"wavelength in nm: {allowed}")
    pairs = []
    for key, rho in value.items():
        try:
            nm = float(key)
        except (TypeError, ValueError):
            nm = math.nan
        if not 300.0 <= nm <= 3000.0:
            raise MaterialError(f"{where}.{key}", repr(key), "a wavelength from 300 to 3000 nm")
        pairs.append((nm, _number(f"{where}.{key}", rho, low, high, allowed)))
    return tuple(sorted(pairs))


@cache
def _texts() -> Mapping[str, str]:
    """Each entry of the table as it is written: all of them take longer to parse than the rest of a scenario."""
    text = resources.files("emulator.physics").joinpath("materials.yaml").read_text(encoding="utf-8")
    entries = re.split(r"^(?=[a-z])", text, flags=re.MULTILINE)[1:]
    return MappingProxyType({entry.partition(":")[0]: entry for entry in entries})


@cache
def _builtin(name: str) -> Material:
    from ruamel.yaml import YAML

    return material_from_mapping(name, YAML(typ="safe", pure=True).load(_texts()[name])[name])


def with_levels(materials: Sequence[Material]) -> tuple[list[Material], list[int]]:
    """Materials, and behind them the steps of those that are mapped; and where those of each begin, -1 none."""
    every, first = list(materials), []
    for one in materials:
        levels = np.zeros(0) if one.maps is None else one.maps.levels
        first.append(len(every) if len(levels) else -1)
        every += [replace(one, rho=((0.0, float(rho)),)) for rho in levels]
    return every, first


# ------------------------------------------------------------------------------- whole scans of hits
_LOBED: Mapping[str, tuple[str, ...]] = MappingProxyType({"phong": ("phong",), "ggx": ("ggx", "coated")})
"Lobes, and the models that have them."


@dataclass(frozen=True, eq=False)
class SurfaceTable:
    """The materials of a scene at one wavelength, evaluated for arrays of hits without a loop over hits."""

    materials: tuple[Material, ...]
    wavelength_nm: float
    rho: Floats
    "(materials,) diffuse reflectance at the wavelength."
    baseline_m: float = 0.0
    "Distance between emitter and receiver, over the range the angle of observation."

    @classmethod
    def of(
        cls, materials: Sequence[Material], wavelength_nm: float, wet: bool = False, baseline_m: float = 0.0
    ) -> SurfaceTable:
        """Table of these materials; `wet` wets every surface that is not glass or water."""
        kept = tuple(replace(m, wet=True) if wet and m.model not in ("glass", "mirror") else m for m in materials)
        rho = np.array([m.reflectance(wavelength_nm) for m in kept], dtype=np.float64)
        return cls(kept, wavelength_nm, rho, baseline_m)

    def back(self, index: Ints, cosine: Floats, range_m: Floats | None = None) -> Floats:
        """pi f cos of every hit: reflectance equivalent to a Lambert plate seen face-on.

        Parameters
        ----------
        index : (m,) material of each hit, in the order of `materials`
        cosine : (m,) cosine of incidence, 0..1; its sign is ignored
        range_m : (m,) where the angle of observation follows from it; None: it is 0

        Mirrors and glass give their diffuse part only; what they send on is `sent_on`.
        """
        index = np.asarray(index)
        c = np.minimum(np.abs(floats(cosine)), 1.0)
        flat, rough, retro, lobed = self._shapes
        with np.errstate(under="ignore"):  # what reflects 1e-300 is black
            result = flat.take(index) * c
            if rough.any():
                result += rough.take(index) * (1.0 - c * c)
            if retro.any():
                back = retro.take(index)
                for number, one in self._sheeting:
                    at = indexes(index == number)
                    if len(at):
                        angle = 0.0 if range_m is None else np.arctan2(self.baseline_m, range_m[at])
                        back[at] *= one.share(angle, c[at])
                result += back
            for model, has in lobed:
                at = indexes(has.take(index))
                if not len(at):
                    continue
                k, cs = index[at], c[at]
                if model == "phong":
                    specular, exponent = self._phong[0, k], self._phong[1, k]
                    result[at] = brdf.phong_cos(self.rho[k], specular, exponent, cs)
                else:
                    f0, roughness, share = self._ggx
                    result[at] += share[k] * brdf.ggx_cos(f0[k], roughness[k], cs)
        return result

    @cached_property
    def _phong(self) -> Floats:
        """(2, materials): specular reflectance, exponent."""
        return np.array([self._column("rho_specular"), self._column("exponent")])

    @cached_property
    def _ggx(self) -> Floats:
        """(3, materials): F0, roughness, the lobe's share."""
        return np.array([self._column("f0"), self._column("roughness"), self._column("lobe_share")])

    @cached_property
    def factors(self) -> Floats:
        """(6, materials) of `back`: factors of cos and of sin^2, sheeting; a GGX lobe's share, F0 and roughness.

        Of those that stand `apart` nothing.
        """
        ggx = np.zeros(len(self.materials))
        for model, has in self._shapes[3]:
            if model == "ggx":
                ggx = has * self._column("lobe_share")
        flat, rough, retro, _ = self._shapes
        flat, retro = np.where(self.apart, 0.0, flat), np.where(self.apart, 0.0, retro)
        return np.array([flat, rough, retro, ggx, self._column("f0"), self._column("roughness")], np.float64)

    @cached_property
    def apart(self) -> Bools:
        """(materials,) those that `factors` have no place for: Phong's model, and sheeting of a class."""
        return np.array([m.model == "phong" or m.retro_class != "" for m in self.materials], bool)

    @cached_property
    def _sheeting(self) -> list[tuple[int, sheeting.Sheeting]]:
        """Materials whose retroreflection falls with the angles."""
        return [(k, sheeting.classes()[m.retro_class]) for k, m in enumerate(self.materials) if m.retro_class]

    @cached_property
    def _shapes(self) -> tuple[Floats, Floats, Floats, list[tuple[str, Bools]]]:
        """(materials,) factors of cos and of sin^2, what sheeting sends back, and which have a lobe, by model."""
        slope = np.array([m.slope_rad if m.model == "oren_nayar" else 0.0 for m in self.materials])
        flat, rough = brdf.oren_nayar_factors(slope)
        retro = [brdf.retro_equivalent(m.retro_cd_lx_m2) if m.model == "retro" else 0.0 for m in self.materials]
        lobed = [(one, np.array([m.model in of for m in self.materials], bool)) for one, of in _LOBED.items()]
        lobed = [(one, has) for one, has in lobed if has.any()]
        return self.rho * flat, self.rho * rough, np.array(retro, np.float64), lobed

    def sent_on(self, index: Ints, cosine: Floats) -> tuple[Floats, Floats]:
        """Shares of the light of every hit that go on: in the mirror direction, and through the pane, one way."""
        index = np.asarray(index)
        c = np.minimum(np.abs(floats(cosine)), 1.0)
        mirrored, through = np.zeros(c.shape), np.zeros(c.shape)
        panes, faces = self._panes.take(index), self.mirrors.take(index)
        of: Ints | slice = slice(None) if panes.all() else indexes(panes)
        k = index[of]
        mirrored[of], through[of] = brdf.pane_shares_cos(self.refraction.take(k), c[of], self._internal.take(k))
        if faces.any():
            k = index[faces]
            rs, rp = brdf.fresnel_cos(self.refraction[k], c[faces])
            mirrored[faces] = np.where(np.isnan(self._specular[k]), 0.5 * (rs + rp), self._specular[k])
        return mirrored, through

    def transmission(self, index: Ints, cosine: Floats) -> Floats:
        """Share of the light of every hit that passes the pane, one way; 0 for what is not glass."""
        return self.sent_on(index, cosine)[1]

    @cached_property
    def _panes(self) -> Bools:
        return np.array([m.model == "glass" for m in self.materials], bool)

    @cached_property
    def mirrors(self) -> Bools:
        """(materials,) those whose first face alone reflects."""
        return np.array([m.model == "mirror" for m in self.materials], bool)

    @cached_property
    def _specular(self) -> Floats:
        return np.array([np.nan if m.specular is None else m.specular for m in self.materials], np.float64)

    @cached_property
    def _internal(self) -> Floats:
        return self._column("internal")

    @cached_property
    def refraction(self) -> Floats:
        """(materials,) refractive indexes; of what is not glass nothing follows from them."""
        return self._column("index")

    @cached_property
    def optics(self) -> Floats:
        """(3, materials) of `sent_on`: refractive index, internal transmission, specular share, NaN: by the index."""
        return np.array([self.refraction, self._internal, self._specular])

    @property
    def largest(self) -> Floats:
        """(materials,) largest value that `back` can take at any incidence, lobes and sheeting included."""
        top = self.back(
            np.arange(len(self.materials)).repeat(91),
            np.tile(np.cos(np.radians(np.arange(91.0))), len(self.materials)),
        )
        return floats(top.reshape(len(self.materials), 91).max(axis=1))

    @cached_property
    def detailed(self) -> Bools:
        """(materials,) of which a face is not one plane of one reflectance: leaves, maps."""
        return np.array([m.foliage is not None or m.maps is not None for m in self.materials], bool)

    @cached_property
    def leafy(self) -> Bools:
        """(materials,) of which closed bodies are full of leaves."""
        return np.array([m.foliage is not None for m in self.materials], bool)

    @property
    def sends_on(self) -> bool:
        """True when a material has a mirrored or transmitted share above one per cent: rays must be continued."""
        return any(
            m.model in ("glass", "mirror") and (m.model == "glass" or m.specular is None or m.specular > 0.01)
            for m in self.materials
        )

    def _column(self, name: str) -> Floats:
        return np.array([getattr(m, name) for m in self.materials], dtype=np.float64)
