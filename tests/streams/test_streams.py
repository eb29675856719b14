"""Streams of a run: whole in a file, live for those who look, and never in the way of the bench."""

from __future__ import annotations

import json
import os
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from tests.bench.whole_runs import config, run_folders, run_here
from tests.cli.in_process import hilbench

from hilbench.apps.streams.sinks import Target, groups_of, open_sink, parse_target
from hilbench.apps.streams.stream import Stream
from hilbench.errors import UnusableInputError
from hilbench.results.recording import Recording, read_recording
from hilbench.results.result import Result
from hilbench.results.run_folder import RunFolder
from hilbench.runs.config import load_with_overrides
from hilbench.topology.config import BenchConfig
from hilbench.topology.sample import sample_type
from hilbench.topology.signals import find_signal, signals_of, smallest_shapes

SIGNALS = signals_of("web_line", smallest_shapes()["web_line"])


class Listener:
    """Takes datagrams, from the start on."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 23)
        self.socket.bind(("127.0.0.1", 0))
        self.port = self.socket.getsockname()[1]
        self.received: list[dict[str, Any]] = []
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        while data := self.socket.recv(1 << 16):
            self.received.append(json.loads(data))

    def close(self) -> None:
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM).sendto(b"", ("127.0.0.1", self.port))
        self._thread.join(timeout=10)
        self.socket.close()


@pytest.fixture(scope="module")
def streamed(tmp_path_factory: pytest.TempPathFactory) -> tuple[RunFolder, Path, list[dict[str, Any]], str]:
    """A short run with two streams: its folder, the file, what was heard, and what was said."""
    folder, listener = tmp_path_factory.mktemp("streamed"), Listener()
    path = config(folder)
    file = folder / "run.mcap"
    words = ["--no-report", "--stream", str(file), "--stream", f"plotjuggler:{listener.port}"]
    code, out, err = run_here(path, *words)
    listener.close()
    assert code == 0, err
    return RunFolder(run_folders(path)[0]), file, listener.received, out


def columns_of(file: Path) -> dict[tuple[str, str], list[float]]:
    """By topic and name, as mcap's own reader finds them."""
    found: dict[tuple[str, str], list[float]] = {}
    with file.open("rb") as stream:
        for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            for name, value in json.loads(message.data).items():
                found.setdefault((channel.topic, name), []).append(np.nan if value is None else value)
    return found


def assert_equals(found: dict[tuple[str, str], list[float]], recording: Recording) -> None:
    assert {name for _, name in found} == set(recording.channels)
    for (_, name), values in found.items():
        np.testing.assert_array_equal(np.array(values, float), np.asarray(recording[name], float), err_msg=name)


def test_a_file_read_by_mcap_s_reader_equals_the_recording(streamed: tuple[RunFolder, Path, Any, str]) -> None:
    folder, file, _, _ = streamed
    assert_equals(columns_of(file), read_recording(folder.recording))


def test_a_file_says_what_its_values_are_in_which_unit(streamed: tuple[RunFolder, Path, Any, str]) -> None:
    with streamed[1].open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert {channel.topic for channel in summary.channels.values()} == {
        f"/{group.name}" for group in groups_of(SIGNALS)
    }
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        assert (channel.message_encoding, schema.encoding) == ("json", "jsonschema")
        for name, told in json.loads(schema.data)["properties"].items():
            known = find_signal(name)
            assert known is not None
            assert told["unit"] == (known.unit or "1")
            assert told["type"] == ("integer" if known.integer else "number")


def test_plotjuggler_hears_every_cycle_by_groups(streamed: tuple[RunFolder, Path, Any, str]) -> None:
    folder, _, received, _ = streamed
    recording = read_recording(folder.recording)
    assert len(received) == len(recording)
    np.testing.assert_array_equal([each["timestamp"] for each in received], recording.time_s)
    np.testing.assert_array_equal([each["measured"]["x1_m"] for each in received], recording["x1_m"])


def test_the_result_says_how_much_went_where(streamed: tuple[RunFolder, Path, Any, str]) -> None:
    folder, file, received, said = streamed
    records = Result.read(folder.result).streams
    assert records is not None
    assert [(each.samples, each.dropped) for each in records] == [(len(received), 0)] * 2
    assert f"stream to {file}: {len(received)} samples" in said.replace("\n", "")


def test_a_recording_becomes_the_file_that_its_stream_would_have_been(
    streamed: tuple[RunFolder, Path, Any, str], tmp_path: Path
) -> None:
    folder, file, _, _ = streamed
    made = tmp_path / "made.mcap"
    assert hilbench("convert", folder.recording, made).returncode == 0
    assert columns_of(made) == columns_of(file)


