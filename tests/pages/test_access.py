"""Who may see the pages: the token, the names of the server, where a request comes from."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from hilbench.apps.pages.access import Access
from hilbench.apps.pages.runs import routes
from hilbench.apps.pages.server import site

PORT = 8321
HERE = f"http://127.0.0.1:{PORT}"


@pytest.fixture
def access() -> Access:
    return Access("127.0.0.1", PORT)


@pytest.fixture
def stranger(access: Access, tmp_path: Path) -> Iterator[TestClient]:
    (tmp_path / "runs").mkdir()
    with TestClient(site(access, routes(tmp_path / "runs")), base_url=HERE, follow_redirects=False) as client:
        yield client


@pytest.fixture
def known(access: Access, stranger: TestClient) -> TestClient:
    answer = stranger.post("/session", headers={"Authorization": f"Bearer {access.token}", "Origin": HERE})
    assert answer.status_code == 204
    return stranger


def test_who_has_the_token_sees_the_runs(known: TestClient) -> None:
    assert known.get("/session").status_code == 204
    assert known.get("/runs").status_code == 200


def test_the_cookie_is_not_the_token_and_is_for_this_server_alone(access: Access, stranger: TestClient) -> None:
    answer = stranger.post("/session", headers={"Authorization": f"Bearer {access.token}", "Origin": HERE})
    cookie = answer.headers["set-cookie"].lower()
    assert access.token.lower() not in cookie
    assert "httponly" in cookie
    assert "samesite=strict" in cookie


@pytest.mark.parametrize("path", ["/runs", "/runs/any", "/runs/any/report", "/static/../runs", "/anything"])
def test_a_stranger_sees_nothing(stranger: TestClient, path: str) -> None:
    answer = stranger.get(path)
    assert answer.status_code == 401
    assert "terminal" in answer.text


def test_the_page_that_everybody_gets_says_nothing_of_the_bench(stranger: TestClient, tmp_path: Path) -> None:
    assert str(tmp_path) not in stranger.get("/").text
    assert stranger.get("/session").status_code == 401


@pytest.mark.parametrize("given", ["", "Bearer ", "Bearer wrong", "Bearer \u00e4"])
def test_a_wrong_token_opens_nothing(stranger: TestClient, given: str) -> None:
    answer = stranger.post("/session", headers={"Authorization": given.encode(), "Origin": HERE})
    assert answer.status_code == 401
    assert "set-cookie" not in answer.headers


@pytest.mark.parametrize(
    "host",
    [
        "evil.example",
        f"evil.example:{PORT}",
        "127.0.0.1:80",
        f"127.0.0.1.evil.example:{PORT}",
        "127.0.0.1:" + "8" * 5000,
    ],
)
def test_a_name_that_another_site_points_here_is_refused(known: TestClient, host: str) -> None:
    assert known.get("/runs", headers={"Host": host}).status_code == 403
    assert known.get("/", headers={"Host": host}).status_code == 403


@pytest.mark.parametrize("host", [f"localhost:{PORT}", f"192.0.2.7:{PORT}", f"[::1]:{PORT}"])
def test_addresses_and_this_machine_are_names_of_the_server(known: TestClient, host: str) -> None:
    assert known.get("/", headers={"Host": host}).status_code == 200


@pytest.mark.parametrize(
    "headers",
    [{}, {"Origin": "http://evil.example"}, {"Origin": "null"}, {"Origin": f"https://127.0.0.1:{PORT}"}],
)
def test_another_site_can_not_use_the_session(access: Access, known: TestClient, headers: dict[str, str]) -> None:
    given = {"Authorization": f"Bearer {access.token}", **headers}
    assert known.post("/session", headers=given).status_code == 403
    socket = known.websocket_connect(f"ws{HERE[4:]}/live", headers=headers)
    with pytest.raises(WebSocketDisconnect) as refused, socket:
        pass
    assert "another site" in refused.value.reason


def test_another_site_can_not_read_with_it(known: TestClient) -> None:
    assert known.get("/runs", headers={"Sec-Fetch-Site": "cross-site"}).status_code == 403
    assert known.get("/runs", headers={"Origin": "http://evil.example"}).status_code == 403


def test_a_body_has_a_size(access: Access, known: TestClient) -> None:
    headers = {"Authorization": f"Bearer {access.token}", "Origin": HERE}
    assert known.post("/session", headers=headers, content=b"x" * 10_000).status_code == 413
    assert known.post("/session", headers=headers, content=iter([b"x"])).status_code == 413
    assert known.post("/session", headers={**headers, "Content-Length": "1" * 5000}).status_code == 413


@pytest.mark.parametrize(
    "path",
    ["/static/", "/static/..%2faccess.py", "/static/%2e%2e/access.py", "/static/live.js.map", "/runs/..%2f..%2fetc"],
)
def test_there_is_no_listing_and_no_way_out_of_the_folders(known: TestClient, path: str) -> None:
    assert known.get(path).status_code == 404


def test_a_browser_is_told_to_be_strict(known: TestClient) -> None:
    for path in ("/", "/session", "/static/live.css", "/nothing"):
        headers = known.get(path).headers
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert "frame-ancestors 'none'" in policy
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["cache-control"] == "no-store"


def test_the_page_holds_no_script_and_no_style_of_its_own(known: TestClient) -> None:
    text = known.get("/").text
    assert "<style" not in text
    assert " style=" not in text
    assert "onclick" not in text
    assert text.count("<script") == text.count("<script defer src=")


def test_sessions_are_bounded_and_the_oldest_goes(access: Access) -> None:
    first = access.open_session(access.token)
    assert first is not None
    for _ in range(300):
        access.open_session(access.token)
    assert not access.knows(first)
