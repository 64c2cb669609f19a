"""The live page over HTTP: who may see it, what it shows and what its buttons do."""

import json
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from live_client import LiveClient, running_render, wait_for
from small_scene import HEIGHT, PIXELS, WIDTH, assert_same_bits, lamp_over_floor

from isonoise.cli import main
from isonoise.errors import UserError
from isonoise.live.budget import OVERDRAFT_S, RESERVE_S, SHARE, Budget
from isonoise.live.live_page import LivePage
from isonoise.loop import render_loop
from isonoise.renderer import Renderer
from isonoise.stops import Stops

NOTHING_LEFT = {"remaining_s": None, "wave_kind": None}
"""What the last status says of the render."""


def status_of(client):
    with client.events() as events:
        return next(value for name, value in events if name == "status")


@pytest.fixture(scope="module")
def idle_page():
    with LivePage("a scene") as page:
        yield page


@pytest.mark.parametrize(
    ("path", "headers"),
    [
        ("/", {}),
        ("/events", {}),
        ("/x/", {}),
        ("/../", {}),
        ("", {"Host": "evil.example"}),
        ("", {"Host": "evil.example:80"}),
        ("", {"Host": ""}),
        ("", {"Origin": "http://evil.example"}),
        ("", {"Origin": "null"}),
        ("events", {"Origin": "https://127.0.0.1"}),
        ("page.js", {"Host": "127.0.0.1.evil.example"}),
    ],
)
@pytest.mark.parametrize("method", ["GET", "POST"])
def test_others_are_refused(idle_page, method, path, headers):
    client = LiveClient(idle_page.url)
    status, answer, body = client.request(method, path, headers)
    assert status == 403
    assert client.path.strip("/").encode() not in body
    assert "Set-Cookie" not in answer


def test_the_token_is_long_and_new_for_every_page(idle_page):
    token = LiveClient(idle_page.url).path.strip("/")
    assert len(token) >= 32
    with LivePage() as other:
        assert LiveClient(other.url).path.strip("/") != token


def test_it_listens_on_loopback_only(idle_page):
    port = LiveClient(idle_page.url).port
    addresses = {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), port, socket.AF_INET)}
    for address in addresses - {"127.0.0.1"}:
        if not address.startswith("127."):
            with socket.socket() as attempt:
                assert attempt.connect_ex((address, port)) != 0
    with socket.socket() as other:
        assert other.connect_ex(("127.0.0.2", port)) != 0


def test_files_of_the_page(idle_page):
    client = LiveClient(idle_page.url)
    status, headers, body = client.request("GET", "")
    assert status == 200
    assert headers["Content-Type"] == "text/html; charset=utf-8"
    assert headers["Cache-Control"] == "no-store"
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert b"http" not in body  # nothing from elsewhere
    own_origin = {"Origin": f"http://127.0.0.1:{client.port}"}
    for name, kind in [("page.js", "text/javascript"), ("viewer.js", "text/javascript"), ("page.css", "text/css")]:
        status, headers, _ = client.request("GET", name, own_origin)
        assert (status, headers["Content-Type"]) == (200, f"{kind}; charset=utf-8")
    for name in ("missing.js", "..%2fserver.py", "%2e%2e%2fserver.py", "layers/nothing", "page"):
        assert client.request("GET", name)[0] == 404
    for query in ("after=x", "reduction=0", "reduction=17", "reduction=-1"):
        assert client.request("GET", f"layers/image?{query}")[0] == 400
    assert client.request("POST", "explode")[0] == 404
    assert client.request("POST", "save")[0] == 404  # nothing could be saved
    assert status_of(client) == {"state": "setting up", "waves": 0}