@pytest.fixture
def bench(tmp_path: Path) -> BenchConfig:
    return load_with_overrides(config(tmp_path), pace="realtime").config


def feed(stream: Stream, bench: BenchConfig, cycles: int) -> None:
    sample = sample_type(bench.signals)()
    for cycle in range(cycles):
        sample.t_s = cycle * bench.cycle_time_s
        stream.sample(sample)


@pytest.mark.slow
def test_a_stream_that_hangs_drops_and_the_bench_goes_on(bench: BenchConfig, tmp_path: Path) -> None:
    listener = Listener()
    stream = Stream(parse_target(f"plotjuggler:{listener.port}"), bench, tmp_path)
    os.kill(stream.pid, signal.SIGSTOP)
    feed(stream, bench, 20_000)  # returns: nothing here waits
    assert 0 < stream.dropped < stream.samples == 20_000
    os.kill(stream.pid, signal.SIGCONT)
    stream.close()
    listener.close()
    times = [each["timestamp"] for each in listener.received]
    assert times == sorted(times)  # what did come is whole
    assert all(len(each["measured"]) == len(listener.received[0]["measured"]) for each in listener.received)


def test_a_stream_that_is_killed_ends_no_run_and_says_what_is_missing(bench: BenchConfig, tmp_path: Path) -> None:
    stream = Stream(parse_target("plotjuggler:9"), bench, tmp_path)
    os.kill(stream.pid, signal.SIGKILL)
    feed(stream, bench, 20_000)
    stream.close()
    assert stream.record().dropped > 0
    (warning,) = stream.record().warnings()
    assert "samples were dropped" in warning


_KILLED = """if True:
    import os, signal, sys
    from pathlib import Path
    from hilbench.runs.config import load_with_overrides
    from hilbench.apps.streams.stream import Stream
    from hilbench.apps.streams.sinks import parse_target
    from hilbench.topology.sample import sample_type
    folder = Path(sys.argv[1])
    bench = load_with_overrides(folder / "bench.yaml").config
    stream = Stream(parse_target(str(folder / "run.mcap")), bench, folder)
    for _ in range(640):
        stream.sample(sample_type(bench.signals)())
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_file_is_whole_though_its_bench_was_killed(bench: BenchConfig, tmp_path: Path) -> None:
    command = [sys.executable, "-c", _KILLED, str(tmp_path)]
    killed = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    file, until_s = tmp_path / "run.mcap", time.monotonic() + 60.0
    while not is_whole(file) and time.monotonic() < until_s:
        time.sleep(0.05)
    assert len(columns_of(file)["/measured", "x1_m"]) == 640


def is_whole(file: Path) -> bool:
    """Whether it ends as an MCAP file does."""
    return file.read_bytes()[-8:] == b"\x89MCAP0\r\n"


def test_foxglove_is_shown_channels_with_schemas_and_may_send_nothing(bench: BenchConfig, tmp_path: Path) -> None:
    client = pytest.importorskip("websockets.sync.client")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    stream = Stream(parse_target(f"foxglove:{port}"), bench, tmp_path)
    try:
        # With a queue that can be full it would not hear that the connection is closed, behind what it has not taken.
        with client.connect(f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"], max_queue=None) as connection:
            told: dict[str, Any] = {}
            while "advertise" not in told:
                message = json.loads(connection.recv(timeout=30))
                told[message["op"]] = message
            assert told["serverInfo"]["capabilities"] == []
            channels = {each["topic"]: each for each in told["advertise"]["channels"]}
            assert set(channels) == {f"/{group.name}" for group in groups_of(bench.signals)}
            asked = {"id": 1, "channelId": channels["/measured"]["id"]}
            connection.send(json.dumps({"op": "subscribe", "subscriptions": [asked]}))
            time.sleep(0.2)  # the server has no answer to a subscription
            feed(stream, bench, 50)
            data = connection.recv(timeout=30)
            opcode, subscription, _ = struct.unpack_from("<BIQ", data)
            assert (opcode, subscription) == (1, 1)
            assert "x1_m" in json.loads(data[13:])
    finally:
        stream.close()


class Broker(threading.Thread):
    """As much of an MQTT 3.1.1 broker as one who publishes at QoS 0 needs."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.server = socket.create_server(("127.0.0.1", 0))
        self.port = self.server.getsockname()[1]
        self.published: list[tuple[str, dict[str, float]]] = []
        self.start()

    def run(self) -> None:
        connection, _ = self.server.accept()
        with connection, connection.makefile("rb") as stream:
            for kind, body in self._packets(stream):
                if kind == 1:
                    connection.sendall(b"\x20\x02\x00\x00")  # CONNACK: accepted
                elif kind == 3:
                    length = int.from_bytes(body[:2], "big")
                    self.published.append((body[2 : 2 + length].decode(), json.loads(body[2 + length :])))

    @staticmethod
    def _packets(stream: Any) -> Iterator[tuple[int, bytes]]:
        while head := stream.read(1):
            length = shift = 0
            while True:
                (digit,) = stream.read(1)
                length |= (digit & 0x7F) << shift
                shift += 7
                if digit < 0x80:
                    break
            yield head[0] >> 4, stream.read(length)


