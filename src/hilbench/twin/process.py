"""Twin process: virtual axes fed by mirrored RPDOs, the simulated machine with its estimator, the virtual I/O.

Its only link to the bench is the bus: it receives the real axes' TPDOs in addition to the commands.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from hilbench.can.frame import Frame
from hilbench.canopen.clock import Clock, SyncClock
from hilbench.canopen.device import Device, SdoAbort
from hilbench.canopen.host import HostedDevices
from hilbench.canopen.identifiers import NmtState
from hilbench.cia402.simulated import SimulatedDrive
from hilbench.cycle_program import CompiledStage, python_stage
from hilbench.estimation.web_line.config import KnownChangeConfig
from hilbench.exchange.addressing import declared_units, device_clock, dictionary_of
from hilbench.machine_kinds import machine_part
from hilbench.plant.motor_port import MotorMode
from hilbench.processes import log
from hilbench.real_time import ProcessSettings, right_behind
from hilbench.topology.blocks import TwinConfig
from hilbench.topology.config import BenchConfig
from hilbench.topology.parts import Role
from hilbench.twin import virtual_io
from hilbench.twin.axis_listener import AxisListener
from hilbench.twin.bus_clock import BusClock
from hilbench.twin.cycle_count_from_position import CycleCountFromPosition
from hilbench.twin.estimated_errors import as_text
from hilbench.twin.machines.kinds import boundary, new_machine, warm_up
from hilbench.twin.machines.machine import LOOK, MISSED, WENT_ON, InVectors, MachineVectors, Measured, VectorMachine
from hilbench.twin.model_switch import Make, ModelSwitcher, PendingModel, with_effects
from hilbench.twin.reports import Reports
from hilbench.twin.virtual_io import VirtualIo

_VALUE_TOO_HIGH, _INVALID_VALUE, _PRESENT_STATE = 0x06090031, 0x06090030, 0x08000022
#: SYNCs that an axis may leave unanswered and answer later.
_MOST_OWED = 100
#: Missed SYNCs in a row that the simulation catches up; after more the plant has to be found anew.
_MOST_SKIPPED = 100
#: Cycles after which it is checked anew whether the machine can be in vectors.
_LOOK_FOR_VECTORS = 64
#: Interval of checkpoints, to be restored should the SYNC period turn out to be another one, s.
_KEPT_S = 0.25
#: Speed at the motor from which on an axis needs a set point before the machine is released; longest wait for that.
_MOVES_RAD_S, _LONGEST_WAIT_S = 0.05, 0.1
#: Deviation of a simulated drive's loop gains from the model's, %.
_SIMULATED_LOOP_PCT = 0.2


class TwinApplication:
    """Cycle of the twin.

    At SYNC k its TPDOs carry the state simulated for t_k, with its SYNC number (2100h). It then waits for the
    measurements of the real axes at t_k, updates the estimator, and simulates to t_{k+1}. When a measurement has not
    come by the next SYNC the cycle is simulated without it, and counted in `missed`. When it is so late that further
    SYNCs are waiting, it reports its age, and catches up or holds, as configured.

    The machine is held while an axis has its power stage off, as holding brakes would hold it. A twin that is started
    on a running plant takes over the axes' motion and torque.
    """

    def __init__(
        self,
        config: BenchConfig,
        clock: Clock,
        machine: ModelSwitcher,
        drives: Sequence[SimulatedDrive],
        device: Device,
        virtual_io: VirtualIo,
        report: Callable[[str], None] = log,
    ) -> None:
        self.missed = 0
        self.malformed = 0  #: frames with the COB-ID, but not the length, of an axis' TPDO
        self.surplus = 0  #: TPDOs of an axis beyond the one that answers SYNC
        self.cycle_s = config.cycle_time_s  #: simulated time per SYNC
        self._model = config.machine
        self._hold_when_behind = config.twin.behind == "hold"
        self._machine = machine
        self._ports = machine.ports
        self.drives = drives  #: virtual axes
        self.device, self.io = device, virtual_io  #: of the virtual I/O, and the access to its objects
        #: Receivers of the real axes' TPDOs.
        self.listeners = [AxisListener(part, self.cycle_s) for part in config.parts_of(Role.AXIS)]
        self.listens_to = frozenset(listener.cob_id for listener in self.listeners)
        self._nothing: list[Measured | None] = [None] * len(self.listeners)
        self._measured = list(self._nothing)
        self._owed = [0] * len(self.listeners)  # SYNCs that the axis has not answered
        self._measured_before: list[Measured] | None = None  # while the machine waits to be released
        self._waited_s = 0.0  # for set points of moving axes
        self._was_held = False  # by a disabled drive, since the start
        self._reports = Reports(device, machine, self.cycle_s)
        self._pending = self._released = False
        self._sync_number = self._behind = 0
        self._time_s = self._kept_s = 0.0
        # In lockstep one SYNC is one cycle, however long it took.
        in_lockstep = isinstance(clock, SyncClock)
        self._clock = None if in_lockstep else BusClock(self.cycle_s, clock.now_ns, device, report)
        self._skipped = 0  # elapsed cycles of the axes by the clock, less the received SYNCs
        self._travels = CycleCountFromPosition(self._model, self.cycle_s)
        self._in_vectors: InVectors | None = None
        self.leaves_vectors = False  #: the vectors' state has to go on in objects
        virtual_io.on_method(self._use_method)
        virtual_io.on_found(lambda: as_text(machine.found()))
        virtual_io.on_model(self._use_model, lambda: machine.largest_steps)
        self._publish()

    def reset(self) -> None:
        """Reset to the initial assumptions (reset of the virtual I/O node)."""
        self._machine.reset()
        self._measured = list(self._nothing)
        self._owed = [0] * len(self._owed)
        self._measured_before = None
        self._reports.reset()
        self._pending = self._released = False
        self._travels.reset()
        self._time_s = 0.0
        self._publish()

    def start(self) -> None:
        """Start counting SYNCs (NMT start)."""
        self._sync_number, self._was_held = 0, False

    def before_sync(self, behind: int) -> None:
        """Handle a SYNC with `behind` more waiting: a pending cycle goes on without measurement."""
        if self._pending:
            self.missed += 1
            self._advance()
        # Later frames are late: taken as answers to this SYNC they would push the true ones to the next, for ever.
        self._measured = list(self._nothing)
        self._owed = [min(owed + 1, _MOST_OWED) for owed in self._owed]
        self._sync_number += 1
        self._behind = behind
        self._look_at_the_clock(behind)
        self.io.publish_status(self._sync_number, behind, self._status())

    def _look_at_the_clock(self, behind: int) -> None:
        """Track the SYNC period in real time, where the axes also go through cycles whose SYNC was missed."""
        if self._clock is None:
            return
        received = self._clock.sync_received(behind)
        if received.skipped and not received.were_apart:
            self._measured_before = None
        self._skipped = self._skipped + received.skipped if self._released else 0
        if received.apart is not received.were_apart:
            self._machine.freeze_adaptation(frozen=received.apart)
        if received.cycle_ns is not None:
            self._go_by(received.cycle_ns * 1e-9)
            self._clock.report_period(received.cycle_ns)
        elif received.were_apart and not received.apart:
            self._go_by(self.cycle_s)
        elif not received.apart and self._time_s - self._kept_s >= _KEPT_S:
            self._kept_s = self._time_s
            self._machine.keep()  # a checkpoint of the estimate

    @property
    def _apart(self) -> bool:
        """True if SYNC comes with another period than assumed."""
        return self._clock is not None and self._clock.apart

    def _go_by(self, cycle_s: float) -> None:
        """Set the cycle time after a change of the SYNC period."""
        self.cycle_s = cycle_s
        self._machine.set_cycle_time(cycle_s)
        self._reports.set_cycle_time(cycle_s)
        self._travels = CycleCountFromPosition(self._model, cycle_s)
        self._measured_before, self._skipped = None, 0

    def _catch_up(self) -> bool:
        """Simulate the cycles without SYNC before this one; False if no time has elapsed since the last one.

        Their number is the clock's; but a clock may jump, and with moving axes the travel is more reliable.
        """
        measured = self._complete()
        skipped, now = self._skipped, None if measured is None else [position for position, _ in measured]
        if skipped:
            if now is None:  # decided at the next measurement
                self._travels.update(None, 1)
                return True
            skipped = self._travels.gone(now, 1 + skipped) - 1
            self._skipped = 0
        self._travels.update(now, 1 + skipped)
        if 0 < skipped <= _MOST_SKIPPED:
            for _ in range(skipped):
                self._machine.miss()  # the next sample is not one cycle after the last
                self._machine.step(self.cycle_s)
                self._time_s += self.cycle_s
        return skipped >= 0

    def after_sync(self) -> None:
        """Update the drives after the TPDOs are sent; simulate as soon as the measurements are there."""
        for drive in self.drives:
            drive.sync(self.cycle_s)
        self._pending = True

    def on_frame(self, frame: Frame) -> None:
        """Take the real axes' TPDOs, one per SYNC: of two senders the first, as the bench does. The last awaited one
        starts the simulation of the cycle."""
        for axis, listener in enumerate(self.listeners):
            if frame.can_id == listener.cob_id:
                if len(frame.data) != listener.size:
                    self.malformed += 1
                    return
                if self._owed[axis] == 0:  # the bench receives it too, and reports it
                    self.surplus += 1
                    return
                self._owed[axis] -= 1
                self._measured[axis] = listener.decode(frame.data)
                if self._pending and None not in self._measured:
                    self._advance()
                return

    # -- cycles run by the fast path (`twin.in_arrays`) --------------------------------------------------

    @property
    def fits_fast_path(self) -> bool:
        """True if the machine advances with every SYNC, by the axes' measurements at it."""
        powered = all(port.mode is not MotorMode.OFF for port in self._ports) and max(self._owed) < _MOST_OWED
        in_step = not (self._behind or self._skipped or self._apart)
        return powered and in_step and self._released and not self._pending and self._time_s > 0.0

    @property
    def advances_by_clock(self) -> bool:
        """True if SYNCs are checked against the clock."""
        return self._clock is not None

    def awaits_measurements(self) -> None:
        """End the fast path in a cycle that awaits measurements: it goes on as the axes answer."""
        self.count_syncs()
        self._sync_number += 1
        self._measured = list(self._nothing)
        self._owed = [owed + 1 for owed in self._owed]
        self._pending = True

    def begin_in_vectors(self, vectors: MachineVectors) -> None:
        """Move the machine into these vectors until `end_in_vectors`; sets number and status of the next SYNC there."""
        self._behind, self.leaves_vectors, self._vectors = 0, False, vectors
        vectors.whole[vectors.number], vectors.whole[vectors.status] = (self._sync_number + 1) & 0xFFFF, self._status()
        machine = self._as_vectors
        self._in_vectors = _ByObjects(self) if machine is None else machine.in_vectors(vectors, self._go_on_from)

    @property
    def _as_vectors(self) -> VectorMachine | None:
        """The machine, if it may run in vectors from now on."""
        machine = self._machine.in_use
        if self._machine.only_plant is None or not isinstance(machine, VectorMachine):
            return None
        return machine if machine.runs_in_vectors else None

    def go_on_by_objects(self) -> int:
        """Run a cycle of a machine that is not in its vectors; returns the status of the last SYNC."""
        vectors, values = self._vectors, self._vectors.values
        for name, cell in self.io.boundary_cells.items():
            cell.value = values.item(vectors.boundary_places[name])
        measured = vectors.measured.tolist()
        self._compare(list(zip(measured[::4], measured[2::4], strict=True)))
        self._machine.listen()
        for port, set_point in zip(self._ports, vectors.asked.tolist(), strict=True):
            port.setpoint = set_point
        self._machine.step(self.cycle_s)
        vectors.shown.reshape(len(self._ports), -1)[:] = [port.feedback for port in self._ports]
        values[list(vectors.published)] = self._machine.published()
        status, vectors.whole[vectors.status] = int(vectors.whole[vectors.status]), self._status()
        vectors.whole[vectors.number] = (int(vectors.whole[vectors.number]) + 1) & 0xFFFF
        if not self._sync_number % _LOOK_FOR_VECTORS:
            self.leaves_vectors = self._as_vectors is not None
        return status

    @property
    def in_vectors(self) -> CompiledStage | None:
        """Compiled stage of a cycle, possibly replaced after an interpreted part; None while each cycle has one."""
        return self._in_vectors.piece if self._in_vectors is not None and self._reports.quiet else None

    def go_on_in_vectors(self) -> None:
        """Run one cycle in vectors."""
        assert self._in_vectors is not None, "begun"
        piece = self._in_vectors.piece
        code = piece.function(piece.argument, piece.table)
        if code != piece.continues or not self._reports.quiet:
            self._go_on_from(code)

    def _go_on_from(self, code: int) -> bool:
        """Run the interpreted rest of a cycle in vectors; True if the next ones may be fully compiled."""
        machine = self._in_vectors
        assert machine is not None, "begun"
        self.count_syncs()
        piece = machine.piece
        went = machine.go_on_from(code)
        self.count_syncs()
        if went == LOOK or (went != MISSED and not self._reports.quiet):
            self._reports.update()
            self.leaves_vectors = self._machine.in_use.refused
        # Reports have to be sent before the next SYNC.
        steady = not self.device.outbox and self._reports.quiet and not self.leaves_vectors
        return steady and went != LOOK and piece is machine.piece

    def count_syncs(self) -> None:
        """Count the cycles in vectors; call it at intervals, as their number has 16 bits."""
        if self._in_vectors is None:
            return
        syncs = (int(self._vectors.whole[self._vectors.number]) - 1 - self._sync_number) & 0xFFFF
        self._sync_number += syncs
        for _ in range(syncs):
            self._time_s += self.cycle_s

    def forget_vectors(self) -> None:
        """Move the machine back to its objects without a cycle run in the vectors."""
        if self._in_vectors is not None:
            self._in_vectors.give()
            self._in_vectors = None

    def end_in_vectors(self) -> None:
        """Move the machine back to its objects."""
        if self._in_vectors is not None:
            if not self._pending:
                self.count_syncs()
            outputs, vectors = self._in_vectors.give(), self._vectors
            status = int(vectors.whole[vectors.status]) if self._pending else outputs
            self.io.publish_status(self._sync_number, 0, status)
            self._in_vectors = None

    def tick(self, duration_s: float) -> None:
        """Run the virtual drives' state machines without SYNC."""
        for drive in self.drives:
            drive.sync(duration_s)
            drive.publish()

    def _advance(self) -> None:
        self._pending = False
        if self._behind and self._hold_when_behind:
            self._machine.miss()
            self._measured_before = None
        elif all(port.mode is not MotorMode.OFF for port in self._ports):
            if self._released or self._release():
                new = self._clock is None or self._catch_up()
                if new:  # else no time has elapsed since the last measurement
                    self._compare(self._complete())
                self._machine.listen()
                if new:
                    self._machine.step(self.cycle_s)
                    self._time_s += self.cycle_s
        else:
            self._released, self._was_held = False, True
            self._measured_before = None
            self._travels.reset()
        self._measured = list(self._nothing)
        for drive in self.drives:
            drive.publish()
        self._publish()

    def _complete(self) -> list[Measured] | None:
        """Measurements of all axes in this cycle, or None."""
        found = [measured for measured in self._measured if measured is not None]
        return found if len(found) == len(self._measured) else None

    def _release(self) -> bool:
        """Take over the axes from their first measurements in two successive cycles; True if both are there and
        coherent."""
        before, self._measured_before = self._measured_before, self._complete()
        measured = self._measured_before
        if before is None or measured is None or self._waits_for_set_points(before, measured):
            return False
        if not self._machine.release(before, measured, in_motion=not self._was_held):
            return False
        self._released = True
        self._time_s = self._waited_s = self._kept_s = 0.0
        return True

    def _waits_for_set_points(self, before: list[Measured], measured: list[Measured]) -> bool:
        """True while an axis moves whose virtual drive, just enabled, has no set point yet: it would brake. Limited in
        time: an axis may be driven externally."""
        travels = [now - then for (then, _), (now, _) in zip(before, measured, strict=True)]
        brakes = any(
            port.mode is MotorMode.VELOCITY and port.setpoint == 0.0 and abs(travel) > _MOVES_RAD_S * self.cycle_s
            for port, travel in zip(self._ports, travels, strict=True)
        )
        self._waited_s = self._waited_s + self.cycle_s if brakes else 0.0
        return brakes and self._waited_s <= _LONGEST_WAIT_S

    def _compare(self, measured: list[Measured] | None) -> None:
        if measured is None:
            self._machine.miss()
        elif self._machine.compare(self._time_s, measured):
            self._reports.update()

    def _use_method(self, number: int) -> None:
        """Switch to another method, from the present estimate (2101h)."""
        try:
            self._machine.use_method(number)
        except ValueError:
            raise SdoAbort(_VALUE_TOO_HIGH) from None

    def _use_model(self, effects: str) -> None:
        """Start a bumpless switch to a model with these effects (2102h)."""
        try:
            self._machine.change(effects)
        except ValueError:
            raise SdoAbort(_INVALID_VALUE) from None
        except RuntimeError:
            raise SdoAbort(_PRESENT_STATE) from None

    def _status(self) -> int:
        """Status bits of `TwinStatus` as int: enum flags take microseconds to combine."""
        machine, status = self._machine.in_use, 0
        if self._released:
            status |= virtual_io.RUNNING
            if machine.synchronized and not self._apart:
                status |= virtual_io.SYNCHRONIZED
        if machine.problem is not None:
            status |= virtual_io.HOLDING
        if self._behind > 0:
            status |= virtual_io.LATE
        if machine.refused:
            status |= virtual_io.TRANSFER_REFUSED
        if not machine.separable:
            status |= virtual_io.NOT_SEPARABLE
        if self._machine.changing:
            status |= virtual_io.MODEL_CHANGING
        if self._machine.changed:
            status |= virtual_io.MODEL_CHANGED
        return status

    def _publish(self) -> None:
        self.io.publish(self._machine.published())


