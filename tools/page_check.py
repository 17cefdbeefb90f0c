"""Looks at a page of `sphpetsc report` in a headless Chromium; says what it saw, exits with 1 where something is wrong.

    python3 tools/page_check.py report.html [--png DIR]

The page must load without console errors, draw its plots, and sort its tables both ways. Where it has a film, the player must
draw, Play must play and stop, and the slider lead to its times. With --png it leaves screenshots of a desk and a phone, light and dark. Needs no Python package."""

import argparse
import base64
import json
import os
import shutil
import socket
import struct
import subprocess
import sys
import tempfile
import time
import urllib.request

FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
         "--disable-component-update", "--disable-sync", "--remote-debugging-port=0"]
# Resolved when the page is ready; a film takes a moment to unpack.
READY = """new Promise((done) => { const look = () => {
  const film = document.querySelector('canvas.flow');
  !film || document.documentElement.dataset.player ? done(film ? 'film' : 'none') : setTimeout(look, 50); }; look(); })"""
# How many pixels are drawn, and a sum that differs between pictures.
PIXELS = """(() => { const c = document.querySelector('canvas.flow');
  const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
  let drawn = 0, sum = 0;
  for (let k = 0; k < d.length; k += 4) if (d[k + 3]) { drawn++; sum = (sum * 31 + k + d[k] + 7 * d[k + 1]) % 1000000007; }
  return [drawn, sum]; })()"""
# Presses Play and waits for another instant; the picture must follow.
PLAY = """new Promise((done) => { const time = document.querySelector('.controls output'), before = time.textContent;
  const play = document.querySelector('.controls button'), began = performance.now();
  play.click();
  const look = () => {
    const moved = time.textContent !== before;
    if (!moved && performance.now() - began < 20000) return setTimeout(look, 50);
    const label = play.textContent;
    play.click();
    done([moved, label, play.textContent, before, time.textContent]);
  };
  look(); })"""
# Pulls the slider to each of its ends; answers the times shown there.
SCRUB = """(() => { const s = document.querySelector('input[type=range]'), time = document.querySelector('.controls output');
  return [s.max, '0'].map((v) => { s.value = v; s.dispatchEvent(new Event('input')); return time.textContent; }); })()"""
# Clicks a heading of each table twice; answers which tables are in neither order.
SORT = """(() => [...document.querySelectorAll('.scroll table')].filter((t) => t.tBodies[0].rows.length > 1).map((table, k) => {
  const column = [...table.tHead.rows[0].cells].findIndex((c, j) => new Set([...table.tBodies[0].rows].map((r) => r.cells[j].textContent)).size > 1);
  if (column < 0) return [k, true];
  const head = table.tHead.rows[0].cells[column], cells = () => [...table.tBodies[0].rows].map((r) => r.cells[column].textContent);
  const before = cells();
  head.querySelector('button').click();
  const up = cells(), upward = head.getAttribute('aria-sort');
  head.querySelector('button').click();
  const down = cells(), downward = head.getAttribute('aria-sort');
  const same = (a, b) => JSON.stringify([...a].sort()) === JSON.stringify([...b].sort());
  return [k, upward === 'ascending' && downward === 'descending' && up[0] !== down[0] && same(before, up) && same(up, down)];
}))()"""
LAST = """(() => { const s = document.querySelector('input[type=range]'); s.value = s.max;
  s.dispatchEvent(new Event('input')); })()"""


