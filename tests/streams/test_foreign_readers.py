"""What is streamed, opened by Foxglove's own libraries (npm's @mcap/core and @foxglove/ws-protocol)."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.streams.test_streams import SIGNALS, feed

from hilbench.apps.streams.sinks import groups_of, parse_target
from hilbench.apps.streams.stream import Stream
from hilbench.runs.config import load_with_overrides
from hilbench.topology.config import BenchConfig

READER = Path(__file__).parent / "readers" / "read.js"
PACKAGES = Path(__file__).resolve().parents[2] / ".cache" / "stream-readers" / "node_modules"
SHIPPED = Path(__file__).resolve().parents[2] / "bench_configs" / "web_section_step.yaml"
TOPICS = {f"/{group.name}" for group in groups_of(SIGNALS)}
CYCLES = 40
PATIENCE_S = 60.0

pytestmark = pytest.mark.skipif(shutil.which("npm") is None, reason="Node.js with npm is not installed")


@pytest.fixture(scope="module")
def bench() -> BenchConfig:
    return load_with_overrides(SHIPPED).config


def reader(*words: object) -> subprocess.Popen[str]:
    """The program on Foxglove's libraries; it finds them by NODE_PATH."""
    assert PACKAGES.exists(), "npm's readers are missing: make .cache/stream-readers/.installed"
    environment = {**os.environ, "NODE_PATH": str(PACKAGES)}
    words = ("node", READER, *words)
    return subprocess.Popen([str(word) for word in words], env=environment, stdout=subprocess.PIPE, text=True)


def assert_are_the_groups(channels: dict[str, Any]) -> None:
    assert set(channels) == TOPICS
    for group in groups_of(SIGNALS):
        told = channels[f"/{group.name}"]
        assert told["encoding"] == "json"
        assert told["schema"] == group.schema()


def test_mcap_s_own_reader_in_javascript_finds_every_message(bench: BenchConfig, tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    stream = Stream(parse_target(str(file)), bench, tmp_path)
    feed(stream, bench, CYCLES)
    stream.close()
    done = reader("mcap", file)
    out, _ = done.communicate(timeout=PATIENCE_S)
    assert done.returncode == 0
    channels: dict[str, Any] = {}
    messages: defaultdict[str, list[Any]] = defaultdict(list)
    for told in map(json.loads, out.splitlines()):
        if "schema" in told:
            channels[told["topic"]] = told
        else:
            messages[told["topic"]].append(told)
    assert_are_the_groups(channels)
    for topic in TOPICS:
        times_ns = np.array([int(each["time_ns"]) for each in messages[topic]])
        t_s = np.array([each["data"]["t_s"] for each in messages[topic]])
        assert len(t_s) == CYCLES
        np.testing.assert_array_equal(times_ns - times_ns[0], np.round((t_s - t_s[0]) * 1e9))


def test_foxglove_s_own_client_hears_the_channels_and_their_messages(bench: BenchConfig, tmp_path: Path) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    stream = Stream(parse_target(f"foxglove:{port}"), bench, tmp_path)
    try:
        client = reader("foxglove", f"ws://127.0.0.1:{port}", 3)
        assert client.stdout is not None
        channels = {told["topic"]: told for told in (json.loads(client.stdout.readline()) for _ in TOPICS)}
        assert_are_the_groups(channels)
        while client.poll() is None:  # a subscription has no answer: until it has heard enough
            feed(stream, bench, 3)
        received = [json.loads(line) for line in client.stdout]
    finally:
        stream.close()
    assert client.returncode == 0
    assert {told["topic"] for told in received} == TOPICS
    (measured, *_) = (told["data"] for told in received if told["topic"] == "/measured")
    assert {"t_s", "x1_m", "tau2_Nm"} <= set(measured)
