"""The twin process: virtual axes fed by mirrored PDOs, the simulated web, the synchronizer, the virtual I/O.

It knows the bench only from the bus: it hears the real axes' TPDOs beside the commands.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from hilbench.bus.frame import Frame
from hilbench.bus.open import BusAddress, open_link
from hilbench.drives.port import MotorMode, MotorPort
from hilbench.drives.simulated import SimulatedDrive
from hilbench.fieldbus.clock import Clock
from hilbench.fieldbus.device import Device, NmtState
from hilbench.fieldbus.eds import load_eds
from hilbench.fieldbus.host import DeviceHost
from hilbench.twin.axis_listener import AxisListener
from hilbench.twin.config import TwinConfig
from hilbench.twin.synchronizers.base import Estimate, Synchronizer, SyncSample
from hilbench.twin.synchronizers.pid import PidSynchronizer
from hilbench.twin.virtual_io import VirtualIo
from hilbench.web.line import Line
from hilbench.web.parameters import ModelParameters


@dataclass(frozen=True)
class TwinNode:
    """A node that the twin is, or listens to."""

    node_id: int
    eds: Path


@dataclass(frozen=True)
class TwinSetup:
    """All the twin needs to know of the bench config."""

    bus: BusAddress
    clock: Clock
    cycle_s: float
    model: ModelParameters
    twin: TwinConfig
    real_axes: tuple[TwinNode, TwinNode]
    virtual_axes: tuple[TwinNode, TwinNode]
    virtual_io: TwinNode


class TwinApplication:
    """What the twin does in a cycle.

    At SYNC k its TPDOs carry the state simulated for t_k. It then waits for what the real axes measured at t_k,
    lets the synchronizer compare, and simulates to t_{k+1}. When a measurement has not come by the next SYNC the
    cycle is simulated without it, and counted in `missed`.

    The web is held while an axis has its power stage off, as holding brakes would hold it.
    """

    def __init__(
        self,
        setup: TwinSetup,
        line: Line,
        ports: Sequence[MotorPort],
        drives: Sequence[SimulatedDrive],
        virtual_io: VirtualIo,
        new_synchronizer: Callable[[], Synchronizer],
    ) -> None:
        self.missed = 0
        self._cycle_s = setup.cycle_s
        self._line = line
        self._ports = ports
        self._drives = drives
        self._io = virtual_io
        self._new_synchronizer = new_synchronizer
        self._synchronizer = new_synchronizer()
        self._initial_modulus_Pa = line.youngs_modulus_Pa
        model = setup.model
        self._section_m2 = model.required_web.section_m2
        self._torque_per_tension_m = 1.0 / model.motor_rad_per_m(2)
        self._listeners = [AxisListener(node.eds, node.node_id, setup.cycle_s) for node in setup.real_axes]
        self._metres_per_rad = [1.0 / model.motor_rad_per_m(axis) for axis in (1, 2)]
        self._measured: list[tuple[float, float] | None] = [None, None]  # position in rad, torque in N·m
        self._pending = False
        self._released = False
        self._time_s = 0.0
        self._residual_Nm = 0.0
        self._estimate = Estimate(line.youngs_modulus_Pa, math.inf)
        self._tell()

    def reset(self) -> None:
        """Start anew with what is assumed at the start (reset of the virtual I/O node)."""
        self._synchronizer = self._new_synchronizer()
        self._line.youngs_modulus_Pa = self._initial_modulus_Pa
        self._line.set_state(strain=[self._io.strain_prev], v_m_s=[0.0, 0.0])
        self._estimate = Estimate(self._initial_modulus_Pa, math.inf)
        self._measured = [None, None]
        self._pending = self._released = False
        self._time_s = self._residual_Nm = 0.0
        self._tell()

    def before_sync(self) -> None:
        """The next SYNC is here: what is still waiting for a measurement goes on without."""
        if self._pending:
            self.missed += 1
            self._advance()

    def after_sync(self) -> None:
        """The TPDOs are out, the drives have new set points: simulate as soon as the measurements are there."""
        for drive in self._drives:
            drive.sync(self._cycle_s)
        self._pending = True

    def on_frame(self, frame: Frame) -> None:
        """Take the real axes' TPDOs; the last one that was waited for starts the simulation of the cycle."""
        for axis, listener in enumerate(self._listeners):
            if frame.can_id == listener.cob_id:
                self._measured[axis] = listener.decode(frame.data)
                if self._pending and None not in self._measured:
                    self._advance()
                return

    def tick(self, duration_s: float) -> None:
        """Without SYNC the virtual drives still follow their state machines."""
        for drive in self._drives:
            drive.sync(duration_s)
            drive.publish()

    def _advance(self) -> None:
        self._pending = False
        if all(port.mode is not MotorMode.OFF for port in self._ports):
            if not self._released:
                self._release_web()
            self._compare()
            self._line.set_boundary(self._io.strain_prev, self._io.tension_next_N)
            self._line.advance(self._cycle_s)
            self._time_s += self._cycle_s
        else:
            self._released = False
        self._measured = [None, None]
        for drive in self._drives:
            drive.publish()
        self._tell()

    def _release_web(self) -> None:
        """The web starts as the bench's load model does: strained like the web upstream."""
        self._line.set_state(strain=[self._io.strain_prev])
        self._released = True
        self._time_s = 0.0

    def _compare(self) -> None:
        first, second = self._measured
        if first is None or second is None or self._time_s == 0.0:
            return
        line, torque_sim_Nm = self._line, self._ports[1].torque_Nm
        strain = float(line.strain[0])
        sample = SyncSample(
            time_s=self._time_s,
            cycle_s=self._cycle_s,
            torque_real_Nm=second[1],
            torque_sim_Nm=torque_sim_Nm,
            x1_real_m=first[0] * self._metres_per_rad[0],
            x2_real_m=second[0] * self._metres_per_rad[1],
            v2_sim_m_s=self._ports[1].velocity_rad_s * self._metres_per_rad[1],
            tension_sim_N=float(line.tension_N[0]),
            strain_sim=strain,
            strain_prev=self._io.strain_prev,
            tension_next_N=self._io.tension_next_N,
            torque_sim_sensitivity_Nm_per_Pa=self._torque_per_tension_m * self._section_m2 * strain,
        )
        self._residual_Nm = sample.torque_real_Nm - torque_sim_Nm
        self._estimate = self._synchronizer.update(sample)
        line.youngs_modulus_Pa = self._estimate.youngs_modulus_Pa

    def _tell(self) -> None:
        self._io.tell(
            tension_N=float(self._line.tension_N[0]),
            modulus_Pa=self._estimate.youngs_modulus_Pa,
            deviation_Pa=self._estimate.deviation_Pa,
            torque_Nm=self._ports[1].torque_Nm,
            residual_Nm=self._residual_Nm,
        )