class Browser:
    """A Chromium and one of its pages, over the DevTools protocol."""

    def __init__(self, program, profile):
        self.process = subprocess.Popen([program, *FLAGS, f"--user-data-dir={profile}", "about:blank"],
                                        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        port_file = os.path.join(profile, "DevToolsActivePort")
        for _ in range(300):
            if os.path.exists(port_file) and open(port_file).read().count("\n"):
                break
            time.sleep(0.1)
        port = int(open(port_file).readline())
        pages = json.load(urllib.request.urlopen(f"http://127.0.0.1:{port}/json"))
        address = next(page["webSocketDebuggerUrl"] for page in pages if page["type"] == "page")
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=60)
        self.socket.sendall((f"GET {address[address.index('/devtools'):]} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n"
                             "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
                             "Sec-WebSocket-Key: c3BocGV0c2MgcGFnZSAxNg==\r\n\r\n").encode())
        self.stream = self.socket.makefile("rb")
        while self.stream.readline().strip():
            pass
        self.number, self.problems, self.loaded = 0, [], False

    def call(self, method, **params):
        self.number += 1
        text = json.dumps({"id": self.number, "method": method, "params": params}).encode()
        # A frame of text, masked with zeros.
        self.socket.sendall(b"\x81\xff" + struct.pack(">Q", len(text)) + bytes(4) + text)
        while True:
            answer = self.receive()
            if answer.get("id") == self.number:
                return answer.get("result", answer)

    def receive(self):
        text, last = b"", False
        while not last:
            first, length = self.stream.read(2)
            last = bool(first & 0x80)
            if length == 126:
                length, = struct.unpack(">H", self.stream.read(2))
            elif length == 127:
                length, = struct.unpack(">Q", self.stream.read(8))
            text += self.stream.read(length)
        message = json.loads(text)
        method, params = message.get("method", ""), message.get("params", {})
        if method == "Runtime.exceptionThrown":
            self.problems.append(params["exceptionDetails"].get("exception", {}).get("description", "exception"))
        if method == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.problems.append(params["entry"]["text"])
        self.loaded |= method == "Page.loadEventFired"
        return message

    def run(self, script):
        result = self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        return result.get("result", {}).get("value")

    def open(self, path, width, height, scheme):
        phone = width < 500
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=2 if phone else 1, mobile=phone)
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        self.loaded = False
        self.call("Page.navigate", url="file://" + os.path.abspath(path))
        while not self.loaded:
            self.receive()
        return self.run(READY)


def check(browser, args):
    for domain in ("Page", "Runtime", "Log"):
        browser.call(domain + ".enable")
    film = browser.open(args.page, 1280, 900, "light")
    problems = []
    if film == "film":
        first = browser.run(PIXELS)
        browser.run(LAST)
        last = browser.run(PIXELS)
        print(f"player: {first[0]} pixels drawn at first, {last[0]} at the end")
        if not (first[0] > 100 and last[0] > 100):
            problems.append("the player draws nothing")
        if first == last:
            problems.append("the first and the last time look the same")
        moved, playing, paused, before, after = browser.run(PLAY)
        print(f"played: from {before} to {after}")
        if not (moved and playing == "Pause" and paused == "Play"):
            problems.append("Play does not play, or does not stop")
        end, start = browser.run(SCRUB)
        print(f"scrubbed: {end}, then {start}")
        if end == start or browser.run(PIXELS) != first:
            problems.append("the slider does not lead to its times")
    tables = browser.run(SORT)
    print(f"sorted: {sum(good for _, good in tables)} of {len(tables)} tables")
    problems += [f"table {k} does not sort" for k, good in tables if not good]
    plots, drawn = browser.run("[document.querySelectorAll('.plot').length, document.querySelectorAll('.plot canvas').length]")
    wide = browser.run("document.documentElement.scrollWidth - innerWidth")
    print(f"plots: {drawn} of {plots}")
    if plots != drawn:
        problems.append("plots are missing")
    for (width, height) in ((1280, 900), (390, 844)):
        for scheme in ("light", "dark"):
            browser.open(args.page, width, height, scheme)
            browser.run(LAST + ", new Promise((r) => setTimeout(r, 300))" if film == "film" else "0")
            wide = browser.run("document.documentElement.scrollWidth - innerWidth")
            if wide > 0:
                problems.append(f"at {width} pixels the page is {wide} too wide")
            if args.png:
                image = browser.call("Page.captureScreenshot", captureBeyondViewport=True,
                                     clip={"x": 0, "y": 0, "width": width, "height": min(6000, browser.run("document.body.scrollHeight")), "scale": 1})
                with open(os.path.join(args.png, f"{width}-{scheme}.png"), "wb") as file:
                    file.write(base64.b64decode(image["data"]))
    return problems + browser.problems


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("page")
    parser.add_argument("--png", metavar="DIR")
    args = parser.parse_args()
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if not program:
        sys.exit("no Chromium (Debian package chromium)")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        browser = Browser(program, profile)
        try:
            problems = check(browser, args)
        finally:
            browser.process.terminate()
            browser.process.wait()
    for problem in problems:
        print("wrong:", problem)
    sys.exit(1 if problems else 0)


main()