class _ByObjects:
    """`InVectors` of a machine that stays objects, as while another model is tried."""

    def __init__(self, application: TwinApplication) -> None:
        self._application, self._status = application, 0
        self.piece = python_stage(partial(application._go_on_from, 0))

    def go_on_from(self, code: int) -> int:
        """Run the cycle."""
        self._status = self._application.go_on_by_objects()
        return WENT_ON

    def give(self) -> int:
        """Return the status of the last SYNC."""
        return self._status


def _beside(process: ProcessSettings) -> Callable[[Make], PendingModel]:
    """Executor that builds another machine in a background thread."""
    from concurrent.futures import ThreadPoolExecutor

    return ThreadPoolExecutor(1, "new-model", initializer=right_behind, initargs=(process.priority,)).submit


def twin_config(config: BenchConfig) -> TwinConfig:
    """Twin config, with probing-step evaluation if the bench makes probes."""
    twin = config.twin
    probes = any(control.probes.mode != "off" for control in config.tension_controls.values())
    if not probes or twin.known_change is not None:
        return twin
    alone, behind = config.shape.spans == 1, list(config.drives.values())[1]
    deviation_pct = _SIMULATED_LOOP_PCT if alone and behind.simulated else None
    return twin.model_copy(update={"known_change": KnownChangeConfig(loop_gain_deviation_pct=deviation_pct)})


