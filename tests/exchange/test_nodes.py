"""Set points in, measurements out: what the nodes of the shipped bench make of values and frames, without a bus."""

from __future__ import annotations

import pytest
from tests.bench.bench_nodes import nodes
from tests.bench.samples import sample_of_two_axes

from hilbench.can.frame import Frame
from hilbench.cia402.drive import DriveGoal
from hilbench.exchange.nodes import Nodes
from hilbench.topology.sample import CycleSample

ENABLED = 0x27  #: statusword of OPERATION ENABLED
RAD_PER_M = 5.0 / 0.2  #: motor shaft per metre of the web
OUTPUTS = {"axis1": 1.0, "axis2": 1.25, "load": 0.5, "strain_prev": 2.8e-4, "F_next_N": 70.0}


def answers(found: Nodes, **values: int) -> list[Frame]:
    """The TPDOs of enabled drives, by their names: torque, position and velocity of each are one number."""
    frames = []
    for part, value in values.items():
        motion, velocity = found.pdo_maps(part)[1:3] if part != "load" else (found.pdo_maps(part)[1], None)
        frames.append(Frame(motion.cob_id, motion.pack((ENABLED, value, value))))
        if velocity is not None:
            frames.append(Frame(velocity.cob_id, velocity.pack((value,))))
    return frames


def enabled() -> Nodes:
    found = nodes()
    for drive in found.drives:
        drive.request(DriveGoal.ENABLED)
    found.decode(answers(found, axis1=0, axis2=0, load=0))
    return found


def twin(found: Nodes, *, state: tuple[float, float], quality: tuple[float, float], sync: int) -> list[Frame]:
    io = found.io
    return [
        *(Frame(pdo.cob_id, pdo.pack(values)) for pdo, values in zip(io.sent, (state, quality), strict=True)),
        Frame(io.status.cob_id, io.status.pack((sync, 0, 3))),
    ]


def filled(found: Nodes) -> CycleSample:
    sample = sample_of_two_axes()
    found.fill(sample)
    return sample


def set_point(found: Nodes, part: str, frames: list[Frame]) -> float:
    """The last value of a drive's RPDO, in device units."""
    pdo = found.pdo_maps(part)[0]
    (data,) = [frame.data for frame in frames if frame.can_id == pdo.cob_id]
    return float(pdo.unpack(data)[-1])


def test_set_points_go_out_in_the_units_of_each_drive() -> None:
    found = enabled()
    frames = found.encode(OUTPUTS)
    one, two = found.axes
    (load,) = found.load_motors
    assert set_point(found, "axis1", frames) == pytest.approx(1.0 * RAD_PER_M / one.units.velocity_rad_s, abs=1)
    assert set_point(found, "axis2", frames) == pytest.approx(1.25 * RAD_PER_M / two.units.velocity_rad_s, abs=1)
    assert set_point(found, "load", frames) == pytest.approx(0.5 / load.units.torque_Nm, abs=1)
    (boundary,) = [frame.data for frame in frames if frame.can_id == found.io.boundary[0].cob_id]
    assert found.io.boundary[0].unpack(boundary) == pytest.approx((2.8e-4, 70.0))


def test_a_drive_without_a_set_point_gets_zero() -> None:
    found = enabled()
    found.encode(OUTPUTS)
    frames = found.encode({"strain_prev": 0.0, "F_next_N": 0.0})
    assert [set_point(found, part, frames) for part in ("axis1", "axis2", "load")] == [0.0, 0.0, 0.0]


def test_measurements_are_told_at_the_web_in_si() -> None:
    found = nodes()
    found.decode(answers(found, axis1=100, axis2=200, load=50))
    sample = filled(found)
    one, two = found.axes
    (load,) = found.load_motors
    assert sample.x1_m == pytest.approx(100 * one.units.position_rad / RAD_PER_M)
    assert sample.v2_m_s == pytest.approx(200 * two.units.velocity_rad_s / RAD_PER_M)
    assert sample.tau1_Nm == pytest.approx(100 * one.units.torque_Nm)
    assert sample.tau_load_Nm == pytest.approx(50 * load.units.torque_Nm)
    assert (sample.statusword1, sample.statusword2, sample.statusword_load) == (ENABLED, ENABLED, ENABLED)


def test_a_residual_is_that_of_the_torque_of_the_cycle_before() -> None:
    found = nodes()
    unit_Nm = found.axes[1].units.torque_Nm
    found.decode(answers(found, axis2=300))
    state, quality = (81.5, 8.8e9), (1e8, 0.125)
    found.decode([*answers(found, axis2=500), *twin(found, state=state, quality=quality, sync=2)])
    sample = filled(found)
    assert (sample.F_sim_N, sample.E_sim_Pa) == pytest.approx(state)
    assert (sample.E_sd_Pa, sample.tau2_residual_Nm) == pytest.approx(quality)
    assert sample.tau2_sim_Nm == pytest.approx(300 * unit_Nm - 0.125)
    assert sample.tau2_Nm == pytest.approx(500 * unit_Nm)
    assert sample.twin_status == 3


def test_a_sample_that_stays_away_stands_and_has_its_age() -> None:
    found = nodes()
    everyone = answers(found, axis1=1, axis2=1, load=1)
    found.decode(everyone)
    assert found.ages_cycles == (0, 0, 0)
    without_axis2 = answers(found, axis1=2, load=2)
    found.decode(without_axis2)
    found.decode(without_axis2)
    assert found.ages_cycles == (0, 2, 0)
    assert found.axes_late
    assert filled(found).x2_m == pytest.approx(found.axes[1].units.position_rad / RAD_PER_M)


def test_a_late_load_motor_makes_no_axis_late() -> None:
    found = nodes()
    found.decode(answers(found, axis1=1, axis2=1))
    assert found.ages_cycles[2] > 0
    assert not found.axes_late


@pytest.mark.parametrize(
    ("syncs", "reported", "age"), [(5, 5, 0), (8, 5, 3), (5, 6, 0), (65_537, 0, 1), (65_536 + 4, 65_535, 5)]
)
def test_the_age_of_the_twin_counts_on_where_16_bits_end(syncs: int, reported: int, age: int) -> None:
    found = nodes()
    found.decode(twin(found, state=(80.0, 8.7e9), quality=(1e8, 0.0), sync=reported))
    assert found.twin_age(syncs) == age
    assert found.twin_started(syncs) == syncs - reported


def test_a_twin_that_is_away_is_not_what_it_last_said() -> None:
    found = nodes()
    found.decode(twin(found, state=(80.0, 8.7e9), quality=(1e8, 0.0), sync=1))
    found.twin_is_away()
    assert found.twin_status == 0


def test_only_the_twins_answers_are_not_vital() -> None:
    found = nodes()
    expected = found.expected_pdos(twin_since=7)
    assert {pdo.sender for pdo in expected if pdo.vital} == {found.sender(drive) for drive in found.drives}
    assert {(pdo.sender, pdo.since) for pdo in expected if not pdo.vital} == {(found.twin_name, 7)}


def test_each_pdo_goes_over_the_bus_once_and_virtual_axes_hear_those_of_their_axes() -> None:
    found = nodes()
    frames = [frame for frame in found.cyclic_frames() if frame.name not in ("SYNC", "heartbeats")]
    ids = [frame.can_id for frame in frames]
    drives = ("axis1", "axis2", "load")
    mapped = {pdo.cob_id for part in (*drives, "virtual_io") for pdo in found.pdo_maps(part)}
    assert len(ids) == len(set(ids))
    assert set(ids) == mapped
