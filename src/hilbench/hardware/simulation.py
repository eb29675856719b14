"""The simulated hardware: the drives of the bench on their rig, a process of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from hilbench.can.embedded import EmbeddedLink
from hilbench.can.frame import Frame
from hilbench.can.link import Link
from hilbench.canopen.clock import Clock, MonotonicClock, SyncClock
from hilbench.canopen.device import Device
from hilbench.canopen.host import DeviceHost, HostedDevices
from hilbench.canopen.master_guard import nodes_of_ours
from hilbench.canopen.object_store import INVALID_VALUE, SdoAbort
from hilbench.cia402.simulated import SimulatedDrive
from hilbench.exchange.addressing import declared_units, device_clock, dictionary_of
from hilbench.exchange.effect_objects import bind_effect_objects
from hilbench.fast_path.host import FastPathHost, PacketRun, run_devices, warm_up_packets
from hilbench.fast_path.host_cycle import RigFastCycle, SyncAnswers
from hilbench.hardware.plant_time import ByClock, BySync, PlantTime
from hilbench.hardware.rigs import new_rig
from hilbench.plant.interface import Plant, Steps, StepsInModes
from hilbench.plant.motor_port import MotorMode, MotorPort
from hilbench.processes import log, started_by_bench, stop_request
from hilbench.topology.config import BenchConfig
from hilbench.topology.parts import Role

#: In real time the rig goes on without a SYNC that is late by so many cycles after the last one.
_OVERDUE = 1.5


class RigApplication:
    """SYNC handler of the hardware: the drives take their set points, then the rig advances.

    `time` says how far, in sample times of the drives' loops; the drives look at their set points at least once in
    every cycle of the config. `lock`: gives the rig another sample time, where `time` may have one.
    """

    listens_to: frozenset[int] = frozenset()

    def __init__(
        self,
        drives: list[SimulatedDrive],
        ports: Sequence[MotorPort],
        rig: Steps,
        time: PlantTime,
        cycle_s: float,
        lock: Callable[[float], None] | None = None,
    ) -> None:
        self.drives = drives  #: the simulated ones
        self.ports = ports  #: ports of all motors, simulated drive or not
        self._in_use = False
        self.rig = rig  #: mechanics that the motors turn
        self._time = time
        self._lock, self._sample_s = lock, time.sample_s
        self._longest_step = round(cycle_s / time.sample_s)

    @property
    def fits_fast_path(self) -> bool:
        """Whether the rig goes on with each SYNC, and has begun to."""
        return self.fast_path_step_s() is not None

    def fast_path_step_s(self) -> float | None:
        """How far the rig goes with each SYNC, in one step; None where that is not known before."""
        if not self._in_use or not isinstance(self._time, BySync):
            return None
        samples = self._time.after_sync()
        return samples * self._time.sample_s if 0 < samples <= self._longest_step else None

    def before_sync(self, behind: int) -> None:
        """Be at the time of this SYNC: in lockstep, and when it comes in time, the state is there since the last."""
        self._go(self._time.before_sync(behind))

    def after_sync(self) -> None:
        """Advance to the time of the next SYNC."""
        samples = self._time.after_sync()
        if samples:
            self._go(samples)
        else:  # ahead of time already: the new set points are taken all the same
            self._step(0)

    def tick(self, duration_s: float) -> None:
        """Go on, also when there is no SYNC."""
        self._go(self._time.without_sync(duration_s))

    def on_frame(self, frame: Frame) -> None:
        """Frames for others don't concern the hardware."""

    def _go(self, samples: int) -> None:
        while samples > 0:
            step = min(samples, self._longest_step)
            self._step(step)
            samples -= step

    def _step(self, samples: int) -> None:
        duration_s = samples * self._time.sample_s
        for drive in self.drives:
            drive.sync(duration_s)
        # At rest with all power stages off nothing moves; the noise must not depend on how long that lasted.
        if samples and (self._in_use or any(port.mode is not MotorMode.OFF for port in self.ports)):
            self._in_use = True
            if self._lock is not None and self._time.sample_s != self._sample_s:
                self._sample_s = self._time.sample_s
                self._lock(self._sample_s)
            self.rig.step(duration_s)
        for drive in self.drives:
            drive.publish()


