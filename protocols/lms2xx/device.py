"""The state of one LMS2xx and the blocks that report it: type, status. No time, no bytes of the line."""

from __future__ import annotations

from dataclasses import dataclass, replace

from protocols.lms2xx import configuration as block
from protocols.lms2xx.evaluation import Fields
from protocols.lms2xx.fields import FACTORY, FieldSet, Teaching
from protocols.lms2xx.models import Model
from protocols.lms2xx.outputs import Format, Output
from protocols.lms2xx.settings import Settings
from protocols.lms2xx.telegrams import word, words
from protocols.lms2xx.values import MEASURING_MODES, MeasuringMode
from protocols.lms2xx.variants import VARIANTS, Variant

INSTALLATION = 0x00
ON_REQUEST = 0x25

FACTORY_BAUD = 9600
RATE_CODES = {0x48: 500_000, 0x40: 38_400, 0x41: 19_200, 0x42: 9_600}
"Sub-code of command 20 -> baud (listing, tables 7-17 and 7-18)."
RATE_WORDS = {500_000: 0x8001, 38_400: 0x8019, 19_200: 0x8033, 9_600: 0x8067}
"Baud -> word of the status telegram (listing p. 56)."

WARNING, ERROR = 2, 3
"Severities of the status byte and of stored errors."
POLLUTED, OPAQUE = 0.7, 0.4
"Transmission of the window below which it counts as dirty (a warning), and as too dirty (an error); ours."
POLLUTED_BIT = 0x80
DIRT_ERROR, MOTOR_ERROR = 18, 29
"Codes of reply B2: dirt on pollution channel 1, motor revolutions."

FACTORY_PASSWORD = b"SICK_LMS"

STATUS_BYTES = 152
"The listing's table adds up to 146; its example and every driver have 152."


@dataclass(frozen=True)
class Device:
    """Everything that commands read and change; replaced as a whole."""

    model: Model
    settings: Settings
    configuration: bytes
    "EEPROM."
    startup_baud: int
    "EEPROM: line speed after power-on."
    permanent_baud: bool
    "EEPROM: whether that speed was made permanent."
    switch_ons: int
    "EEPROM."
    baud: int
    variant: Variant
    startup_variant: Variant
    "EEPROM."
    password: bytes
    "EEPROM: of SICK's service and authorised customers."
    errors_stored: tuple[tuple[int, int], ...]
    "EEPROM: type and code, oldest first."
    maintenance_password: bytes = FACTORY_PASSWORD
    "EEPROM."
    new_password: bytes | None = None
    "Code and password of a first 42 that waits for its confirmation."
    second_block: bytes = block.SECOND_DEFAULT
    "EEPROM: configuration of 7B and 7C."
    field_sets: tuple[FieldSet, FieldSet] = ((FACTORY,) * 3, (FACTORY,) * 3)
    "EEPROM."
    active_set: int = 1
    "EEPROM."
    taught: tuple[int, int] | None = None
    "EEPROM: set and field that was taught last."
    teaching: Teaching | None = None
    mode: int = ON_REQUEST
    "Sub-code of command 20."
    stream: Output | None = None
    "What the mode sends without being asked."
    window: float = 1.0
    "Share of light that passes the front window."
    motor: float = 1.0
    "Speed of the mirror over the nominal one; 0: it stands."
    motor_wrong: bool = False
    "Its supervision has found the motor wrong."
    stream_number: int = 0
    "One more with every mode that was entered, the same one again included."

    @property
    def status(self) -> int:
        """The last byte of every reply."""
        bits = self.settings.status_bits
        if self.window < POLLUTED or self.motor_wrong:
            severity = ERROR if self.motor_wrong or self.window < OPAQUE else WARNING
            bits = bits & ~7 | max(bits & 7, severity)
        return self.model.status | bits | (POLLUTED_BIT if self.window < POLLUTED else 0)

    @property
    def errors(self) -> tuple[tuple[int, int], ...]:
        """Type and code of each stored error, oldest first; those of now at the end."""
        found = self.errors_stored
        if self.window < POLLUTED:
            found += ((ERROR if self.window < OPAQUE else WARNING, DIRT_ERROR),)
        return (*found, (ERROR, MOTOR_ERROR)) if self.motor_wrong else found

    @property
    def unit(self) -> int:
        return self.configuration[block.UNIT]

    @property
    def measuring_mode(self) -> MeasuringMode:
        return MEASURING_MODES[self.configuration[block.MEASURING_MODE]]

    @property
    def gain(self) -> float:
        """Receiver sensitivity against the standard setting."""
        return block.receiver_gain(self.configuration, self.model.has_sensitivity)

    @property
    def format(self) -> Format:
        """How measured values are written now."""
        return Format(
            self.measuring_mode,
            self.unit,
            bool(self.configuration[block.AVAILABILITY] & block.INDICES),
            self.model.reflectivity_k_m2 * self.gain,
            self.fields,
            self.variant.turns,
        )

    @property
    def fields(self) -> Fields | None:
        """The active set; S14 models have none."""
        if self.model.fast:
            return None
        level = self.configuration[block.AVAILABILITY]
        return Fields(
            self.field_sets[self.active_set - 1],
            bool(self.configuration[block.SUBTRACTIVE]),
            self.model.special,
            not level & (block.HIGHEST_LEVEL | block.DAZZLE_IGNORED),
        )

    @property
    def evaluations(self) -> int:
        """Scans in a row that an object must be in a field: byte H, with set 2 byte E of block 2 added."""
        offset = block.signed(self.second_block[block.SET_2_OFFSET]) if self.active_set == 2 else 0
        return max(1, self.configuration[block.MULTIPLE_EVALUATION] + offset)

    @property
    def type_text(self) -> bytes:
        """21 characters."""
        return self.model.type_text.encode("ascii")