def test_a_render_is_shown_paused_saved_and_stopped():
    saved = []

    def save(loop):
        saved.append(loop.renderer.samples)
        return ["a.exr"]

    with running_render(Stops(error=1e-6), save) as (client, loop, outcomes), client.events() as events:
        settings = next(value for name, value in events if name == "settings")
        assert (settings["width"], settings["height"], settings["error"]) == (WIDTH, HEIGHT, 1e-6)
        assert settings["can_save"]
        facts, _ = client.layer("image")
        assert (facts["width"], facts["height"]) == (WIDTH, HEIGHT)
        later, _ = client.layer("image", after=facts["version"])
        assert later["version"] > facts["version"]
        assert client.request("POST", "pause")[0] == 204
        wait_for(lambda: status_of(client)["state"] == "paused")
        samples, elapsed = loop.renderer.samples, status_of(client)["elapsed_s"]
        _, counts = client.layer("samples")
        assert counts.sum() == pytest.approx(samples, rel=2**-10)
        image, values = client.layer("image")
        assert image["version"] == samples
        np.testing.assert_allclose(values, loop.renderer.image().transpose(2, 0, 1), rtol=2**-10, atol=1e-6)
        client.request("POST", "save")
        wait_for(lambda: saved)
        assert next(value for name, value in events if name == "message") == "Saved a.exr."
        assert saved == [samples] == [loop.renderer.samples]
        assert status_of(client)["elapsed_s"] == elapsed  # the clock stands still
        client.request("POST", "resume")
        wait_for(lambda: loop.renderer.samples > samples)
        client.request("POST", "pause")
        wait_for(lambda: status_of(client)["state"] == "paused")
        client.request("POST", "stop")  # also from a pause
        wait_for(lambda: outcomes)
    assert outcomes[0].reason == "interrupted"
    assert outcomes[0].elapsed_s < time.monotonic()


def test_pages_get_the_last_picture_and_the_whole_log():
    with running_render(Stops(spp=256)) as (client, _, outcomes), client.events() as events:
        rows, statuses = [], []
        for name, value in events:
            if name == "rows":
                rows += value
            elif name == "status":
                statuses.append(value)
                if value["state"] == "ended":
                    break
    outcome = outcomes[0]
    assert [row["stated_p99"] for row in rows if row["stated_p99"]] == [
        row.stated_p99 for row in outcome.rows if np.isfinite(row.stated_p99)
    ]
    assert len(rows) == len(outcome.rows) == statuses[-1]["waves"]
    assert (statuses[-1]["reason"], statuses[-1]["samples"]) == ("spp", 256 * PIXELS)


def test_a_page_that_waits_gets_the_finished_image():
    with running_render(Stops(spp=64)) as (client, _, outcomes):
        facts, values = client.follow("image")
        _, counts = client.layer("samples")  # the other layers are there, too
    assert facts["version"] == 64 * PIXELS
    np.testing.assert_allclose(values, outcomes[0].rgb.transpose(2, 0, 1), rtol=2**-10, atol=1e-6)
    np.testing.assert_array_equal(counts[0], outcomes[0].statistics.count)


def test_pictures_change_no_bit_and_none_are_made_for_nobody(monkeypatch):
    without = render_loop(Renderer(lamp_over_floor()), Stops(spp=128)).statistics
    with running_render(Stops(spp=128), strategy="pooled") as (client, _, outcomes):
        assert client.follow("error", reduction=2)
        wait_for(lambda: outcomes)
    assert_same_bits(outcomes[0].statistics, without)
    monkeypatch.setattr("isonoise.live.live_page.Picture", lambda *_: pytest.fail("nobody looks"))
    with running_render(Stops(spp=128), strategy="pooled") as (client, _, outcomes):
        status_of(client)
        wait_for(lambda: outcomes)
    assert_same_bits(outcomes[0].statistics, without)


def test_a_page_that_stays_does_not_hold_up_the_end(capfd, monkeypatch):
    monkeypatch.setattr("isonoise.live.server.LINGER_S", 0.1)
    with LivePage() as page:
        client = LiveClient(page.url)
        with client.events() as events:
            assert next(events) == ("status", {"state": "setting up", "waves": 0})
            start = time.monotonic()
            page.close()
            assert time.monotonic() - start < 5
            assert list(events)[-1] == ("status", {"state": "ended", "waves": 0, "reason": "failed"} | NOTHING_LEFT)
    assert capfd.readouterr().err == ""