def twin(config: BenchConfig, clock: Clock | None = None) -> HostedDevices:
    """Devices of the virtual axes and the virtual I/O, with the simulation that drives them; `clock`: time base of the
    devices, that of the config's pace unless given."""
    model, shape, cycle_s, of_twin = config.machine, config.shape, config.cycle_time_s, twin_config(config)
    clock, process = clock or device_clock(config), config.process_settings("twin")
    warm_up(model, of_twin, shape, cycle_s)
    parts = config.parts_of(Role.VIRTUAL_AXIS)
    hosted = (*parts, *config.parts_of(Role.VIRTUAL_IO))
    *devices, io_device = (Device(dictionary_of(part), part.node.node_id, clock) for part in hosted)
    virtual_io = VirtualIo(io_device, machine_part(model.kind, "topology").process_data(shape), boundary(model, shape))

    def make(effects: str) -> Make:
        changed = with_effects(model, effects)
        return lambda: new_machine(changed, of_twin, shape, cycle_s, virtual_io.boundary_inputs)

    beside = None
    if process is not None:
        beside = _beside(process)
        make("[]")  # the first validation of a model is slow
    machine = ModelSwitcher(make, cycle_s, beside)
    drives = [
        SimulatedDrive(device, port, declared_units(part))
        for device, port, part in zip(devices, machine.ports, parts, strict=True)
    ]
    application = TwinApplication(config, clock, machine, drives, io_device, virtual_io)

    def on_nmt(state: NmtState) -> None:
        if state is NmtState.INITIALISING:
            application.reset()
        elif state is NmtState.PRE_OPERATIONAL:  # after a reset the objects have the EDS file's values
            virtual_io.reset_boundary_inputs()
        elif state is NmtState.OPERATIONAL:
            application.start()

    io_device.on_nmt = on_nmt
    return HostedDevices([*devices, io_device], clock, application)
