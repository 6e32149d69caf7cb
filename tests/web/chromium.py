"""Headless Chromium, driven by its own DevTools protocol. Nothing is downloaded: the system's browser."""

import asyncio
import contextlib
import json
import shutil
import subprocess
import tempfile
import urllib.request

from websockets.asyncio.client import connect

NAMES = ["chromium", "chromium-browser", "google-chrome", "chrome"]
PATIENCE_S = 60


class Page:
    """One tab."""

    def __init__(self, socket):
        self.socket = socket
        self.next = 0
        self.answers = {}
        self.events = []
        self.errors = []
        self.reader = asyncio.create_task(self._read())

    async def _read(self):
        async for text in self.socket:
            message = json.loads(text)
            if "id" in message:
                self.answers.pop(message["id"]).set_result(message)
                continue
            self.events.append(message)
            if message["method"] == "Runtime.exceptionThrown":
                self.errors.append(json.dumps(message["params"]["exceptionDetails"])[:500])

    async def call(self, method, **params):
        self.next += 1
        answer = self.answers[self.next] = asyncio.get_running_loop().create_future()
        await self.socket.send(json.dumps({"id": self.next, "method": method, "params": params}))
        message = await asyncio.wait_for(answer, PATIENCE_S)
        assert "error" not in message, f"{method}: {message.get('error')}"
        return message["result"]

    async def run(self, script):
        """The value of a JavaScript expression; promises are waited for."""
        result = await self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in result, f"{script[:200]}: {json.dumps(result['exceptionDetails'])[:800]}"
        return result["result"].get("value")

    async def until(self, script, what):
        for _ in range(PATIENCE_S * 10):
            value = await self.run(script)
            if value:
                return value
            await asyncio.sleep(0.1)
        raise AssertionError(f"{what}: not within {PATIENCE_S} s")

    async def press(self, key, code, number, text=None):
        common = {"key": key, "code": code, "windowsVirtualKeyCode": number}
        down = {"text": text} if text else {}
        await self.call("Input.dispatchKeyEvent", type="keyDown" if text else "rawKeyDown", **common, **down)
        await self.call("Input.dispatchKeyEvent", type="keyUp", **common)

    async def click(self, element):
        box = await self.run(
            f"(r => [r.x + r.width / 2, r.y + r.height / 2])(document.querySelector('{element}').getBoundingClientRect())")
        for kind in ["mousePressed", "mouseReleased"]:
            await self.call("Input.dispatchMouseEvent", type=kind, x=box[0], y=box[1], button="left", clickCount=1)

    async def media(self, **features):
        named = [{"name": name.replace("_", "-"), "value": value} for name, value in features.items()]
        await self.call("Emulation.setEmulatedMedia", features=named)

    async def size(self, width, height):
        await self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1,
                        mobile=False)


@contextlib.asynccontextmanager
async def chromium():
    """A browser with one empty tab. `evil.example` leads to this machine, as DNS rebinding would have it."""
    program = next((path for name in NAMES if (path := shutil.which(name))), None)
    assert program, "no Chromium: apt-get install chromium"
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        process = subprocess.Popen(
            [program, "--headless=new", "--no-sandbox", "--disable-gpu-sandbox", "--remote-debugging-port=0",
             f"--user-data-dir={folder}", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
             "--hide-scrollbars", "--disable-background-networking", "--disable-component-update",
             "--disable-extensions", "--no-first-run", "--host-resolver-rules=MAP evil.example 127.0.0.1",
             "about:blank"],
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        try:
            port = None
            for line in process.stderr:
                if "DevTools listening on" in line:
                    port = line.split("127.0.0.1:")[1].split("/")[0]
                    break
            assert port, "Chromium did not start"
            # Nobody reads its complaints; a full pipe would stop it.
            drain = asyncio.get_running_loop().run_in_executor(None, process.stderr.read)
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/json") as answer:
                target = next(t for t in json.load(answer) if t["type"] == "page")
            async with connect(target["webSocketDebuggerUrl"], max_size=None, ping_interval=None) as socket:
                page = Page(socket)
                await page.call("Runtime.enable")
                await page.call("Page.enable")
                yield page
        finally:
            process.kill()
            process.wait()
        await drain
