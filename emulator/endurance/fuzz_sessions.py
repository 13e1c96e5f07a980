"""Fuzzing of the devices' conversations: what a host sends, in pieces with pauses, into a session that lives.

An input is read as operations: a byte that chooses the pause, a byte of length, that many bytes. On CAN a piece begins
with two bytes of identifier. What comes out is taken, what is asked for is measured (as scans without echoes).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from emulator.sensors.spec import load_spec
from protocols import family
from protocols.can_frame import EXTENDED
from protocols.errors import ScanRefused
from protocols.hesai.session import frame as ptc
from protocols.ld.packages import encode_packages
from protocols.ld.segments import encode_segments
from protocols.ld.telegrams import payload_of
from protocols.ld.usp import encode_frame
from protocols.lms2xx.telegrams import request
from protocols.rplidar.codec import request as rplidar_request
from protocols.scan import Scan
from protocols.session import Address, LinkKind, Session
from protocols.skeleton.cola_frames import frame
from protocols.skeleton.cola_values import ASCII, BINARY

PAUSES_NS = (0, 100_000, 1_000_000, 7_000_000, 30_000_000, 300_000_000, 2_000_000_000, 20_000_000_000)
MOST_HELD = 20_000
"Emissions that a session may have pending after one input."
ROUNDS = 40


def operations(pieces: Sequence[tuple[int, bytes]]) -> bytes:
    """The input that says these pieces, each after the pause of that number."""
    return b"".join(bytes((pause, len(part))) + part for pause, part in pieces)


def conversation(model: str, kind: LinkKind) -> Callable[[bytes], None]:
    """A target: one input to a fresh device of that model on a link of that kind."""
    spec = load_spec(model)
    assert spec.family is not None
    made = family(spec.family)

    def run(data: bytes) -> None:
        session = made.new_session({}, spec.device)
        session.connected(0, Address(0, 0), kind)
        session.power_on(0)
        if kind is LinkKind.STREAM:
            session.connected(0, Address(0, 1), kind)
        now_ns, at = 3_000_000_000, 0
        session.advance(now_ns)
        while at + 2 <= len(data):
            now_ns += PAUSES_NS[data[at] % len(PAUSES_NS)]
            piece = data[at + 2 : at + 2 + data[at + 1]]
            at += 2 + data[at + 1]
            if kind is LinkKind.CAN:
                word = int.from_bytes(piece[:2], "big")
                peer = (word & 0x7FF) | (EXTENDED | 0x18FF0000 if word & 0x8000 else 0)
                session.receive(piece[2:10], now_ns, Address(0, peer))
            else:
                session.receive(piece, now_ns, Address(0, 1 if kind is LinkKind.STREAM else 0))
            _serve(session, now_ns)
        if kind is LinkKind.STREAM:
            session.disconnected(now_ns, Address(0, 1))
        for _ in range(ROUNDS):
            wake = session.next_deadline()
            if wake is None:
                break
            now_ns = max(now_ns, wake)
            _serve(session, now_ns)

    return run


def _serve(session: Session, now_ns: int) -> None:
    session.advance(now_ns)
    plan = session.next_plan()
    if plan is not None:
        try:
            session.submit(Scan.empty(plan))
        except ScanRefused:
            pass
    if len(session.take_emissions(now_ns)) > MOST_HELD:
        raise AssertionError(f"more than {MOST_HELD} emissions at once")
    session.take_events()


LMS_SEEDS = (
    operations([(1, request(bytes.fromhex(text)))])
    for text in ("2024", "2025", "2048", "31", "3a", "3001", "10", "20 30 01", "3b b4 00 64 00", "72", "74", "77 01 01")
)
LMS = (
    *LMS_SEEDS,
    operations([(0, request(b"\x20\x00SICK_LMS")), (6, request(b"\x77" + bytes(34))), (6, request(b"\x20\x25"))]),
    operations([(0, request(b"\x20\x24")), (4, request(b"\x30\x01")), (4, request(b"\x3b\x64\x00\x32\x00"))]),
    operations([(0, request(b"\x36\x05")), (4, request(b"\x37\x01\x00\x64\x00")), (5, request(b"\x20\x2a"))]),
)
LD_WORDS = ((0x0101, 0), (0x0201, 1), (0x0202,), (0x0301, 0, 0x39FF), (0x0302, 1), (0x0401, 4), (0x0402, 10), (0x0404,),
            (0x0405,), (0x0501, 1, 2), (0x050A, 0, 2, 16), (0x050B, 0), (0x0510, 1), (0x040A, 0, 1000, 0))  # fmt: skip
LD_STREAM = tuple(operations([(3, encode_frame(payload_of(*words)))]) for words in LD_WORDS)
LD_SERIAL = tuple(operations([(3, encode_packages(payload_of(*words), 0x0001))]) for words in LD_WORDS)
LD_CAN = tuple(
    operations([(1, b"\x05\x01" + part) for part in encode_segments(payload_of(*words), 1)]) for words in LD_WORDS
)
SCIP = tuple(
    operations([(3, line + b"\n")])
    for line in (b"VV", b"PP;x", b"II", b"BM", b"GD0044072501", b"GS0044072503", b"MD0044072501000", b"ME0044072500102",
                 b"ND0000108001001", b"HE0000108000", b"TM0", b"TM1", b"TM2", b"SS115200", b"CR05", b"HS1", b"DB01",
                 b"RB", b"RB", b"RS", b"RT", b"%ST", b"%SL", b"SCIP2.0", b"QT")
)  # fmt: skip
RPLIDAR_REQUESTS = (
    (0x20, b""), (0x21, b""), (0x25, b""), (0x40, b""), (0x50, b""), (0x52, b""), (0x59, b""), (0x82, bytes(5)),
    (0x82, b"\x03" + bytes(4)), (0x83, bytes(33)), (0x84, b"\x70\0\0\0"), (0x84, b"\x71\0\0\0\x03\0"),
    (0x85, b"\xc0\xcc\x01\0" + bytes(12)), (0x90, b"\x5f\x5f\0\xd0\x07\0\0\0"), (0xA8, b"\x58\x02"),
    (0xF0, b"\x94\x02"), (0xF0, bytes(2)), (0xFF, bytes(4)),
)  # fmt: skip
RPLIDAR = (
    *(operations([(3, rplidar_request(code, payload))]) for code, payload in RPLIDAR_REQUESTS),
    operations([(3, b"A" * 64)]),
)
LDROBOT = (operations([(3, bytes.fromhex("54a10400000000 4a"))]),)
YDLIDAR = tuple(
    operations([(3, bytes((0xA5, code))), (5, b"\xa5\x60"), (4, b"\xa5\x65")])
    for code in (0x00, 0x60, 0x61, 0x65, 0x90, 0x91, 0x92, 0x40, 0x80, 0x09, 0x0B, 0x0C, 0x0D, 0xD0, 0xD1, 0xD9, 0x05)
)
CAN_OBJECTS = tuple(
    operations([(2, identifier.to_bytes(2, "big") + payload)])
    for identifier in (0x200, 0x202, 0x300, 0x301, 0x400, 0x401, 0x4F0, 0x4F1, 0x5F2, 0x5F3, 0x5F4, 0x740, 0x741, 0x742)
    for payload in (bytes(8), b"\xff" * 8, bytes.fromhex("f8000000 08 00 00 00"), b"\x01\x02")
)
VELODYNE = tuple(
    operations([(3, text.replace(b"|", b"\r\n"))])
    for text in (
        b"GET /cgi/status.json HTTP/1.1||", b"GET /cgi/diag.json HTTP/1.1||", b"GET /cgi/snapshot.hdl HTTP/1.1||",
        b"POST /cgi/setting HTTP/1.1|Content-Length: 8||rpm=1200", b"GET /packets HTTP/1.1||", b"GET / HTTP/1.0||",
        b"POST /cgi/setting HTTP/1.1|Content-Length: 12||returns=Dual", b"POST /cgi/reset HTTP/1.1||",
        b"POST /cgi/setting HTTP/1.1|Content-Length: 9||laser=off", b"POST /cgi/save HTTP/1.1|Content-Length: 0||",
        b"POST /cgi/setting/fov HTTP/1.1|Content-Length: 16||start=290&end=70", b"POST /x|Transfer-Encoding: y||",
        b"POST /cgi/setting/phaselock HTTP/1.1|Content-Length: 22||enabled=on&offset=9000",
    )
)  # fmt: skip
HESAI = tuple(
    operations([(3, data)])
    for data in (
        *(ptc(command) for command in (0x05, 0x07, 0x08, 0x09, 0x10, 0x23, 0x25, 0x26, 0x27, 0x28, 0x3A, 0x59, 0xEE)),
        ptc(0x06, b"\1"), ptc(0x17, b"\x04\xb0"), ptc(0x18, b"\1\0\x5a"), ptc(0x1C, b"\1"), ptc(0x1E, b"\2"),
        ptc(0x1F, b"\1"),
        ptc(0x20, bytes((127, 0, 0, 1, 9, 64, 39, 126))), ptc(0x21, bytes(15)), ptc(0x22, bytes.fromhex("00012c05dc")),
        b"\x47\x74\x17\0\xff\xff\xff\xff", b"\x57\x75\1\1" + bytes(7) + b"\3abc",
        ptc(0x22, bytes.fromhex("030200000064070808 34")), ptc(0x24, b"\3\0\1\1"), ptc(0x29, b"\1"), ptc(0x2A, b"\1"),
        b"GET /point_cloud HTTP/1.1\r\n\r\n", b"GET /pandar.cgi?action=get&object=lidar_monitor HTTP/1.1\r\n\r\n",
        b'GET /pandar.cgi?action=set&object=lidar_sync&key=sync_angle&value={"sync": 1,"syncAngle": 30} HTTP/1.1'
        b"\r\n\r\n",
    )
)  # fmt: skip
OUSTER = tuple(
    operations([(6, text.replace(b"|", b"\r\n").replace(b"~", b" /api/v1/"))])
    for text in (
        b"GET~sensor/metadata HTTP/1.1||", b"GET~sensor/config?staging=true HTTP/1.1||", b"GET~time HTTP/1.1||",
        b'POST~sensor/config?reinit=False&persist=False HTTP/1.1|Content-Length: 20||{"udp_dest":"@auto"}',
        b'POST~sensor/config HTTP/1.1|Content-Length: 24||{"lidar_mode":"4096x5"} ', b"GET~sensor/telemetry HTTP/1.1||",
        b'POST~sensor/config HTTP/1.1|Content-Length: 32||{"azimuth_window":[270000,90000]}',
        b"GET /packets HTTP/1.1||",
        b'POST~sensor/config HTTP/1.1|Content-Length: 30||{"operating_mode":  "STANDBY"}',
        b"DELETE~user/data HTTP/1.1||", b"DELETE~sensor/config HTTP/1.1||",
        b'PUT~user/data?policy=keep_on_config_delete HTTP/1.1|Content-Length: 5||"abc"',
        b"GET~sensor/alerts?cursor=3&mode=summary HTTP/1.1||", b"POST~system/restart HTTP/1.1|Content-Length: 0||",
        b"get_config_param active udp_dest\n", b"set_config_param udp_port_lidar 7502 \n", b"reinitialize \n",
    )
)  # fmt: skip
COLA_TEXTS = (
    "sMN SetAccessMode 03 F4724744", "sRN LMPscancfg", "sMN mLMPsetscancfg +2500 +1 +2500 -450000 +2250000",
    "sWN LMPoutputRange 1 1388 FFF92230 225510", "sWN LMDscandatacfg 1F 00 3 1 0 01 00 1 1 1 1 +1", "sRN LMDscandata",
    "sEN LMDscandata 1", "sEN LFErec 1", "sMN LMCstopmeas", "sMN LMCstartmeas", "sMN mSCreboot", "sRI 0", "sRN STlms",
    "sWN LocationName B hello world", "sMN LSPsetdatetime +2026 +11 +21 0 +37 +20 0", "sMN GetChallenge 3",
    "sWN field000 3F800000 00000000 1388 FFF92230 1 1 0 1 0 5DC 0 1F40 1F40 0 0 1 6 FIELD1 0", "sMN mEEwriteall",
    "sWN FREchoFilter 1", "sWN LFPmeanfilter 1 +5 0", "sWN LFPmedianfilter 1 3", "sWN LFPparticle 1 +500", "sMN Run",
)  # fmt: skip
COLA_BINARY = (
    b"sMN SetAccessMode \x03\xf4\x72\x47\x44", b"sEN LMDscandata \x01", b"sRI \x00\x00",
    b"sMN mLMPsetscancfg \x00\x00\x09\xc4\x00\x01\x00\x00\x09\xc4\xff\xf9\x22\x30\x00\x22\x55\x10",
    b"sWN ScanLayerFilter \x00\x04\x01\x00\x01\x00", b"sEN InertialMeasurementUnit \x01",
)  # fmt: skip
COLA = (
    *(operations([(3, frame(ASCII, text.encode()))]) for text in COLA_TEXTS),
    *(operations([(3, frame(BINARY, payload))]) for payload in COLA_BINARY),
    operations([(7, frame(ASCII, text.encode())) for text in (COLA_TEXTS[0], COLA_TEXTS[16], COLA_TEXTS[6])]),
    operations([(7, frame(ASCII, COLA_TEXTS[k].encode())) for k in (0, 4, 19, 18, 6, 5, 2)]),
)
