"""An experiment as a generator: `sample = yield` is one cycle, what is set then acts in the next one."""


def creep_down(bench):
    """Slow down until the tension rises by more than 2 N, or the line creeps; then stop."""
    sample = yield
    speed_m_s = sample.v2_cmd_m_s
    while speed_m_s > 0.5 and sample.F_sim_N < sample.F_ref_N + 2.0:
        speed_m_s -= 1.0 * bench.config.cycle_time_s  # 1 m/s²
        bench.set("line_speed_m_s", speed_m_s)
        sample = yield
    assert sample.v2_m_s > 0.4, "the line stands still"
