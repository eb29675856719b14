"""`hilbench doctor` on an interface of the kernel, and reading by SDO over it.

The interface is named by HILBENCH_VCAN.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from tests.canopen.device_under_test import Idle

from hilbench.can.open import BusAddress, open_link, open_python_can
from hilbench.canopen.clock import MonotonicClock
from hilbench.canopen.device import Device
from hilbench.canopen.eds import load_eds
from hilbench.canopen.host import DeviceHost
from hilbench.canopen.sdo_client import Refusal, SdoClient

pytestmark = pytest.mark.vcan

EDS = Path(__file__).resolve().parents[2] / "eds" / "hilbench_servo.eds"
NODE = 5


def test_interface_and_stranger_are_seen_and_read() -> None:
    bus = BusAddress("socketcan", os.environ["HILBENCH_VCAN"])
    link = open_link(bus)
    device = Device(load_eds(EDS, NODE), NODE, MonotonicClock())
    device.cell(0x1017).value = 100  # heartbeat, ms
    stop = threading.Event()
    host = threading.Thread(target=DeviceHost(link, [device], MonotonicClock(), Idle()).run, args=(stop.is_set,))
    host.start()
    try:
        command = [sys.executable, "-m", "hilbench", "doctor", "--bus", str(bus), "--json"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        with SdoClient(open_python_can(bus), timeout_s=5.0) as reader:
            assert reader.read(NODE, 0x1018, 2) == (0x402).to_bytes(4, "little")
            assert reader.read(NODE, 0x5FFF) == Refusal(0x06020000)
    finally:
        stop.set()
        host.join()
        link.close()
    assert done.returncode == 0, done.stdout + done.stderr
    found = {finding["check"]: finding for finding in json.loads(done.stdout)["findings"]}
    for check in ("interface", "up", "bitrate", "mode", "queue_length", "bus", "other_master"):
        assert found[check]["level"] == "ok", found[check]
    assert found["interface"]["subject"] == bus.channel
    assert f"node {NODE} ({0x700 + NODE:X}h)" in found["strangers"]["found"]
