"""The twin process: virtual axes fed by mirrored PDOs, the simulated web, the synchronizer, the virtual I/O.

It knows the bench only from the bus: it hears the real axes' TPDOs beside the commands.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from struct import pack

from hilbench.can.frame import Frame
from hilbench.can.open import BusAddress, open_link
from hilbench.canopen.clock import Clock, SyncClock
from hilbench.canopen.device import Device, SdoAbort
from hilbench.canopen.eds import load_eds
from hilbench.canopen.host import DeviceHost, HostedDevices
from hilbench.canopen.identifiers import NmtState
from hilbench.canopen.sync_time import SyncTime
from hilbench.cia402.simulated import SimulatedDrive
from hilbench.estimation.web_line.config import EstimationConfig
from hilbench.estimation.web_line.synchronizers.create import METHODS
from hilbench.estimation.web_line.torque_shift import TORQUE_SHIFT, UNDECIDED
from hilbench.estimation.web_line.tracking import Tracking
from hilbench.plant.motor_port import MotorMode, MotorPort
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.pairing import Pairing, SteadyWay
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sizes import least_way_m
from hilbench.real_time import ProcessSettings, kept_ready
from hilbench.twin.alarms import Alarms
from hilbench.twin.axis_listener import AxisListener, RealAxis, TwinNode
from hilbench.twin.virtual_io import TwinStatus, VirtualIo

#: Error register (1001h): generic and device profile.
_PROFILE_SPECIFIC = 0x21
_VALUE_TOO_HIGH = 0x06090031
#: Above this speed of an axis the plant runs already when the twin joins.
_MOVES_M_S = 1e-3
#: How far off the upstream strain may be as a guess of the strain of a web that is found under way.
_UNKNOWN_STRAIN = 0.3
_WARM_UP_CYCLES = 100
#: SYNCs that an axis may leave unanswered and answer later.
_MOST_OWED = 100
#: Missed SYNCs in a row that the simulation makes up for; after more a twin has to find motion and tension anew.
_MOST_SKIPPED = 100
#: In the order in which `TwinApplication` puts them together.
_STATUS_BITS = tuple(
    int(bit)
    for bit in (
        TwinStatus.RUNNING,
        TwinStatus.SYNCHRONIZED,
        TwinStatus.HOLDING,
        TwinStatus.LATE,
        TwinStatus.TRANSFER_REFUSED,
        TwinStatus.NOT_SEPARABLE,
    )
)


@dataclass(frozen=True)
class TwinSetup:
    """All the twin needs to know of the bench config."""

    bus: BusAddress
    clock: Clock
    cycle_s: float
    model: ModelParameters
    twin: EstimationConfig
    real_axes: tuple[RealAxis, ...]
    virtual_axes: tuple[TwinNode, ...]
    virtual_io: TwinNode
    process: ProcessSettings | None  #: what the twin's process asks of the operating system


class TwinApplication:
    """What the twin does in a cycle.

    At SYNC k its TPDOs carry the state simulated for t_k, and say so (2100h). It then waits for what the real axes
    measured at t_k, lets the synchronizer compare, and simulates to t_{k+1}. When a measurement has not come by the
    next SYNC the cycle is simulated without it, and counted in `missed`. When it is so late that further SYNCs are
    waiting, it tells its age, and catches up or holds, as configured.

    The web is held while an axis has its power stage off, as holding brakes would hold it. A twin that is started
    beside a running plant takes the axes' motion and torque over, and calls itself synchronized when the web that it
    could not know has been transported out of the span and E is known.
    """

    def __init__(
        self,
        setup: TwinSetup,
        line: Line,
        ports: Sequence[MotorPort],
        drives: Sequence[SimulatedDrive],
        device: Device,
        virtual_io: VirtualIo,
    ) -> None:
        self.missed = 0
        self.malformed = 0  #: frames with the COB-ID, but not the length, of an axis' TPDO
        self.surplus = 0  #: TPDOs of an axis beyond the one that answers SYNC
        self._cycle_s = setup.cycle_s
        self._hold_when_behind = setup.twin.behind == "hold"
        self._line = line
        self._ports = ports
        self._drives = drives
        self._device = device
        self._io = virtual_io
        self._listeners = [AxisListener(node, setup.cycle_s) for node in setup.real_axes]
        self.listens_to = frozenset(listener.cob_id for listener in self._listeners)
        self._metres_per_rad = [1.0 / setup.model.motor_rad_per_m(axis) for axis in (1, 2)]
        self._tracking = Tracking(setup.model, setup.twin, line, ports[1], setup.cycle_s)
        self._pairing = Pairing(least_way_m(setup.model))
        self._steady = SteadyWay(setup.cycle_s)  # of axis 2
        self._measured: list[tuple[float, float] | None] = [None, None]  # position in rad, torque in N·m
        self._owed = [0, 0]  # SYNCs that the axis has not answered
        self._positions_before: list[float] | None = None
        self._alarms = Alarms(setup.cycle_s)
        self._reported_shift_Nm, self._reported_undecided = 0.0, False
        self._pending = self._released = False
        self._sync_number = self._behind = 0
        self._time_s = 0.0
        self._now_ns = setup.clock.now_ns
        # In lockstep one SYNC is one cycle, however long it took.
        self._sync_time = None if isinstance(setup.clock, SyncClock) else SyncTime(round(setup.cycle_s * 1e9))
        self._ahead = False  # of a SYNC that was counted as missed, and came
        virtual_io.on_method(self._use_method)
        self._publish()

    def reset(self) -> None:
        """Start anew with what is assumed at the start (reset of the virtual I/O node)."""
        self._tracking.reset()
        self._line.set_state(_states(self._io.strain_prev, [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]))
        self._measured = [None, None]
        self._owed = [0, 0]
        self._positions_before = None
        self._alarms.reset()
        self._reported_shift_Nm, self._reported_undecided = 0.0, False
        self._pending = self._released = False
        self._time_s = 0.0
        self._publish()

    def start(self) -> None:
        """NMT start: SYNCs are counted from here."""
        self._sync_number = 0

    def before_sync(self, behind: int) -> None:
        """A SYNC is here, `behind` more are waiting: what still waits for a measurement goes on without."""
        if self._pending:
            self.missed += 1
            self._advance()
        # What came since is late: taken for an answer to this SYNC it would push the true one to the next, for ever.
        self._measured = [None, None]
        self._owed = [min(owed + 1, _MOST_OWED) for owed in self._owed]
        self._sync_number += 1
        self._behind = behind
        self._catch_up(behind)
        self._io.publish_status(self._sync_number, behind, self._status())

    def _catch_up(self, behind: int) -> None:
        """In real time the axes have gone on through the cycles whose SYNC the bench has missed."""
        if self._sync_time is None:
            return
        first = self._sync_time.at_ns is None
        skipped = self._sync_time.heard(self._now_ns(), behind) - 1
        self._ahead = skipped < 0 and not first
        if not self._released or not 0 < skipped <= _MOST_SKIPPED:
            return
        for _ in range(skipped):
            self._line.step(self._cycle_s)
            self._time_s += self._cycle_s
        for drive in self._drives:
            drive.publish()
        self._publish()

    def after_sync(self) -> None:
        """The TPDOs are out, the drives have new set points: simulate as soon as the measurements are there."""
        for drive in self._drives:
            drive.sync(self._cycle_s)
        self._pending = True

    def on_frame(self, frame: Frame) -> None:
        """Take the real axes' TPDOs, as many as SYNC has asked for: of two senders the first, as the bench does. The
        last one that was waited for starts the simulation of the cycle."""
        for axis, listener in enumerate(self._listeners):
            if frame.can_id == listener.cob_id:
                if len(frame.data) != listener.size:
                    self.malformed += 1
                    return
                if self._owed[axis] == 0:  # the bench, which hears it too, says so
                    self.surplus += 1
                    return
                self._owed[axis] -= 1
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
        if self._behind and self._hold_when_behind:
            self._tracking.miss()
        elif all(port.mode is not MotorMode.OFF for port in self._ports):
            if self._released or self._release_web():
                self._compare()
                self._line.set_input("strain_prev", self._tracking.upstream_strain(self._io.strain_prev))
                self._line.set_input("F_next_N", self._io.tension_next_N)
                if not self._ahead:
                    self._line.step(self._cycle_s)
                    self._time_s += self._cycle_s
        else:
            self._released = False
            self._positions_before = None
        self._measured = [None, None]
        for drive in self._drives:
            drive.publish()
        self._publish()

    def _release_web(self) -> bool:
        """Take over motion and torque of the axes from their first two measurements; whether both are there.

        The web starts as the bench's load model does, strained like the web upstream. On axes that move already this
        is a guess.
        """
        first, second = self._measured
        if first is None or second is None:
            return False
        positions = [first[0] * self._metres_per_rad[0], second[0] * self._metres_per_rad[1]]
        before, self._positions_before = self._positions_before, positions
        if before is None:
            return False
        speeds = [(now - then) / self._cycle_s for now, then in zip(positions, before, strict=True)]
        moves = max(map(abs, speeds)) > _MOVES_M_S
        at_rest = [0.0, 0.0]
        torques = [first[1], second[1]]
        self._line.set_state(
            _states(self._io.strain_prev, positions, speeds if moves else at_rest, torques if moves else at_rest)
        )
        self._tracking.release(_UNKNOWN_STRAIN if moves else 0.0)
        self._pairing.reset()
        self._steady.reset()
        self._released = True
        self._time_s = 0.0
        return True

    def _compare(self) -> None:
        first, second = self._measured
        if first is None or second is None:
            self._tracking.miss()
            return
        positions = (first[0] * self._metres_per_rad[0], second[0] * self._metres_per_rad[1])
        if not self._pairing.update(*positions) or not self._steady.update(positions[1]):
            self._tracking.miss()
            return
        self._tracking.compare(
            self._time_s,
            positions[0],
            positions[1],
            second[1],
            self._io.strain_prev,
            self._io.tension_next_N,
        )
        self._report_problem()
        self._report_shift()

    def _report_problem(self) -> None:
        """Say by EMCY why a measurement can't be used, and when it can be again."""
        begun, ended = self._alarms.update(self._tracking.problem)
        for problem in ended:
            self._device.clear_emergency(problem)
        for problem in begun:
            self._device.emergency(problem, _PROFILE_SPECIFIC)

    def _report_shift(self) -> None:
        """Say by EMCY what the torque is corrected for, and whether something is open."""
        shift_Nm, undecided = self._tracking.torque_shift_Nm, self._tracking.torque_undecided
        if shift_Nm != self._reported_shift_Nm:
            self._device.clear_emergency(TORQUE_SHIFT)
            if shift_Nm != 0.0:
                self._device.emergency(TORQUE_SHIFT, _PROFILE_SPECIFIC, pack("<f", shift_Nm))
            self._reported_shift_Nm = shift_Nm
        if undecided is not self._reported_undecided:
            if undecided:
                self._device.emergency(UNDECIDED, _PROFILE_SPECIFIC)
            else:
                self._device.clear_emergency(UNDECIDED)
            self._reported_undecided = undecided

    def _use_method(self, number: int) -> None:
        """Go on with another synchronizer, from the present E (2101h)."""
        methods = list(METHODS.values())
        if number > len(methods):
            raise SdoAbort(_VALUE_TOO_HIGH)
        self._tracking.use(methods[number - 1]() if number else None)

    def _status(self) -> int:
        """Bits of `TwinStatus`, as a plain number: flags of the enum take microseconds to put together."""
        tracking, status = self._tracking, 0
        for bit, holds in zip(
            _STATUS_BITS,
            (
                self._released,
                self._released and tracking.synchronized,
                tracking.problem is not None,
                self._behind > 0,
                tracking.refused,
                not all(nuisance.separable for nuisance in tracking.estimate.nuisances),
            ),
            strict=True,
        ):
            if holds:
                status |= bit
        return status

    def _publish(self) -> None:
        tracking = self._tracking
        factor = self._line.elasticity_factor  # the E that acts is told, as of a web that is measured
        self._io.tell(
            tension_N=float(self._line.tension_N[0]),
            modulus_Pa=factor * tracking.estimate.youngs_modulus_Pa,
            deviation_Pa=factor * tracking.estimate.deviation_Pa,
            torque_Nm=self._ports[1].torque_Nm,
            residual_Nm=tracking.residual_Nm,
        )


