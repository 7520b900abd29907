"""The server of pages: who is answered, with what, and what stays hidden."""

import http.client
import socket
import sys
import threading

import pytest

from surface_gym.web.build import PAGE
from surface_gym.web.server import Server


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    folder = tmp_path_factory.mktemp("outer") / "site"
    (folder / "deeper").mkdir(parents=True)
    for name, content in {
        "sort.wasm": b"\0asm", "sort.json": b"{}", "sort.starts": b"s", "deeper/a.js": b"a",
        "playground.js": b"not this one", "../secret.json": b"s",
    }.items():  # fmt: skip
        (folder / name).write_bytes(content)
    (folder / "link.json").symlink_to(folder.parent / "secret.json")
    with Server([PAGE, folder]) as made:
        threading.Thread(target=made.serve_forever, daemon=True).start()
        yield made
        made.shutdown()


def ask(server, path, method="GET", host=None):
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=20)
    connection.putrequest(method, path, skip_host=True)
    connection.putheader("If-Modified-Since", "Fri, 31 Dec 2100 00:00:00 GMT")
    if host != "":
        connection.putheader("Host", host or f"127.0.0.1:{server.server_port}")
    connection.endheaders()
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer, content


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("playground.html", "text/html; charset=utf-8"),
        ("playground.js", "text/javascript; charset=utf-8"),
        ("playground.css", "text/css; charset=utf-8"),
        ("sort.wasm", "application/wasm"),
        ("sort.json", "application/json"),
        ("sort.starts", "application/octet-stream"),
        ("deeper/a.js", "text/javascript; charset=utf-8"),
        ("sort%2ejson?again=1", "application/json"),
    ],
)
def test_a_file_has_its_type_and_is_of_the_first_folder(server, name, kind):
    answer, content = ask(server, f"/{name}")
    assert (answer.status, answer.headers["Content-Type"]) == (200, kind)
    assert answer.headers["X-Content-Type-Options"] == "nosniff"
    assert "frame-ancestors 'self'" in answer.headers["Content-Security-Policy"]
    assert int(answer.headers["Content-Length"]) == len(content) > 0
    if name.startswith("playground"):
        assert content == (PAGE / name).read_bytes()
    ahead, nothing = ask(server, f"/{name}", "HEAD")
    assert (ahead.status, nothing) == (200, b"")
    assert ahead.headers["Content-Length"] == answer.headers["Content-Length"]


def test_the_address_leads_to_the_first_page(server):
    assert server.address == f"http://127.0.0.1:{server.server_port}/"
    answer, _ = ask(server, "/")
    assert (answer.status, answer.headers["Location"]) == (302, "/playground.html")


@pytest.mark.parametrize(
    "path",
    [
        "/nothing", "/deeper", "/deeper/", "/.", "/../secret.json", "/%2e%2e/secret.json",
        "/deeper/../../secret.json", "/..%2fsecret.json", "/..%5csecret.json", "/link.json",
        "//etc/passwd", "/%2fetc/passwd", "/%00", f"/{'a' * 5000}", "http://[/sort.json", "*",
    ],
)  # fmt: skip
def test_no_folder_is_listed_and_nothing_outside_is_read(server, path):
    answer, content = ask(server, path)
    assert answer.status == 404
    assert b"secret" not in content.replace(path.encode(), b"")


def test_a_file_may_be_written_as_it_is_asked_for(tmp_path):
    with Server([tmp_path], prepare=lambda name: (tmp_path / "late.json").write_text(name)) as made:
        threading.Thread(target=made.serve_forever, daemon=True).start()
        assert ask(made, "/late.json?again=1")[1] == b"late.json"
        made.shutdown()


@pytest.mark.parametrize("host", ["localhost", "localhost:8642", "127.0.0.1", "LOCALHOST:1"])
def test_this_machine_is_answered(server, host):
    assert ask(server, "/sort.json", host=host)[0].status == 200


@pytest.mark.parametrize(
    "host",
    [
        "", "evil.example", "evil.example:8642", "127.0.0.1.evil.example", "[", "0.0.0.0",
        "evil@127.0.0.1", "127.0.0.1#evil", "127.0.0.1:80x",
    ],
)  # fmt: skip
def test_a_host_that_was_made_to_mean_this_machine_gets_nothing(server, host):
    answer, content = ask(server, "/sort.json", host=host)
    assert answer.status == 403
    assert "script-src 'self'" in answer.headers["Content-Security-Policy"]
    assert b"{}" not in content


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS"])
def test_nothing_is_written(server, method):
    assert ask(server, "/sort.json", method)[0].status == 501


@pytest.mark.skipif(sys.platform != "linux", reason="others have no 127.0.0.2")
def test_it_listens_on_this_machine_alone(server):
    assert server.socket.getsockname()[0] == "127.0.0.1"
    with socket.create_server(("127.0.0.2", server.server_port)):  # which others may use
        pass


def test_a_browser_that_leaves_is_no_error(server, capfd):
    with socket.create_connection(("127.0.0.1", server.server_port)) as left:
        left.sendall(b"GET /playground.js HTTP/1.1\r\nHost: localhost\r\n")
    assert ask(server, "/sort.json")[0].status == 200
    assert capfd.readouterr().err == ""


def test_of_too_many_connections_the_oldest_is_closed(tmp_path, monkeypatch):
    monkeypatch.setattr("surface_gym.web.server.CONNECTIONS", 2)
    (tmp_path / "sort.json").write_text("{}")
    with Server([tmp_path]) as made:
        threading.Thread(target=made.serve_forever, daemon=True).start()
        address = ("127.0.0.1", made.server_port)
        slow = [socket.create_connection(address, timeout=20) for _ in range(5)]
        for each in slow[:3]:
            assert each.recv(1) == b""
        assert ask(made, "/sort.json")[0].status == 200
        for each in slow:
            each.close()
        made.shutdown()


def test_a_request_of_two_hosts_gets_nothing(server):
    with socket.create_connection(("127.0.0.1", server.server_port), timeout=20) as asking:
        asking.sendall(b"GET /sort.json HTTP/1.1\r\nHost: localhost\r\nHost: evil\r\n\r\n")
        assert asking.recv(100).startswith(b"HTTP/1.1 403 ")
