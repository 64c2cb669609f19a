"""Renders with a live page, and a client of it by the standard library, which has an HTTP implementation of its own."""

import http.client
import json
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from urllib.parse import urlsplit

import numpy as np
from small_scene import lamp_over_floor

from isonoise.live.live_page import LivePage
from isonoise.loop import RenderLoop
from isonoise.renderer import Renderer

TIMEOUT_S = 30


class LiveClient:
    """Sends requests to the page at `url`."""

    def __init__(self, url: str):
        parts = urlsplit(url)
        self.url, self.host, self.port, self.path = url, parts.hostname, parts.port, parts.path

    def request(self, method: str, path: str, headers=()) -> tuple[int, dict[str, str], bytes]:
        """Status, headers and body of the answer. A `path` that begins with / is not below the token."""
        connection = http.client.HTTPConnection(self.host, self.port, timeout=TIMEOUT_S)
        try:
            connection.request(method, path if path.startswith("/") else self.path + path, headers=dict(headers))
            response = connection.getresponse()
            return response.status, dict(response.headers), response.read()
        finally:
            connection.close()

    def layer(self, name: str, after: int = -1, reduction: int = 1) -> tuple[dict, np.ndarray] | None:
        """Facts and values (channels, height, width) of the next picture; None if there is none."""
        status, _, body = self.request("GET", f"layers/{name}?after={after}&reduction={reduction}")
        if status == 204:
            return None
        assert status == 200, body
        return decode(body)

    def follow(self, name: str, reduction: int = 1) -> tuple[dict, np.ndarray] | None:
        """Take the pictures of a layer until the render ends; return the last one."""
        last = None
        while (picture := self.layer(name, -1 if last is None else last[0]["version"], reduction)) is not None:
            last = picture
        return last

    @contextmanager
    def events(self) -> Iterator[Iterator[tuple[str, object]]]:
        """Yields the events, (name, value), as they come."""
        connection = http.client.HTTPConnection(self.host, self.port, timeout=TIMEOUT_S)
        try:
            connection.request("GET", self.path + "events")
            response = connection.getresponse()
            assert (response.status, response.headers["Content-Type"]) == (200, "text/event-stream")
            yield _events(response)
        finally:
            connection.close()


def decode(body: bytes) -> tuple[dict, np.ndarray]:
    """Facts and values of a picture, as the server describes the format."""
    length = int.from_bytes(body[:4], "little")
    assert length % 4 == 0
    facts = json.loads(body[4 : 4 + length])
    shape = facts["channels"], facts["height"], facts["width"]
    return facts, np.frombuffer(body, "<f2", offset=4 + length).reshape(shape).astype(float) * facts["unit"]


def _events(response) -> Iterator[tuple[str, object]]:
    name = None
    while line := response.readline().decode().rstrip("\n"):
        name = line.removeprefix("event: ")
        value = json.loads(response.readline().decode().removeprefix("data: "))
        assert response.readline() == b"\n"
        yield name, value


@contextmanager
def in_thread(function) -> Iterator[list]:
    """Calls `function` in a thread, which ends with the block; yields a list that gets its result."""
    results = []
    thread = threading.Thread(target=lambda: results.append(function()), daemon=True)
    thread.start()
    yield results
    thread.join(TIMEOUT_S)
    assert results, "it did not return"


@contextmanager
def running_render(stops, save=None, strategy="uniform:growth=0.2", scene=None, size=None):
    """A render in another thread with a page: its client, its loop, and a list that gets the outcome."""
    scene = scene or lamp_over_floor()
    with LivePage("lamp", save=save) as page, Renderer(scene, strategy=strategy, size=size) as renderer:
        loop = RenderLoop(renderer, stops, periodic=[page.periodic()])
        client = LiveClient(page.url)

        def run():
            outcome = loop.run()
            page.show(outcome)
            return outcome

        with in_thread(run) as outcomes:
            yield client, loop, outcomes
            loop.stop()


def wait_for(condition, seconds=20):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)