def test_a_broker_gets_ten_pictures_a_second_of_each_group() -> None:
    broker = Broker()
    sink = open_sink(parse_target(f"mqtt:127.0.0.1:{broker.port}"), SIGNALS, "my bench", 0.0)
    row = [0.0] * len(SIGNALS)
    for cycle in range(500):
        row[0] = cycle * 0.002
        sink.take(row)
    until_s = time.monotonic() + 30.0
    while len(broker.published) < 10 * len(groups_of(SIGNALS)) and time.monotonic() < until_s:
        time.sleep(0.01)
    sink.close()
    measured = [values for topic, values in broker.published if topic == "hilbench/my-bench/measured"]
    assert [round(values["t_s"], 6) for values in measured] == pytest.approx([0.1 * k for k in range(10)], abs=0.011)


def test_what_is_not_finite_is_null_and_a_count_a_count() -> None:
    row = [float("nan") if signal.name == "tau1_Nm" else 3.0 for signal in SIGNALS]
    messages = {group.name: json.loads(group.text(row, 1.5)) for group in groups_of(SIGNALS)}
    assert messages["measured"]["tau1_Nm"] is None
    assert '"statusword1":3,' in groups_of(SIGNALS)[-1].text(row, 1.5).decode() + ","
    assert all(message["t_s"] == 1.5 for message in messages.values())


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("foxglove", "127.0.0.1", 8765),
        ("plotjuggler", "127.0.0.1", 9870),
        ("mqtt", "127.0.0.1", 1883),
        ("plotjuggler:9999", "127.0.0.1", 9999),
        ("plotjuggler:192.168.1.5:9999", "192.168.1.5", 9999),
        ("foxglove:0.0.0.0", "0.0.0.0", 8765),
        ("foxglove:[::1]:1234", "::1", 1234),
        ("foxglove:[::1]", "::1", 8765),
    ],
)
def test_only_this_machine_unless_another_is_named(text: str, host: str, port: int) -> None:
    target = parse_target(text)
    assert (target.host, target.port) == (host, port)


@pytest.mark.parametrize("text", ["", "rosbag", "run.bag", "plotjuggler:0", "mqtt:host:99999", "foxglove:host:x"])
def test_what_is_no_target_is_unusable(text: str) -> None:
    with pytest.raises(UnusableInputError, match="expected"):
        parse_target(text)


def unusable(targets: Sequence[str], folder: Path) -> str:
    path = config(folder)
    code, _, err = run_here(path, *(word for each in targets for word in ("--stream", each)))
    assert code == 2
    assert run_folders(path) == []  # before anything was started
    (line,) = err.splitlines()
    return line


def test_a_file_that_is_there_is_not_written_over(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    file.write_text("precious")
    assert "expected a new file" in unusable([str(file)], tmp_path)
    assert file.read_text() == "precious"


def test_an_address_that_is_taken_is_told_before_the_bench_starts(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert f"foxglove 127.0.0.1:{port}" in unusable([f"foxglove:{port}"], tmp_path)


@pytest.mark.parametrize(
    ("target", "module"), [("x.mcap", "foxglove"), ("foxglove", "foxglove"), ("mqtt", "paho.mqtt.client")]
)
def test_a_library_that_is_missing_is_named(
    target: str, module: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(UnusableInputError, match=r"hilbench\[streams\]"):
        open_sink(parse_target(target), SIGNALS, "bench", 0.0)


def test_a_target_is_told_as_it_was_meant() -> None:
    assert str(Target("mcap", path=Path("a/run.mcap"))) == "a/run.mcap"
    assert str(parse_target("mqtt")) == "mqtt 127.0.0.1:1883"
