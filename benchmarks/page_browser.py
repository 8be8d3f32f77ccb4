"""Cost of the page in the browser: script per frame, the first picture, its heap.

Times are processor times of the main thread, so that other load does not count.
"""

import asyncio
from collections import defaultdict
from typing import Any

import numpy as np

from benchmarks.chromium import Tab, browser
from hilserver.bench.report import Result

_WATCHING = """
window.draws = 0; window.sockets = [];
for (const name of ["drawElements", "drawArrays"]) {
  const real = WebGL2RenderingContext.prototype[name];
  WebGL2RenderingContext.prototype[name] = function (...args) {
    window.draws++;
    return real.apply(this, args);
  };
}
window.WebSocket = class extends WebSocket {
  constructor(...args) { super(...args); window.sockets.push(this); }
};
window.calls = (method) => fetch("./api/call", { method: "POST", body: JSON.stringify({ method }),
  headers: { "Content-Type": "application/json",
    "X-Hilserver-Token": document.querySelector('meta[name="token"]').content } });
"""
_BEGIN = """(async () => {
  const socket = window.sockets.at(-1), handle = socket.onmessage;
  const frame = await new Promise((done) => {
    socket.onmessage = (e) => { handle(e); if (typeof e.data !== "string") done(e.data); };
  });
  socket.onmessage = (e) => { if (typeof e.data === "string") handle(e); };
  const view = new DataView(frame), n = view.getUint16(2, true);
  const first = Array.from({ length: n }, (_, i) => view.getFloat64(16 + 8 * i, true));
  let k = 0;
  window.repeat = async (times) => {
    for (const end = k + times; k < end; k++) {
      for (let i = 0; i < n; i++) view.setFloat64(16 + 8 * i, first[i] + k / 30, true);
      handle({ data: frame });
    }
    await new Promise(requestAnimationFrame);
  };
  window.resume = () => { socket.onmessage = handle; };
})()"""
_SHOWN = "/[0-9]/.test((document.querySelector('.dial b') || {}).textContent)"
_PAUSED = "document.querySelector('.state').dataset.state === 'paused'"
_SCRIPTS = ("FunctionCall", "EvaluateScript", "FireAnimationFrame", "TimerFire")
_STILL_S = 3.0
_AT_ONCE = 500


async def measure(
    url: str, rate_hz: float, seconds: float, frames: int
) -> list[Result]:
    """Return the figures of one browser that shows the Drive view of a driving robot."""
    async with browser() as where:
        empty = await Tab.open(*where)
        await empty.ask("Performance.enable", timeDomain="threadTicks")
        await empty.ask("Page.navigate", url=f"{url}icon.svg")
        await asyncio.sleep(1.0)
        empty_s = await empty.main_thread_s()
        await empty.close()
        tab = await Tab.open(*where)
        await tab.ask("Performance.enable", timeDomain="threadTicks")
        await tab.ask("Page.enable")
        await tab.ask("Page.addScriptToEvaluateOnNewDocument", source=_WATCHING)
        await tab.ask("Page.navigate", url=url)
        await tab.wait_for(_SHOWN)
        first_s = await tab.main_thread_s()
        await asyncio.sleep(2.0)
        script_ms = _per_frame_ms(await tab.traced(seconds), rate_hz)
        drawn = await tab.run("window.draws")
        still = await _draws_when_still(tab)
        growth = await _heap_growth(tab, frames)
        await tab.close()
    raw = {
        "frames": len(script_ms),
        "median_ms": float(np.median(script_ms)),
        "draws": drawn,
    }
    return [
        Result(
            "script_per_frame_p95_ms",
            float(np.percentile(script_ms, 95)),
            "ms",
            raw=raw,
        ),
        Result("first_picture_cpu_s", first_s, "s", empty_s, "an empty page"),
        Result("draws_when_nothing_changes", still, "1"),
        Result("page_heap_growth_mb", growth / 1e6, "MB", raw={"frames": frames}),
    ]


async def _draws_when_still(tab: Tab) -> float:
    await tab.run("window.calls('Pause')")
    await tab.wait_for(_PAUSED)
    await asyncio.sleep(2.0)
    before = await tab.run("window.draws")
    await asyncio.sleep(_STILL_S)
    drawn = float(await tab.run("window.draws") - before)
    await tab.run("window.calls('Start')")
    return drawn


async def _heap_growth(tab: Tab, frames: int) -> float:
    """Return the growth of the heap over `frames` frames, half of them in Watch."""
    for view in ("watch", "drive"):
        await _show(tab, view, 2000)
    before = await tab.heap_bytes()
    for view in ("watch", "drive"):
        await _show(tab, view, frames // 2)
    return await tab.heap_bytes() - before


async def _show(tab: Tab, view: str, frames: int) -> None:
    await tab.run(f"location.hash = '{view}'")
    await tab.wait_for(f"document.querySelector('main').dataset.view === '{view}'")
    await asyncio.sleep(1.0)
    await tab.run(_BEGIN)
    for done in range(0, frames, _AT_ONCE):
        await tab.run(f"window.repeat({min(_AT_ONCE, frames - done)})")
    await tab.run("window.resume()")


def _per_frame_ms(events: list[dict[str, Any]], rate_hz: float) -> list[float]:
    """Return the script time of the main thread in each frame period [ms]."""
    threads: dict[tuple[int, int], list[dict[str, Any]]] = defaultdict(list)
    for event in events:
        if event.get("ph") == "X" and event["name"] in _SCRIPTS and "tdur" in event:
            threads[event["pid"], event["tid"]].append(event)
    if not threads:
        return [float("nan")]
    most = max(len(found) for found in threads.values())
    busiest = next(found for found in threads.values() if len(found) == most)
    ours = sorted(busiest, key=lambda event: event["ts"])
    start_us, period_us, end_us = ours[0]["ts"], 1e6 / rate_hz, 0.0
    sums: dict[int, float] = defaultdict(float)
    for event in ours:
        if event["ts"] >= end_us:  # not nested in the previous one
            end_us = event["ts"] + event["dur"]
            sums[int((event["ts"] - start_us) / period_us)] += event["tdur"] / 1e3
    return [sums[k] for k in range(max(sums) + 1)]