def simulate(config: BenchConfig) -> int | None:
    """Simulate the nodes of the bench that are marked `simulated` until SIGTERM, SIGINT or the end of the bench.

    Returns how many frames were lost because they were not read in time (None: the bus cannot tell). Raises
    UnusableInputError when a node with one of their ids is there already.
    """
    stop, bus, by_bench = stop_request(), config.bus_address, started_by_bench()
    with nodes_of_ours(bus, config.simulated_drives, "simulated hardware", by_bench=by_bench):
        hosted = hardware(config)
        fast_path = partial(fast_path_host, hosted=hosted, config=config)
        return run_devices(bus, hosted, fast_path, config.process_settings("hardware"), stop, log)


def fast_path_host(host: DeviceHost, link: Link, hosted: HostedDevices, config: BenchConfig) -> FastPathHost | None:
    """Fast-path host of the devices on the embedded bus in lockstep; None elsewhere."""
    devices, clock, application, cycle_ns = hosted.devices, hosted.clock, hosted.application, config.cycle_ns
    if not isinstance(link, EmbeddedLink) or not isinstance(clock, SyncClock):
        return None
    assert isinstance(application, RigApplication), "as `hardware` makes it"
    warm_up_in_modes(config)
    drives = application.drives

    def begin(expected: Sequence[Frame]) -> PacketRun:
        return RigFastCycle(SyncAnswers(link, devices, drives, clock, expected, cycle_ns), application)

    return FastPathHost(host, link, application, begin)


def hardware(config: BenchConfig) -> HostedDevices:
    """The nodes of the bench that are marked `simulated`, on their rig."""
    clock, time = _time_base(config)
    parts = config.stand_drives
    ports = tuple(MotorPort() for _ in parts)
    warm_up(config)
    rig = new_rig(config, ports, config.seed)
    devices: dict[int, Device] = {}
    drives = []
    for part, port in zip(parts, ports, strict=True):
        if not part.is_simulated:
            continue
        node_id = part.node.node_id
        if node_id not in devices:
            devices[node_id] = Device(dictionary_of(part), node_id, clock)
            for note in devices[node_id].left_out.values():
                log(f"{part.label} (node {node_id}): {note}")
        device = devices[node_id]
        drives.append(SimulatedDrive(device, port, declared_units(part), axis=part.node_axis))
        if part.role is Role.AXIS and part.axis is not None:
            bind_effect_objects(device, _effect_setter(rig, part.axis), config.machine.machine_kind, part.node_axis)
    application = RigApplication(drives, ports, rig, time, config.cycle_time_s, rig.lock_to)
    return HostedDevices(list(devices.values()), clock, application)


def load(config: BenchConfig) -> None:
    """Compile, or load, all that a process of simulated hardware on the embedded bus runs on."""
    warm_up(config)
    if config.pace == "lockstep":
        warm_up_in_modes(config)
        warm_up_packets()


def warm_up(config: BenchConfig) -> None:
    """Compile, or load, what a rig runs on, on a scratch rig: it is over before the devices boot."""
    ports = [MotorPort() for _ in config.stand_drives]
    new_rig(config, ports).step(config.cycle_time_s)


def warm_up_in_modes(config: BenchConfig) -> None:
    """Compile, or load, what a rig does in the place of `Steps.step`, before the devices boot."""
    ports = [MotorPort() for _ in config.stand_drives]
    rig = new_rig(config, ports)
    if isinstance(rig, StepsInModes):
        step = rig.steps_in_modes(np.zeros(len(ports)), config.cycle_time_s, np.zeros(5 * len(ports)))
        if step is not None:
            step()


def _time_base(config: BenchConfig) -> tuple[Clock, PlantTime]:
    """Clock and plant time of devices and rig: SYNC where the bench waits for all nodes (lockstep), else the clock."""
    sample_s = config.drive_parameters.sample_time_s
    if config.pace == "lockstep":
        return device_clock(config), BySync(config.cycle_time_s, sample_s)
    clock = MonotonicClock(stall_s=_OVERDUE * config.cycle_time_s)
    # Beside a bench SYNC is that of the config; another master's may be none of whole sample times.
    return clock, ByClock(config.cycle_time_s, sample_s, clock.now_ns, log, any_period=not started_by_bench())


def _effect_setter(rig: Plant, axis: int) -> Callable[[str, dict[str, float]], None]:
    def apply(effect: str, parameters: dict[str, float]) -> None:
        try:
            rig.set_effect(effect, axis, section=None, slot=0, **parameters)
        except ValueError:
            raise SdoAbort(INVALID_VALUE) from None

    return apply
