"""What distinguishes the models that speak CoLa: fields of view, frequencies, echoes, counters, times.

Belongs here: facts that the conversation needs. Not: light and receiver (emulator/sensors/*.yaml). Marks as in the
sources: [REC] recorded, [M] manual page, [V] a driver took it, [I] concluded, [G] guessed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from protocols.errors import DeviceSettingError

Pair = tuple[int, int]
"Scan frequency in 1/100 Hz and angular step in 1/10000 deg, as on the wire."

FULL_TURN = 3_600_000
"1/10000 deg."


@dataclass(frozen=True)
class Model:
    """One model."""

    name: str
    ident: str
    "What DeviceIdent says."
    firmware: str
    series: str
    "lms1 | lms5 | tim | mrs: what else differs goes by it."
    start: int
    stop: int
    "Field in its own frame: 0 is the right-hand side, 90 deg straight ahead; 1/10000 deg."
    pairs: Mapping[Pair, int]
    "Allowed pairs -> turns until the fine step is complete: 1, or interlaced."
    default: Pair
    echoes: int = 1
    "In a telegram."
    layers_cdeg: tuple[int, ...] = (0,)
    "Layer field of successive telegrams, positive downwards; 1/100 deg."
    remission: tuple[int, int] = (0, 0)
    "Remission switch and resolution in the factory's LMDscandatacfg."
    version: int = 1
    device_number: int = 1
    fields: int = 0
    outputs: int = 0
    stamps_end: bool = False
    "The scan's time is that of its last beam."
    transmission_ns: int = 900_000
    "To the telegram: from the end of the turn, or of the field."
    sends_after_turn: bool = False
    window_status: tuple[int, int, int] = (0, 0, 0)
    "Status byte of scans: window clean, contamination warning, error."
    ready_output: int = 0
    "Bits of outputs that are on as long as it measures."
    sends_time: bool = True
    "TiM5xx: never, whatever LMDscandatacfg says [M]."
    ready_s: float = 10.0
    "From power-on until it measures."
    change_s: float = 2.0
    "Without data after another scan configuration; a real LMS1xx needs up to 30 s."
    usable_state: int = 1
    "SCdevicestate of a device that measures."
    location: str = "not defined"
    serial_line: bool = False
    "CoLa-A on RS-232 as well."
    nearest_raw: int = 16
    "Smaller values are no distances."

    def step(self, wire: int) -> Fraction:
        """The step itself: the wire rounds thirds. [1/10000 deg]"""
        return EXACT.get(wire, Fraction(wire))

    @property
    def layers(self) -> int:
        """Telegrams until the same elevation comes again."""
        return len(self.layers_cdeg)

    def layers_on(self, values: Mapping[str, Any]) -> list[int]:
        """Layers that have telegrams, at ScanLayerFilter and MMAlignmentMode (0: all, 1: the lowest alone)."""
        (switches,), (alone,) = values.get("ScanLayerFilter", [[[1]] * self.layers]), values.get("MMAlignmentMode", [0])
        upwards = sorted(range(self.layers), key=lambda layer: -self.layers_cdeg[layer])
        return [layer for layer in (upwards[alone - 1 : alone] if alone else upwards) if switches[layer][0]]

    def starts(self, pair: Pair) -> tuple[int, ...]:
        """First direction of successive turns, which interlaced ones shift; 1/10000 deg."""
        turns = self.pairs[pair]
        if self.series == "mrs":  # -137.5, then -137.625; -137.4375 .. -137.625 in the driver's source
            return tuple(self.start - (k - turns // 4) * pair[1] for k in range(turns))
        return tuple(self.start + round(k * self.step(pair[1])) for k in range(turns))

    def coarse(self, pair: Pair) -> Fraction:
        """Step within one turn: that of the grid, times the turns that complete it. [1/10000 deg]"""
        return self.step(pair[1]) * self.pairs[pair]

    def points(self, pair: Pair) -> int:
        """Beams of the first turn over the whole field."""
        return int((self.stop - self.start) / self.coarse(pair)) + 1

    def telegram_ns(self, pair: Pair) -> Fraction:
        """From telegram to telegram; of several layers, from layer to layer."""
        hundredths = 5000 if self.series == "mrs" else pair[0]
        return Fraction(100_000_000_000, hundredths)

    def turn_ns(self, pair: Pair) -> Fraction:
        """One turn of the mirror."""
        return self.telegram_ns(pair) * self.layers

    def beam_ns(self, pair: Pair) -> Fraction:
        """From beam to beam."""
        return self.turn_ns(pair) * self.coarse(pair) / FULL_TURN

    def frequencies(self, pair: Pair) -> tuple[int, int]:
        """Scan and measurement frequency as LMDscandata has them: 1/100 Hz, and units of 100 Hz."""
        return (
            round(Fraction(100_000_000_000) / self.telegram_ns(pair)),
            round(10_000_000 / self.beam_ns(pair)),
        )


EXACT = {1667: Fraction(5000, 3), 3333: Fraction(10000, 3), 6667: Fraction(20000, 3)}
"1/6, 1/3 and 2/3 of a degree: 190 deg have 1141, 571 and 286 points [REC]."

LMS1 = {(2500, 2500): 1, (2500, 5000): 1, (5000, 5000): 1}
"What the vendor's driver allows; 36 000 shots a second [I]."
LMS5 = {
    **{(2500, 1667): 1, (3500, 2500): 1, (5000, 3333): 1, (7500, 5000): 1, (10000, 6667): 1},  # 54 kHz: [REC], [V], [I]
    **{(2500, 2500): 1, (2500, 5000): 1, (3500, 5000): 1, (5000, 5000): 1, (5000, 10000): 1},  # reduced [I]
    **{(7500, 10000): 1, (10000, 10000): 1},
    **{(5000, 1667): 2, (10000, 3333): 2, (7500, 2500): 2, (10000, 1667): 4},  # interlaced [I], the last [M]
}
MRS = {(5000, 2500): 1, (2500, 1250): 2, (1250, 625): 4}
"Frequency as the listing has it; telegrams keep 0.25 deg and 50 a second, the start shifts [M] [V]."

_LMS1 = Model(
    name="", ident="", firmware="V1.80", series="lms1", start=-450_000, stop=2_250_000,
    pairs=LMS1, default=(5000, 5000), echoes=2, remission=(0, 0), fields=10, outputs=4, serial_line=True,
    sends_after_turn=True, window_status=(0, 2, 4),
)  # fmt: skip
_TIM = Model(
    name="", ident="", firmware="V2.60", series="tim", start=-450_000, stop=2_250_000,
    pairs={(1500, 3333): 1}, default=(1500, 3333), remission=(1, 1), stamps_end=True, transmission_ns=6_300_000,
    ready_s=3.0, usable_state=0, outputs=4, sends_time=False, ready_output=0b1000,
)  # fmt: skip


def _like(model: Model, **facts: Any) -> Model:
    return Model(**{**{name: getattr(model, name) for name in model.__dataclass_fields__}, **facts})


_LMS5 = _like(
    _LMS1, series="lms5", ident="LMS511_FieldEval", firmware="V1.80", start=-50_000, stop=1_850_000,
    pairs=LMS5, default=(5000, 5000), echoes=5, remission=(1, 0), version=0, outputs=14,
)  # fmt: skip

MODELS: Mapping[str, Model] = {
    model.name: model
    for model in (
        _like(_LMS1, name="sick-lms100", ident="LMS10x_FieldEval"),
        _like(_LMS1, name="sick-lms111", ident="LMS11x_FieldEval"),
        _like(_LMS1, name="sick-lms151", ident="LMS15x_FieldEval"),
        _like(_LMS5, name="sick-lms500", ident="LMS500_FieldEval"),
        _like(_LMS5, name="sick-lms511"),
        _like(_TIM, name="sick-tim551", ident="TiM551", pairs={(1500, 10000): 1}, default=(1500, 10000)),
        _like(_TIM, name="sick-tim561", ident="TiM561", firmware="V2.51"),
        _like(_TIM, name="sick-tim571", ident="TiM571"),
        _like(_TIM, name="sick-tim781", ident="TiM781", firmware="V5.0", fields=48, outputs=5, sends_time=True),
        _like(
            _TIM, name="sick-mrs1104", ident="MRS1xxxx", firmware="1.4.0.0R", series="mrs", start=-475_000,
            stop=2_275_000, pairs=MRS, default=(5000, 2500), echoes=3, layers_cdeg=(0, -250, 250, -500),
            remission=(1, 0), device_number=0, stamps_end=False, transmission_ns=900_000, ready_s=10.0, usable_state=1,
            location="SN ", outputs=0, sends_time=True, ready_output=0,
        ),
    )
}  # fmt: skip
"By the name in the spec file."


def model_of(facts: Mapping[str, Any]) -> Model:
    """The model that a spec's `device` table names. Raises `DeviceSettingError`."""
    name = facts.get("model")
    if name not in MODELS:
        raise DeviceSettingError("model", name, f"one of {', '.join(MODELS)}")
    return MODELS[str(name)]
