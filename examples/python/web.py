"""A small HTTP service with asyncio that runs beside a control loop, and a task that sends it requests."""

import asyncio
import json
import threading
import urllib.request
from dataclasses import dataclass

import dca
from image import Spot


@dca.message
@dataclass(slots=True)
class Address:
    port: int


@dca.service("Tells over HTTP where the spot is: GET / is an object of JSON.", every="50 ms")
class Web:
    In = dca.In(Spot)
    port = dca.parameter(int, (0, 65535), default=0)

    def __init__(self):
        # A state is also read before the service runs.
        self.spot: Spot | None = None
        self.asked = 0
        self.bound: int | None = None

    def init(self, value):
        # The loop of asyncio has a thread of its own. The data that both share is replaced as a whole, and never changed.
        threading.Thread(target=lambda: asyncio.run(self.serve()), daemon=True).start()

    def main_calc(self, tick):
        self.spot = self.In.fresh_within(tick.now, "500 ms")

    async def serve(self):
        server = await asyncio.start_server(self.answer, "127.0.0.1", self.port)
        self.bound = server.sockets[0].getsockname()[1]
        await server.serve_forever()

    async def answer(self, reader, writer):
        await reader.readuntil(b"\r\n\r\n")
        self.asked += 1
        spot = self.spot
        body = json.dumps(None if spot is None else {"x": spot.x, "y": spot.y}).encode()
        writer.write(b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: %d\r\n\r\n%s" % (len(body), body))
        await writer.drain()
        writer.close()

    @dca.state
    def address(self) -> Address:
        return Address(self.bound or 0)


@dca.task("Asks the service until it knows where the spot is.", every="50 ms")
class Browser:
    address = dca.Calls(None, Address)

    def init(self, value):
        self.call, self.page = self.address.call(within="2 s"), None

    def main_calc(self, tick):
        if self.page is not None and self.page.done:
            spot = self.page.result()
            if spot is not None:
                print(f"the spot is at {spot['x']:.0f}, {spot['y']:.0f}")
                return dca.done()
            self.call, self.page = self.address.call(within="2 s"), None
        elif self.page is None and self.call.done:
            url = f"http://127.0.0.1:{self.call.result().port}/"
            # A request may take long, and the loop does not wait for it.
            self.page = dca.offload(fetch, url)


def fetch(url: str):
    try:
        with urllib.request.urlopen(url, timeout=2) as answer:
            return json.load(answer)
    except OSError:
        return None


if __name__ == "__main__":
    dca.run(Web, Browser)
