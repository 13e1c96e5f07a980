"""What the browser gets before viser's own page."""

from __future__ import annotations

import gzip

import pytest

pytest.importorskip("viser", reason="extra `view` is not installed")

from websockets.datastructures import Headers
from websockets.http11 import Response

from emulator.view.browser import HOLD_MS, NARROW_PX, SCRIPT, prepared

PAGE = b"<!doctype html><html><head><title>x</title></head></html>"


def answer(body: bytes, **headers: str) -> Response:
    fields = {name.replace("_", "-"): value for name, value in headers.items()}
    return Response(200, "OK", Headers(fields | {"Content-Length": str(len(body))}), body)


@pytest.mark.parametrize("packed", [False, True])
def test_the_script_comes_before_everything_else(packed: bool) -> None:
    headers = {"Content_Type": "text/html"} | ({"Content_Encoding": "gzip"} if packed else {})
    found = prepared(answer(gzip.compress(PAGE) if packed else PAGE, **headers))
    text = (gzip.decompress(found.body) if packed else found.body).decode()
    assert text.index("<script>") < text.index("<title>")
    assert f"max-width: {NARROW_PX}px" in text
    assert ".view-handle::before" in text
    assert found.headers.get_all("Content-Length") == [str(len(found.body))]


def test_other_answers_stay_as_they_are() -> None:
    assert prepared(None) is None
    assert prepared(answer(b"<head>", Content_Type="text/plain")).body == b"<head>"


def test_frames_are_held_for_a_limited_time() -> None:
    assert f"setTimeout(release, {HOLD_MS})" in SCRIPT
    assert "HOLD_MS" not in SCRIPT
    assert "NARROW_PX" not in SCRIPT