def run_twin(setup: TwinSetup, stop: Callable[[], bool]) -> int | None:
    """Run the twin on its bus until `stop` says so. Raises BusError when the bus is lost.

    Returns how many frames were lost because they were not read in time (None: the bus cannot tell).
    """
    model = setup.model
    modulus_Pa = setup.twin.youngs_modulus_Pa or model.required_web.youngs_modulus_Pa
    # A scratch line runs first, so that compiling is over before the devices boot.
    Line(model, (MotorPort(), MotorPort())).advance(setup.cycle_s)
    ports = (MotorPort(), MotorPort())
    line = Line(model, ports)
    line.youngs_modulus_Pa = modulus_Pa
    devices = [Device(load_eds(node.eds, node.node_id), node.node_id, setup.clock) for node in setup.virtual_axes]
    drives = [SimulatedDrive(device, port) for device, port in zip(devices, ports, strict=True)]
    io_node = setup.virtual_io
    io_device = Device(load_eds(io_node.eds, io_node.node_id), io_node.node_id, setup.clock)
    virtual_io = VirtualIo(
        io_device, strain_prev=model.upstream_strain, tension_next_N=model.boundary.downstream_tension_N
    )

    def new_synchronizer() -> Synchronizer:
        return PidSynchronizer(setup.twin.synchronizer, modulus_Pa)

    application = TwinApplication(setup, line, ports, drives, virtual_io, new_synchronizer)
    io_device.on_nmt = lambda state: application.reset() if state is NmtState.INITIALISING else None
    link = open_link(setup.bus)
    try:
        DeviceHost(link, [*devices, io_device], setup.clock, application).run(stop)
    finally:
        link.close()
    return link.dropped
