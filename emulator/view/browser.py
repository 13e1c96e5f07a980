"""Script and style that the browser gets before viser's own: controls before the 3-D scene, and the panel of a phone.

Belongs here: what is inserted into the page. Not: who may load it (access, local_server), its contents (page).
"""

from __future__ import annotations

import gzip
from typing import Any

from websockets.http11 import Response

NARROW_PX = 600
"Width up to which the page has one panel at the bottom, which begins folded."
HOLD_MS = 15_000
"Longest time for which frames wait for the controls, from the end of loading."
SCRIPT = """
(() => {
  const draw = window.requestAnimationFrame.bind(window), drop = window.cancelAnimationFrame.bind(window)
  const waiting = new Map(), held = new Map()
  let number = 0, rest = 200, holding = true
  const start = (own, picture) => {
    const ask = () => {
      const asked = performance.now()
      waiting.set(own, [1, draw((at) => {
        waiting.delete(own)
        picture(at)
        const took = performance.now() - asked
        rest = took > 60 ? Math.min(200, 2 * took) : Math.max(0, rest - 20)
      })])
    }
    if (rest < 4) ask()
    else waiting.set(own, [0, setTimeout(ask, rest)])
  }
  window.requestAnimationFrame = (picture) => {
    const own = ++number
    if (holding) held.set(own, picture)
    else start(own, picture)
    return own
  }
  window.cancelAnimationFrame = (own) => {
    held.delete(own)
    const found = waiting.get(own)
    waiting.delete(own)
    if (found) (found[0] ? drop : clearTimeout)(found[1])
  }
  // viser applies messages at once in a hidden tab, and in a visible one with the next frame of the scene
  Object.defineProperty(document, 'hidden', {configurable: true, get: () => true})
  const release = () => {
    if (!holding) return
    holding = false
    delete document.hidden
    for (const [own, picture] of held) start(own, picture)
    held.clear()
  }
  window.addEventListener('load', () => setTimeout(release, HOLD_MS))

  // the limit of viser's own layout for phones is 36em
  const media = window.matchMedia.bind(window)
  window.matchMedia = (query) => media(query.replace('(max-width: 36em)', '(max-width: NARROW_PXpx)'))
  let folded = false
  const fold = () => {
    const handle = document.querySelector('#root [style*="cursor: pointer"][style*="height: 3.5em"]')
    if (!handle) { folded = false; return }
    handle.classList.add('view-handle')
    if (!folded) { folded = true; handle.click() }
  }
  new MutationObserver(() => {
    if (holding && document.getElementById('view-time')) draw(() => draw(release))
    fold()
  }).observe(document, {childList: true, subtree: true})
})()
""".replace("HOLD_MS", str(HOLD_MS)).replace("NARROW_PX", str(NARROW_PX))
"""Frames of the 3-D scene begin after the controls have been painted: without a graphics card the first ones take
seconds. Later, slow frames are spaced, so that the page has time for everything else. On a narrow screen the panel is
folded when it appears; its handle unfolds it."""
STYLE = """
.view-handle::before {
  content: ""; position: absolute; top: 6px; left: calc(50% - 20px); width: 40px; height: 4px; border-radius: 2px;
  background: currentColor; opacity: 0.6
}
"""


def prepared(answer: Any) -> Any:
    """The page with `SCRIPT` and `STYLE` before everything else; other answers unchanged."""
    if not isinstance(answer, Response) or not answer.headers.get("Content-Type", "").startswith("text/html"):
        return answer
    packed = answer.headers.get("Content-Encoding") == "gzip"
    text = gzip.decompress(answer.body) if packed else bytes(answer.body)
    head = f'<head><meta charset="utf-8"><script>{SCRIPT}</script><style>{STYLE}</style>'
    text = text.replace(b"<head>", head.encode(), 1)
    answer.body = gzip.compress(text, 3) if packed else text
    del answer.headers["Content-Length"]
    answer.headers["Content-Length"] = str(len(answer.body))
    return answer