def new_device(model: Model, settings: Settings) -> Device:
    """A device as it was stored: switched off, its EEPROM filled."""
    return Device(
        model=model,
        settings=settings,
        configuration=settings.configuration,
        startup_baud=settings.startup_baud,
        permanent_baud=settings.permanent_baud,
        switch_ons=settings.switch_ons,
        baud=settings.startup_baud,
        variant=settings.variant,
        startup_variant=settings.variant,
        password=settings.password,
        errors_stored=settings.errors,
    )


def restarted(device: Device, switched_on: bool) -> Device:
    """After power-on or reset: EEPROM kept; mode, speed and variant as at every start.

    A reset clears the stored errors (listing, p. 38).
    """
    return replace(
        device,
        switch_ons=min(device.switch_ons + switched_on, 0xFFFF),
        baud=device.startup_baud,
        variant=device.startup_variant,
        errors_stored=device.errors_stored if switched_on else (),
        mode=ON_REQUEST,
        stream=None,
        new_password=None,
        teaching=None,
        stream_number=device.stream_number + 1,
    )


def find_variant(device: Device, data: bytes) -> Variant | None:
    """The variant that a 3B asks for; None when this device does not have it."""
    field_deg, step_cdeg = words(data)
    for variant in () if device.model.fast else VARIANTS:
        if (variant.field_deg, variant.step_cdeg) == (field_deg, step_cdeg):
            return variant
    return None


def variant_words(device: Device) -> bytes:
    """Field and step as in BB and B1."""
    return word(device.variant.field_deg) + word(device.variant.step_cdeg)


POLLUTION, POLLUTION_REFERENCE = 500, 600
POLLUTION_CALIBRATION, REFERENCE_CALIBRATION = 510, 610
NINETIETH_US = 148
"Microseconds of 1/90 turn of the mirror at 75 turns per second (listing, p. 54)."
LASER_POWER = 100
"Per cent of the value at calibration."
"Values of a clean, healthy device; plausible, not measured."


def status_block(device: Device) -> bytes:
    """The 152 bytes of B1 (listing, table 7-33 with the offsets of sicktoolbox, Player, Robotics Library)."""
    config = device.configuration
    data = bytearray(STATUS_BYTES)

    def put(offset: int, value: bytes) -> None:
        data[offset : offset + len(value)] = value

    put(0, device.model.firmware.encode("ascii"))
    data[7] = device.mode
    data[8] = 1 if device.status & 7 >= ERROR else 0
    put(9, device.settings.serial_number)
    data[17] = 1 if device.model.special else 0
    put(18, word(round(POLLUTION * device.window)) * 8 + word(POLLUTION_REFERENCE) * 4)
    put(42, word(POLLUTION_CALIBRATION) * 8 + word(REFERENCE_CALIBRATION) * 4)
    put(66, word(min(round(NINETIETH_US / device.motor), 0xFFFF) if device.motor else 0))
    put(82, word(LASER_POWER))
    data[101] = config[block.MEASURING_MODE]
    put(106, variant_words(device))
    data[110] = config[block.RESTART_MODE]
    put(111, word(config[block.RESTART_TIME]))
    data[113] = device.second_block[block.SET_2_OFFSET]
    put(115, word(RATE_WORDS[device.baud]))
    data[117] = config[block.MULTIPLE_EVALUATION]
    data[118] = device.permanent_baud
    data[119] = device.settings.address
    data[120] = device.active_set
    data[121] = device.unit
    data[122] = 1 if device.motor else 0  # the laser is on while the mirror turns
    put(123, b"X01.03 ")
    return bytes(data)
