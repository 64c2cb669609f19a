"""The preview in tev, against a stub that reads the protocol byte by byte as tev's own reader does (Ipc.h, Ipc.cpp)."""

import socket
import struct
import threading

import numpy as np
import pytest

from isonoise.errors import UserError
from isonoise.film.output import image_layers
from isonoise.live.tev import TevViewer, close_packet, create_packet, update_packet, update_packets
from isonoise.loop import RenderLoop
from isonoise.renderer import Renderer
from isonoise.stops import Stops


class Reader:
    """Reads the payload of a packet, as `IpcPacket::IStream`."""

    def __init__(self, packet: bytes):
        self.data, self.index = packet, 0
        assert self.number("<I") == len(packet)

    def number(self, form: str) -> int:
        (value,) = struct.unpack_from(form, self.data, self.index)
        self.index += struct.calcsize(form)
        return value

    def text(self) -> str:
        end = self.data.index(b"\0", self.index)
        begin, self.index = self.index, end + 1
        return self.data[begin:end].decode()

    def channels(self, number: int) -> list[str]:
        return [self.text() for _ in range(number)]


class StubTev:
    """Listens as tev does, and keeps the images that it is sent."""

    def __init__(self, packets: int | None = None):
        self.server = socket.create_server(("127.0.0.1", 0))
        self.address = self.server.getsockname()
        self.images: dict[str, dict[str, np.ndarray]] = {}
        self.kinds: list[int] = []
        self._left = packets  # after so many it closes the connection
        self.thread = threading.Thread(target=self._serve, daemon=True)
        self.thread.start()

    def _serve(self) -> None:
        connection, _ = self.server.accept()
        with connection, connection.makefile("rb") as stream:
            while (head := stream.read(4)) and self._left != 0:
                (length,) = struct.unpack("<I", head)
                self.read(head + stream.read(length - 4))
                self._left = self._left and self._left - 1

    def read(self, packet: bytes) -> None:
        reader = Reader(packet)
        kind = reader.number("<B")
        self.kinds.append(kind)
        if kind == 2:
            self.images.pop(reader.text(), None)
        elif kind == 4:
            self._create(reader)
        elif kind == 6:
            self._update(reader)
        else:
            raise AssertionError(f"unknown packet {kind}")

    def _create(self, reader: Reader) -> None:
        assert reader.number("<B") in (0, 1)
        name, width, height = reader.text(), reader.number("<i"), reader.number("<i")
        names = reader.channels(reader.number("<i"))
        assert reader.index == len(reader.data)
        self.images[name] = {channel: np.zeros((height, width), np.float32) for channel in names}

    def _update(self, reader: Reader) -> None:
        assert reader.number("<B") in (0, 1)
        image = self.images[reader.text()]
        names = reader.channels(reader.number("<i"))
        x, y, width, height = (reader.number("<i") for _ in range(4))
        offsets = [reader.number("<q") for _ in names]
        strides = [reader.number("<q") for _ in names]
        values = np.frombuffer(reader.data, "<f4", offset=reader.index)
        pixels = width * height
        ends = (offset + (pixels - 1) * stride + 1 for offset, stride in zip(offsets, strides, strict=True))
        assert len(values) == max(ends)
        for name, offset, stride in zip(names, offsets, strides, strict=True):
            plane = values[offset : offset + (pixels - 1) * stride + 1 : stride].reshape(height, width)
            image[name][y : y + height, x : x + width] = plane

    def finish(self) -> None:
        self.thread.join(10)
        assert not self.thread.is_alive()


def test_packets_byte_by_byte():
    """Written down by hand from the description of the protocol."""
    assert close_packet("a") == bytes.fromhex("07000000 02 6100")
    assert create_packet("é", (3, 2), ["R", "Z"]) == bytes.fromhex(
        "19000000 04 01 c3a900 03000000 02000000 02000000 5200 5a00"
    )
    assert update_packet("a", {"R": np.array([[1.0, 2.0]])}, y=5) == bytes.fromhex(
        "36000000 06 00 6100 01000000 5200 00000000 05000000 02000000 01000000"
        "0000000000000000 0100000000000000 0000803f 00000040"
    )


@pytest.mark.parametrize(("shape", "packets"), [((4, 3), 1), ((700, 256), 2), ((3, 300_000), 3)])
def test_strips_make_up_the_image(shape, packets):
    plane = np.random.default_rng(1).random(shape, np.float32)
    stub = StubTev()
    stub.read(create_packet("a", shape[::-1], ["R", "samples"]))
    sent = list(update_packets("a", {"R": plane, "samples": (1000 * plane).astype(np.uint32)}))
    assert len(sent) == packets
    for packet in sent:
        stub.read(packet)
    np.testing.assert_array_equal(stub.images["a"]["R"], plane)
    np.testing.assert_array_equal(stub.images["a"]["samples"], np.floor(1000 * plane))


def test_a_render_is_shown_while_it_runs_and_at_its_end(monkeypatch):
    monkeypatch.setattr("isonoise.live.tev.INTERVAL_S", 0.0)
    monkeypatch.setattr("isonoise.live.tev.MAX_SHARE", 1e9)
    stub = StubTev()
    viewer = TevViewer("cornell", stub.address)
    loop = RenderLoop(Renderer("cornell", size=(8, 6)), Stops(spp=16), periodic=[viewer.periodic()])
    outcome = loop.run()
    viewer.show(outcome)
    viewer.close()
    stub.finish()
    assert stub.kinds[:3] == [2, 4, 6]
    assert stub.kinds.count(6) > 1
    layers = image_layers(outcome.statistics, outcome.floor)
    shown = stub.images["cornell"]
    assert list(shown) == ["R", "G", "B", "samples", "error"]
    np.testing.assert_array_equal(np.stack([shown[name] for name in "RGB"], axis=-1), layers[""])
    np.testing.assert_array_equal(shown["samples"], layers["samples"])
    np.testing.assert_array_equal(shown["error"], layers["error"])


def test_a_closed_viewer_ends_the_preview_and_not_the_render(monkeypatch, capsys):
    monkeypatch.setattr("isonoise.live.tev.INTERVAL_S", 0.0)
    monkeypatch.setattr("isonoise.live.tev.MAX_SHARE", 1e9)
    stub = StubTev(packets=3)
    viewer = TevViewer("cornell", stub.address)
    loop = RenderLoop(Renderer("cornell", size=(8, 6)), Stops(spp=256), periodic=[viewer.periodic()])
    outcome = loop.run()
    assert outcome.statistics.samples == 256 * 48
    assert capsys.readouterr().err.count("tev no longer shows the render") <= 1


def test_without_a_viewer():
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = server.getsockname()
    with pytest.raises(UserError, match=r"no tev listens at 127\.0\.0\.1:\d+ .*start tev first"):
        TevViewer("cornell", address)
