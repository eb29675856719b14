"""The participants of a bench as process data: set points out, measurements in, each cycle."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain
from math import isclose
from typing import Any, Final

from hilbench.can.frame import Frame
from hilbench.can.load import CyclicFrame
from hilbench.canopen.identifiers import EMERGENCY, HEARTBEAT, LAST_NODE, SYNC, NmtCommand, NmtState
from hilbench.canopen.master import Master
from hilbench.canopen.pdo import PdoMap
from hilbench.cia402 import objects
from hilbench.cia402.axis import emergency_axis
from hilbench.cia402.configuration import DriveSettings
from hilbench.cia402.drive import Drive
from hilbench.cia402.state_machine import Command, State, decode_statusword
from hilbench.compiled import interpreted
from hilbench.errors import BenchFaultError
from hilbench.exchange.addressing import IoMaps, declared_units, dictionary_of, drive_settings
from hilbench.exchange.answers import Tpdo
from hilbench.exchange.effect_objects import effect_place
from hilbench.exchange.emergencies import Emergency, EmergencyInbox
from hilbench.exchange.measured import OF_DRIVE, Measured, ShownBy, twin_age_cycles
from hilbench.exchange.sync_cycle import ExpectedPdo
from hilbench.exchange.unexpected_senders import Unexpected, UnexpectedSenders
from hilbench.topology.config import BenchConfig
from hilbench.topology.parts import Part, Role
from hilbench.topology.sample import sample_type

#: Heartbeats that may stay away before a node counts as lost (lost frames are no lost node).
_HEARTBEATS_MISSED = 4
_HEARTBEAT_LOOK_CYCLES = 16
#: More cycles than are ever requested at once.
_LONG = 1 << 30
#: Effects of the twin's model, and the step that their change caused: index and sub-index at the virtual I/O.
_TWIN_EFFECTS, _TWIN_STEP = (0x2102, 1), (0x2102, 2)
#: Model errors found by the twin: index and sub-index at the virtual I/O.
_TWIN_FOUND = (0x2103, 1)
_twin_age_cycles = interpreted(twin_age_cycles)
#: Controlwords that lead from SWITCH ON DISABLED to OPERATION ENABLED: shutdown, switch on, enable operation.
_ENABLE = (0x06, 0x07, 0x0F)
#: That of a drive that follows its set points.
_FOLLOWS: Final = Command.ENABLE_OPERATION.value


#: How a part of a bench is configured.
SettingsOf = Callable[[BenchConfig, Part], DriveSettings]
#: Like `map` or `Executor.map`: results in node order; the first failure in this order is raised.
ForEachNode = Callable[..., Iterator[Any]]


class Nodes:
    """The drives and the virtual I/O of one bench.

    `io`: what goes between bench and twin; None: all that the twin of this machine has. `settings_of`: how each drive
    is configured, and so which PDOs it has.
    """

    def __init__(
        self, config: BenchConfig, *, io: IoMaps | None = None, settings_of: SettingsOf = drive_settings
    ) -> None:
        self.config = config
        #: Name of the virtual I/O in messages and in `expected_pdos`.
        self.twin_name = f"virtual io (node {config.twin.node.node_id})"
        on_nodes = config.parts_by_node
        self._ods = {node_id: dictionary_of(there[0]) for node_id, there in on_nodes.items()}
        self.axes, self.load_motors, self.virtual_axes = (
            tuple(Drive(settings_of(config, part), self._ods[part.node.node_id]) for part in group)
            for group in map(config.parts_of, (Role.AXIS, Role.LOAD_MOTOR, Role.VIRTUAL_AXIS))
        )
        self.drives = (*self.axes, *self.load_motors)  #: the real (or simulated) drives: the axes, then the load motors
        self.io = io or IoMaps.of(config)
        self.boundary_names = tuple(signal.name for signal in self.io.data.boundary_inputs)
        self._boundary_values = [
            (pdo, tuple(signal.name for signal in content.signals))
            for pdo, content in zip(self.io.boundary, self.io.data.boundary, strict=True)
        ]
        self._rad_per_unit = [config.machine.motor_rad_per_unit(axis) for axis in range(1, len(self.axes) + 1)]
        # Of a velocity the machine's unit to motor rad, of a torque 1.
        factors = [1.0 if axis in config.shape.torqued else k for axis, k in enumerate(self._rad_per_unit, 1)]
        #: Each drive in the order of its RPDO, with the name of its set point and the factor into motor units.
        self.set_points = [
            *zip(self.axes, (part.name for part in config.parts_of(Role.AXIS)), factors, strict=True),
            *((drive, name, 1.0) for drive, name in zip(self.load_motors, config.load_motors, strict=True)),
        ]
        self._known = {node_id: " and ".join(part.label for part in there) for node_id, there in on_nodes.items()}
        self._simulated_axes = {
            (node_id, part.node_axis): part.label
            for node_id, there in on_nodes.items()
            for part in there
            if len(there) > 1 and part.is_simulated
        }
        self._master: Master | None = None
        self._shown_by = self._drive_signals()
        #: What drives and twin have answered.
        self.measured = Measured(
            sample_type(config.signals),
            self._shown_by,
            [[signal.name for signal in content.signals] for content in self.io.data.sent],
            self.io.data.torques,
        )
        self.fill = self.measured.fill
        self._status_cob_id = self.io.status.cob_id
        self._counted = self.measured.counted[0]
        self.twin_reported_cycle = 0  #: cycle, counted by `decode`, in which the twin last reported its status
        self._twin_ids = dict.fromkeys(config.virtual_nodes)  # in the order of the config
        self.twin_problem = ""  #: why the twin's nodes can't be counted on; "" while they can
        self.twin_alive = False  #: a heartbeat or boot-up of the virtual I/O has come since this was last reset
        self._inbox = EmergencyInbox()
        self.malformed = 0  #: frames with the COB-ID, but not the length, of a PDO that the bench reads
        self.answers = {
            pdo.cob_id: Tpdo(pdo.cob_id, pdo.size, pdo.period, self.sender(drive))
            for drive in self.drives
            for pdo in drive.pdos.tpdos
        }
        self._tpdos_of = [[self.answers[pdo.cob_id] for pdo in drive.pdos.tpdos] for drive in self.drives]
        self._in_time = (0,) * len(self._tpdos_of)
        #: Age in cycles of each drive's sample in use; 0 where it has answered this SYNC in time.
        self.ages_cycles = self._in_time
        self._twin_tpdos = [Tpdo(pdo.cob_id, pdo.size, pdo.period, self.twin_name) for pdo in self.io.tpdos]
        self.answers |= {pdo.cob_id: pdo for pdo in self._twin_tpdos}
        self._watch: UnexpectedSenders | None = None  # from when the master is known
        self.unexpected_frames: list[Unexpected] = []  #: of this cycle, neither the bench's nor its nodes'
        self._cycle = 0
        self._elapsed_cycles = 0
        self._heartbeat_cycle: dict[int, int] = {}
        self.supervised = 0  #: number of changes in the supervision of the twin
        self._silence_cycles = round(_HEARTBEATS_MISSED * config.master.node_heartbeat_ms * 1e-3 / config.cycle_time_s)
        self._expected_boots: set[int] = set()

    def _drive_signals(self) -> list[ShownBy]:
        """Signals that each drive fills, in the order of `drives`."""
        unit, ratios = self.config.machine.position_unit, self._rad_per_unit
        axes = [
            ShownBy(ratio, f"x{k}_{unit}", f"v{k}_{unit}_s", f"tau{k}_Nm", f"statusword{k}")
            for k, ratio in enumerate(ratios, 1)
        ]
        loads = [
            ShownBy(
                ratios[(part.axis or 1) - 1],
                f"x_{part.name}_{unit}",
                "",
                f"tau_{part.name}_Nm",
                f"statusword_{part.name}",
            )
            for part in self.config.parts_of(Role.LOAD_MOTOR)
        ]
        return axes + loads

    @property
    def twin_status(self) -> int:
        """Bits of `TwinStatus` as last reported; 0 while the twin is not supervised."""
        return int(self._counted["twin_status"])

    @property
    def filled(self) -> frozenset[str]:
        """The signals of the drives that `fill` puts into a sample."""
        return frozenset(name for shown in self._shown_by for name in shown.signals if name)

    @property
    def emergencies(self) -> Mapping[Emergency, int]:
        """EMCY messages of this cycle in order, with the count of each."""
        return self._inbox.messages

    def pdo_maps(self, part: str) -> list[PdoMap]:
        """The PDOs of a part that the bench maps, by its name."""
        of_parts = (*(drive.pdos.all for drive in (*self.drives, *self.virtual_axes)), self.io.all)
        names = [each.name for each in self.config.parts]
        return [*of_parts[names.index(part)]]

    # -- configuration -----------------------------------------------------------------------------------

    def introduce(self, master: Master) -> None:
        """Make all nodes known to the master."""
        self._master = master
        rpdos = {cob_id: self.sender(drive) for drive in self.drives for cob_id in drive.rpdo_cob_ids}
        rpdos |= {pdo.cob_id: self.twin_name for pdo in self.io.boundary}
        our_id = self.config.master.node_id
        self._watch = UnexpectedSenders(our_id, self._known, self._ods, rpdos, master.sent.take)
        for node_id, names in self._known.items():
            master.add(node_id, self._ods[node_id], names)

    def configure_drives(self, master: Master, for_each_node: ForEachNode = map) -> None:
        """Configure axes and load motors by SDO. Raises BenchFaultError naming node, object and reason."""
        for _ in for_each_node(lambda drive: drive.configure(master), self.drives):
            pass
        for part, drive in zip(self.config.parts_of(Role.AXIS), self.axes, strict=True):
            self._check_units(part, drive)

    def configure_twin(self, master: Master, for_each_node: ForEachNode = map) -> None:
        """Configure the virtual axes and the virtual I/O."""
        of_axes = (drive.configure for drive in self.virtual_axes)
        for _ in for_each_node(lambda configure: configure(master), (*of_axes, self._configure_io)):
            pass

    def _check_units(self, part: Part, drive: Drive) -> None:
        """Check that the device has the units of its EDS file, which the twin and the mirrored set points rely on."""
        declared = declared_units(part)
        for name in ("position_rad", "velocity_rad_s", "torque_Nm"):
            found, expected = getattr(drive.units, name), getattr(declared, name)
            if not isclose(found, expected, rel_tol=1e-6):
                raise BenchFaultError(
                    f"{self.sender(drive)}: one unit is {found:.6g} ({name}), "
                    f"expected {expected:.6g} as by its EDS file: give the true one in drives: {part.name}: units:"
                )

    def _configure_io(self, master: Master) -> None:
        node_id = self.config.twin.node.node_id
        for pdo in (*self.io.boundary, *self.io.tpdos):
            master.write_pdo(node_id, pdo)
        master.configure(node_id, {(0x1017, 0): self.config.master.node_heartbeat_ms})

    def restart_twin(self) -> None:
        """Reset the twin's nodes while the axes run, bring the virtual axes to where the axes are, start them (NMT).

        The virtual axes are enabled by SDO before they receive the axes' RPDOs, which ask for OPERATION ENABLED.
        Raises BenchFaultError naming the node that does not answer.
        """
        master, twin_nodes = self._sdo(), list(self._twin_ids)
        self._expected_boots = set(twin_nodes)
        # A twin that was held up first works off the SYNCs it has missed; the reset would be lost among them. A node
        # in NMT STOPPED answers no SDO request.
        for node_id in twin_nodes:
            wake = partial(master.nmt, NmtCommand.ENTER_PRE_OPERATIONAL, node_id)
            master.wait_for_answer([node_id], self.config.master.boot_timeout_s, wake)
        for node_id in twin_nodes:
            master.nmt(NmtCommand.RESET_NODE, node_id)
        master.wait_for_answer(twin_nodes, self.config.master.boot_timeout_s)
        self.configure_twin(master)
        for drive in self.virtual_axes:
            for command in _ENABLE:
                master.sdo_write(drive.settings.node_id, objects.CONTROLWORD, command)
        for node_id in twin_nodes:
            master.nmt(NmtCommand.START, node_id)
        # Set points and SYNC use another socket: an answer proves that the command arrived before them.
        master.wait_for_answer(twin_nodes, self.config.master.boot_timeout_s)

    def twin_is_away(self) -> None:
        """Stop relying on the twin until `twin_is_back`: its last status is not its state any more."""
        self._counted["twin_status"] = 0
        self._supervise_twin(False)
        self._expected_boots = set(self._twin_ids)
        self.twin_problem, self.twin_alive = "", False

    def twin_is_not_waited_for(self) -> None:
        """Stop supervising the twin while the drives are stopped: it may answer several SYNCs at once."""
        self._supervise_twin(False)

    def twin_is_back(self) -> None:
        """The twin's nodes were started: they are watched again from their first heartbeat as such."""
        self.twin_problem = ""
        self._supervise_twin(True)
        for node_id in self._twin_ids:
            self._heartbeat_cycle.pop(node_id, None)

    def _supervise_twin(self, supervised: bool) -> None:
        self.supervised += 1
        for tpdo in self._twin_tpdos:
            tpdo.supervise(supervised)

    def read_statusword(self, drive: Drive) -> int:
        """The statusword of a drive by SDO. Raises BenchFaultError when it does not answer."""
        settings = drive.settings
        return int(self._sdo().sdo_read(settings.node_id, settings.object(objects.STATUSWORD)))

    def use_synchronizer(self, method: int) -> None:
        """Switch the twin's synchronization method by its number (2101h); 0: the configured one."""
        self._sdo().sdo_write(self.config.twin.node.node_id, 0x2101, method, 1)

    def check_virtual_axes_enabled(self) -> None:
        """Raise BenchFaultError when a virtual axis did not follow its real axis into OPERATION ENABLED."""
        for drive in self.virtual_axes:
            statusword = self.read_statusword(drive)
            if decode_statusword(statusword) is not State.OPERATION_ENABLED:
                raise BenchFaultError(
                    f"{self.sender(drive)} did not follow its real axis: "
                    f"statusword {statusword:04X}h, expected OPERATION ENABLED"
                )

    @staticmethod
    def sender(drive: Drive) -> str:
        """Name and place of a drive, as in messages and `expected_pdos`."""
        return f"{drive.settings.name} ({drive.settings.place})"

    def expected_pdos(self, twin_since: int = 0) -> list[ExpectedPdo]:
        """The TPDOs that answer SYNC; `twin_since`: the SYNC before the twin was started."""
        of_drives = [ExpectedPdo(each.cob_id, each.every, each.sender, each.size) for each in chain(*self._tpdos_of)]
        return of_drives + [
            ExpectedPdo(each.cob_id, each.every, each.sender, each.size, twin_since, vital=False)
            for each in self._twin_tpdos
        ]

    def cyclic_frames(self) -> list[CyclicFrame]:
        """All frames of a cycle, for the bus load."""
        frames = [CyclicFrame("SYNC", SYNC, 0)]
        for drive in (*self.drives, *self.virtual_axes):
            name, pdos = drive.settings.name, drive.pdos
            if drive not in self.virtual_axes:
                frames += [CyclicFrame(f"{name} RPDO", cob_id, pdos.rpdo.size) for cob_id in drive.rpdo_cob_ids]
            frames += [CyclicFrame(f"{name} TPDO", pdo.cob_id, pdo.size, 1 / pdo.period) for pdo in pdos.tpdos]
        named = [(pdo.name, pdo) for pdo in self.io.tpdos]
        named += zip(("boundary", "stations", "further stations", "last stations"), self.io.boundary, strict=False)
        for name, pdo in named:
            frames.append(CyclicFrame(f"virtual io {name}", pdo.cob_id, pdo.size, 1 / pdo.period))
        periods_ms = [self.config.master.heartbeat_ms, *[self.config.master.node_heartbeat_ms] * len(self._known)]
        per_cycle = sum(1000.0 * self.config.cycle_time_s / period for period in periods_ms if period)
        return [*frames, CyclicFrame("heartbeats", HEARTBEAT + 1, 1, per_cycle)]

    # -- each cycle --------------------------------------------------------------------------------------

    def encode(self, outputs: Mapping[str, float]) -> list[Frame]:
        """Encode the RPDOs of this cycle, the twin's among them.

        `outputs`: by drive the velocity of the axis (the machine's unit per s) or the torque at the load motor's shaft
        (N·m), zero where there is none; by signal the boundary inputs of the twin.
        """
        frames: list[Frame] = []
        for drive, name, per_unit in self.set_points:
            drive.setpoint = outputs.get(name, 0.0) * per_unit
            frames += drive.encode()
        for pdo, names in self._boundary_values:
            frames.append(Frame(pdo.cob_id, pdo.pack([outputs[name] for name in names])))
        return frames

    def decode(self, frames: Sequence[Frame], before_sync: int = 0, elapsed_cycles: int = 0) -> None:
        """Decode the frames of a cycle, of which the first `before_sync` came before its SYNC. `elapsed_cycles`: number
        of our SYNCs on the bus without a cycle, in all. Raises BenchFaultError when a drive has a
        fault, has left OPERATIONAL, or is silent; the twin's nodes only get a `twin_problem`."""
        self._cycle += 1
        self._inbox.clear()
        data = self._answers(frames, before_sync, elapsed_cycles - self._elapsed_cycles)
        self._elapsed_cycles = elapsed_cycles
        for can_id, content, _ in frames:
            if can_id in self.answers:
                continue
            data[can_id] = content
            if HEARTBEAT < can_id <= HEARTBEAT + LAST_NODE:
                self._heartbeat(can_id - HEARTBEAT, content)
            elif EMERGENCY < can_id <= EMERGENCY + LAST_NODE:
                self._emergency(can_id - EMERGENCY, content)
        if self._cycle % _HEARTBEAT_LOOK_CYCLES == 0:
            self._look_for_silent_nodes()
        measured: list[float] = []
        for drive in self.drives:
            shown = drive.decode(data)
            measured += (shown.position_rad, shown.velocity_rad_s, shown.torque_Nm, shown.statusword)
        self.measured.of_drives[:] = measured
        self._take_twin({pdo.cob_id: pdo.unpack(data[pdo.cob_id]) for pdo in self.io.tpdos if pdo.cob_id in data})

    def _take_twin(self, data: Mapping[int, Sequence[Any]]) -> None:
        """Take status, simulated and estimated signals of the twin from its answers to this SYNC."""
        measured = self.measured
        self._take_status(data.get(self._status_cob_id))
        for at, (pdo, part) in enumerate(zip(self.io.sent, measured.parts, strict=True)):
            content = data.get(pdo.cob_id)
            measured.came[at] = content is not None
            if content is not None:
                measured.virtual_io[part] = content
        measured.take_twin()

    def _take_status(self, status: Sequence[Any] | None) -> None:
        if status is not None:
            counted, _, self._counted["twin_status"] = status
            self._counted["twin_sync"] = counted - self._elapsed_cycles  # it has counted those, too
            self.twin_reported_cycle = self._cycle

    def _answers(self, frames: Sequence[Frame], before_sync: int, elapsed_cycles: int) -> dict[int, bytes]:
        """Answers to this SYNC by COB-ID; surplus frames are counted, and are in `unexpected_frames`."""
        tpdos = self.answers
        for tpdo in tpdos.values():
            tpdo.begin()
        other_syncs = elapsed_cycles
        for at, (can_id, content, _) in enumerate(frames):
            if can_id in tpdos:
                tpdos[can_id].add(content, before_sync=at < before_sync)
            elif can_id == SYNC:
                other_syncs += 1
        data: dict[int, bytes] = {}
        for cob_id, tpdo in tpdos.items():
            tpdo.end(other_syncs)
            self.malformed += tpdo.wrong_size
            if tpdo.data is not None:
                data[cob_id] = tpdo.data
        self.ages_cycles = tuple(max(tpdo.age_cycles for tpdo in of_drive) for of_drive in self._tpdos_of)
        self.unexpected_frames = self._watch.look(frames, tpdos.values()) if self._watch else []
        return data

    def foreign_among(self, frames: Sequence[Frame]) -> list[Unexpected]:
        """Foreign frames (neither the bench's nor its nodes') among frames that are not decoded."""
        return self._watch.look(frames, ()) if self._watch else []

    @property
    def axes_late(self) -> bool:
        """True if the positions of the axes are not those of this SYNC."""
        return self.ages_cycles is not self._in_time and any(self.ages_cycles[: len(self.axes)])

    def twin_age(self, syncs: int) -> int:
        """Age in cycles of the twin's last answer, `syncs` after the twin was started."""
        return _twin_age_cycles(syncs, int(self._counted["twin_sync"]))

    def twin_started(self, syncs: int) -> int:
        """The SYNC before that which the twin counts as its first, where its last answer was one to SYNC `syncs`."""
        return syncs - int(self._counted["twin_sync"])

    # -- cycles run by the fast path (`hilbench.in_process_cycle`) --------------------------------------------------

    @property
    def fits_fast_path(self) -> bool:
        """True if all drives are enabled and follow their set points, and all answers come regularly."""
        return all(drive.fits_fast_path for drive in self.drives) and all(
            tpdo.is_regular for tpdo in self.answers.values()
        )

    @property
    def follow(self) -> bool:
        """True if all drives are enabled, with a controlword that only makes them follow set points."""
        for drive in self.drives:  # as `all` it would take three times as long, in each cycle
            follows = drive.reached and drive.controlword == _FOLLOWS
            if not follows:
                return False
        return True

    def begin_fast_path(self) -> None:
        """Prepare cycles with answers to SYNC only: clear messages and ages."""
        self._inbox.clear()
        self.unexpected_frames = []
        self.ages_cycles = self._in_time

    def pass_fast_path(self, cycles: int, heartbeats: Iterable[tuple[int, int]], reported: int = 0) -> None:
        """Take `cycles` fast-path cycles, with the twin's status in `measured`: node ids with the cycle, from 1 on,
        of their last heartbeat, and that in which the twin has `reported` last (0: in none). Raises as `decode`."""
        before = self._cycle
        if reported:
            self.twin_reported_cycle = before + reported
        for node_id, at in heartbeats:
            self._cycle = before + at
            self._heartbeat(node_id, NmtState.OPERATIONAL.heartbeat)
        self._cycle = before + cycles
        if self._cycle // _HEARTBEAT_LOOK_CYCLES != before // _HEARTBEAT_LOOK_CYCLES:
            self._look_for_silent_nodes()

    @property
    def not_silent_cycles(self) -> int:
        """Cycles from now on in which no heartbeat time-out can expire, even without further heartbeats."""
        received = min(self._heartbeat_cycle.values(), default=self._cycle)
        return received + self._silence_cycles - self._cycle if self._silence_cycles else _LONG

    def end_fast_path(self, cycles: int) -> None:
        """Update the drives' feedback from `measured` after `cycles` fast-path cycles."""
        measured = self.measured.of_drives.reshape(-1, OF_DRIVE).tolist()
        for drive, of_drive in zip(self.drives, measured, strict=True):
            shown = drive.feedback
            shown.position_rad, shown.velocity_rad_s, shown.torque_Nm, statusword = of_drive
            shown.statusword = int(statusword)
        if self._watch is not None:
            self._watch.pass_over(cycles)

    def _heartbeat(self, node_id: int, content: bytes) -> None:
        name = self._known.get(node_id)
        if name is None or len(content) != 1:
            return
        state = content[0]
        if node_id == self.config.twin.node.node_id:
            self.twin_alive = True
        if state == NmtState.OPERATIONAL:
            self._heartbeat_cycle[node_id] = self._cycle
            self._expected_boots.discard(node_id)
        elif node_id not in self._expected_boots:
            booted = state == NmtState.INITIALISING
            what = "has restarted (boot-up)" if booted else f"has left OPERATIONAL (heartbeat {state:02X}h)"
            self._lost(node_id, f"{what} during the run")

    def _look_for_silent_nodes(self) -> None:
        for node_id, received in self._heartbeat_cycle.items():
            if 0 < self._silence_cycles < self._cycle - received and node_id not in self._expected_boots:
                silent_s = (self._cycle - received) * self.config.cycle_time_s
                self._lost(node_id, f"has sent no heartbeat for {silent_s:.2f} s")

    def _lost(self, node_id: int, what: str) -> None:
        text = f"{self._known[node_id]} (node {node_id}) {what}"
        if node_id not in self._twin_ids:
            raise BenchFaultError(text)
        self.twin_problem = text

    def _emergency(self, node_id: int, content: bytes) -> None:
        # What is in the manufacturer's bytes is known of our own drives.
        name = self._simulated_axes.get((node_id, emergency_axis(content)), self._known.get(node_id))
        if name is not None and not self._inbox.add(node_id, name, content):
            self.malformed += 1

    # -- effects in the simulated hardware ---------------------------------------------------------------

    def owns(self, path: str) -> bool:
        """True if a quantity is a parameter of an effect in the simulated hardware, which these nodes have."""
        return path.startswith("hardware.")

    def value(self, path: str) -> float:
        """Present value of one as the drive has it, read by SDO. Raises UnusableValueError."""
        return float(self._sdo().sdo_read(*effect_place(self.config, path)))

    def set(self, path: str, value: float) -> None:
        """Write another value by SDO. Raises UnusableValueError."""
        node_id, index, sub = effect_place(self.config, path)
        self._sdo().sdo_write(node_id, index, value, sub)

    def set_twin_effects(self, effects: str) -> None:
        """Change the effects in the twin's model (JSON; "": as configured). Raises BenchFaultError."""
        self._sdo().sdo_write(self.config.twin.node.node_id, _TWIN_EFFECTS[0], effects, _TWIN_EFFECTS[1])

    def twin_step_N(self) -> float:
        """Largest step of a simulated tension that the last change of the twin's effects has made, N."""
        return float(self._sdo().sdo_read(self.config.twin.node.node_id, *_TWIN_STEP))

    def twin_found(self) -> str:
        """Errors of its model that the twin has estimated (JSON, `hilbench.twin.estimated_errors`); "": none
        reported."""
        if _TWIN_FOUND[0] not in self._ods[self.config.twin.node.node_id]:
            return ""
        return str(self._sdo().sdo_read(self.config.twin.node.node_id, *_TWIN_FOUND))

    def _sdo(self) -> Master:
        assert self._master is not None, "configured before an experiment changes anything"
        return self._master