def test_a_port_in_use_is_an_error(idle_page, capsys, in_tmp_path):
    port = LiveClient(idle_page.url).port
    with pytest.raises(UserError, match=f"port {port} cannot be used"):
        LivePage(port=port)
    assert main(["render", "cornell", "-o", "a.png", "--serve", str(port)]) == 2
    assert f"port {port} cannot be used" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["render", "cornell", "-o", "a.png", "--serve", "99999"])
    assert "'99999' is not a port" in capsys.readouterr().err


def test_the_command_prints_the_address(capsys, in_tmp_path):
    assert main(["render", "cornell", "-o", "a.png", "--size", "8x6", "--spp", "4", "--serve", "--json"]) == 0
    captured = capsys.readouterr()
    url = json.loads(captured.out)["live_page"]
    assert f"isonoise: watch the render at {url}\n" in captured.err
    with pytest.raises(ConnectionRefusedError):  # it ends with the render
        LiveClient(url).request("GET", "")


def test_the_budget():
    now = [0.0]
    budget = Budget(lambda: now[0])
    assert budget.allows(0.0)
    budget.spend(RESERVE_S)
    assert budget.allows(0.0)
    assert not budget.allows(0.1)
    now[0] += 0.1 / SHARE
    assert budget.allows(0.0999)
    budget.spend(1.1)
    assert not budget.allows(0.0)
    assert not budget.allows(0.1, is_urgent=True)  # too many were
    now[0] += 0.2 / SHARE
    assert budget.allows(0.1, is_urgent=True)
    assert OVERDRAFT_S == 1.0
    now[0] += 1e6
    budget.spend(0)
    assert budget.allows(9.0)  # never more than the reserve has to be there
    budget.spend(RESERVE_S + 0.01)
    assert not budget.allows(0.0)


def test_pictures_take_about_a_hundredth_of_the_time():
    """A page that always waits, for a minute: less than 2 %, whatever a picture takes."""
    for seconds in (0.001, 0.05, 0.15, 0.4):
        now, spent = [0.0], 0.0
        budget = Budget(lambda now=now: now[0])
        while now[0] < 60:
            if budget.allows(seconds, is_urgent=spent == 0):
                budget.spend(seconds)
                spent += seconds
                now[0] += seconds
            now[0] += 0.003
        assert 0.4 * SHARE * 60 < spent < 0.02 * 60


@pytest.mark.long
@pytest.mark.parametrize("options", [(), ("--device", "0/2"), ("--save-every", "0.5", "--checkpoint", "a.npz")])
def test_ctrl_c_ends_a_watched_render(in_tmp_path, options):
    """Also one that is paused; its image is written, and nothing but the address is said."""
    command = ("render", "cornell", "-o", "a.exr", "--size", "64x48", "--time", "300", "--serve", *options)
    process = subprocess.Popen(
        [sys.executable, "-m", "isonoise", *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    client = LiveClient(process.stderr.readline().split()[-1])
    with client.events() as events:
        wait_for(lambda: next(value for name, value in events if name == "status")["state"] == "rendering", 100)
        assert client.layer("samples")
        client.request("POST", "pause")
        wait_for(lambda: status_of(client)["state"] == "paused")
        process.send_signal(signal.SIGINT)
        last = [value for name, value in events if name == "status"][-1]
    output, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (130, "")
    assert "by a signal" in output
    assert (last["state"], last["reason"]) == ("ended", "interrupted")
    assert Path("a.exr").is_file()


@pytest.mark.long
def test_a_watched_render_goes_on_from_a_checkpoint(in_tmp_path, capsys):
    first = ("render", "cornell", "-o", "a.exr", "--size", "16x12", "--serve", "--json")
    assert main([*first, "--spp", "40", "--checkpoint", "a.npz"]) == 0
    assert main([*first, "--spp", "80", "--resume", "a.npz"]) == 0
    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert result["samples"] == 80 * 16 * 12
