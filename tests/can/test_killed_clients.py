"""Programs on the embedded bus that are killed (SIGKILL) at any moment: nobody else hangs, and the wire stays free."""

from __future__ import annotations

import os
import random
import signal
import time
import uuid
from contextlib import closing

import pytest
from tests.can.hub_stations import passes
from tests.tiers import slow

from hilbench.can import hub_client
from hilbench.can.frame import Frame
from hilbench.can.open import BusAddress, open_link

#: What the killed ones send and receive. In virtual time they fill queues as fast as they can; by the clock two of them
#: send as much as the wire carries, or what the dead have sent would be on it for minutes.
NOISE = [Frame(0x300 + at, bytes((at,)) * 8) for at in range(8)]
PAUSE_S = {"virtual": 0.0, "real": 2 * 8 * 135e-6}
#: The longest life of one, s: some are killed before they have joined, others in the middle of a packet.
LONGEST_LIFE_S = 0.02


def joins_and_floods(bus: BusAddress, *, reads: bool) -> int:
    """A process of its own that does so until it is killed."""
    pid = os.fork()
    if pid == 0:
        try:
            link = open_link(bus)
            while True:
                link.send(NOISE)
                time.sleep(PAUSE_S[bus.timing])
                if reads:
                    link.receive(0.0)
        finally:
            os._exit(1)
    return pid


@pytest.mark.parametrize(
    ("timing", "seed", "tries"), [("virtual", 1, 20), *slow(("virtual", 2, 1000), ("real", 3, 300))]
)
def test_killed_at_any_moment_a_program_leaves_nobody_hanging(runtime, timing, seed, tries):
    drawn = random.Random(seed)
    bus = BusAddress(channel=f"k{uuid.uuid4().hex[:10]}", timing=timing)
    with closing(open_link(bus)) as one, closing(open_link(bus)) as other:
        other.set_filters([(0x100, 0x7FF)])
        one.set_filters([])
        for number in range(tries):
            pids = [joins_and_floods(bus, reads=drawn.random() < 0.5) for _ in range(drawn.randint(1, 2))]
            for pid in pids:
                time.sleep(drawn.uniform(0.0, LONGEST_LIFE_S))
                os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, 0)
            assert passes(one, other, number)
        assert runtime.eventually(lambda: hub_client.statistics(bus.channel).stations == 2)
