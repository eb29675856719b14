"""CLAIMS.md: what the first pages claim stands there, and is red where the last run does not show it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from tools.claims import CLAIMS, Claim, row


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: f"{claim.page}: {claim.text}")
def test_the_page_still_says_so(claim: Claim) -> None:
    assert claim.is_made()


def test_a_claim_is_red_without_a_run_and_where_the_newest_one_does_not_show_it(tmp_path: Path) -> None:
    claim = CLAIMS[0]
    assert not row(tmp_path, claim)[1]
    folder = tmp_path / f"{claim.config}-20260101-120000"
    folder.mkdir()
    for found, holds in ((0.128, True), (0.3, False)):
        result = {"began": "2026-01-01T12:00:00Z", "metrics": {claim.figure: found}, "provenance": None}
        (folder / "result.json").write_text(json.dumps(result))
        assert row(tmp_path, claim)[1] is holds
        assert ("🔴" in row(tmp_path, claim)[0]) is not holds
    assert not row(tmp_path, replace(claim, text="within 1 % at once"))[1]