def _states(strain: float, x_m: Sequence[float], v_m_s: Sequence[float], tau_Nm: Sequence[float]) -> dict[str, float]:
    """States of the line by name: one strain for every span; position, speed and torque of each axis (N,)."""
    states = {f"strain{span}": strain for span in range(1, len(x_m))}
    for k, (x, v, tau) in enumerate(zip(x_m, v_m_s, tau_Nm, strict=True), 1):
        states |= {f"x{k}_m": x, f"v{k}_m_s": v, f"tau{k}_Nm": tau}
    return states


def run_twin(setup: TwinSetup, stop: Callable[[], bool], say: Callable[[str], None]) -> int | None:
    """Run the twin on its bus until `stop` says so. Raises BusError when the bus is lost.

    Returns how many frames were lost because they were not read in time (None: the bus cannot tell).
    """
    hosted = twin(setup)
    link = open_link(setup.bus)
    try:
        with kept_ready(setup.process, say):
            DeviceHost(link, *hosted).run(stop)
    finally:
        link.close()
    return link.dropped


def twin(setup: TwinSetup) -> HostedDevices:
    """The virtual axes, the virtual I/O and the simulation behind them."""
    model = setup.model
    warm_up(model, setup.twin, setup.cycle_s)
    ports = (MotorPort(), MotorPort())
    line = Line(model, ports)
    devices = [Device(load_eds(node.eds, node.node_id), node.node_id, setup.clock) for node in setup.virtual_axes]
    drives = [SimulatedDrive(device, port) for device, port in zip(devices, ports, strict=True)]
    io_node = setup.virtual_io
    io_device = Device(load_eds(io_node.eds, io_node.node_id), io_node.node_id, setup.clock)
    virtual_io = VirtualIo(
        io_device, strain_prev=model.upstream_strain, tension_next_N=model.boundary.downstream_tension_N
    )
    application = TwinApplication(setup, line, ports, drives, io_device, virtual_io)

    def on_nmt(state: NmtState) -> None:
        if state is NmtState.INITIALISING:
            application.reset()
        elif state is NmtState.OPERATIONAL:
            application.start()

    io_device.on_nmt = on_nmt
    return HostedDevices([*devices, io_device], setup.clock, application)


def warm_up(model: ModelParameters, config: EstimationConfig, cycle_s: float) -> None:
    """Compile (or load) what a cycle runs on scratch objects, so that it is over before the devices boot."""
    ports = (MotorPort(), MotorPort())
    line = Line(model, ports)
    tracking = Tracking(model, config, line, ports[1], cycle_s)
    for k in range(_WARM_UP_CYCLES):
        tracking.compare(k * cycle_s, 0.0, 0.0, 0.1 + 0.01 * (k % 7), model.upstream_strain, 0.0)
        line.step(cycle_s)
