"""The devices at work: their clocks, how they fit together, and that pieces of any length read the same."""

from __future__ import annotations

from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ur5_twin.arm.parameters import ArmModel, load_model
from ur5_twin.recording import Recording, Table
from ur5_twin.sensing import Load, Measuring, SensorSuite, Signals, load_sensors
from ur5_twin.sensing.specs import Clock

PERIOD, STEP = 0.008, 0.002
ROWS = 4
LOAD = Load(0.3, np.array([0.0, 0.0, 0.08]), np.diag([1e-3, 1e-3, 5e-4]))
Q = np.array([-0.7, -1.6, -1.7, 0.3, 1.1, 0.4])


@pytest.fixture(scope="module")
def model() -> ArmModel:
    """An arm with both sensors."""
    return load_model("plant", "both")


def swinging(ticks: int, *, still_from: float = np.inf) -> Signals:
    """All joints swing at 3 rad/s about Q, until a time; pushes swing too."""
    time = np.arange(ticks * ROWS) * STEP
    moving = (time < still_from)[:, None]
    wave = 3.0 * np.minimum(time, still_from)[:, None] + np.arange(6)
    push = 20.0 * np.sin(7.0 * time[:, None] + np.arange(6))
    return Signals(
        time,
        Q + 0.2 * np.sin(wave),
        0.6 * np.cos(wave) * moving,
        -1.8 * np.sin(wave) * moving,
        np.sin(5.0 * time[:, None] + np.arange(6)),
        push,
    )


def pieces(signals: Signals, cuts: list[int]) -> list[Signals]:
    """Signals cut before ticks."""
    edges = [0, *sorted(set(cuts)), len(signals.time) // ROWS]
    return [
        Signals(**{f.name: getattr(signals, f.name)[ROWS * a : ROWS * b] for f in fields(Signals)})
        for a, b in pairwise(edges)
    ]


def measured(
    suite: SensorSuite, model: ArmModel, signals: Signals, *, cuts: list[int] | None = None, seed: int = 0
) -> Recording:
    """What devices report of signals that come in pieces."""
    measuring = Measuring(suite, model, np.random.default_rng(seed), period=PERIOD)
    rows: dict[str, list[dict[str, np.ndarray]]] = {}
    tick = 0
    for piece in pieces(signals, cuts or []):
        rows.setdefault("robot", []).append(measuring.robot(piece, tick, ROWS))
        for device, columns in measuring.sensors(piece, LOAD).items():
            rows.setdefault(device, []).append(columns)
        tick += len(piece.time) // ROWS
    tables = {}
    for device, parts in rows.items():
        columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        tables[device] = Table(device, columns.pop("time"), columns, measuring.host_start[device])
    return Recording(tables, "made", "twin")


def assert_same_bits(one: Recording, other: Recording) -> None:
    assert one.tables.keys() == other.tables.keys()
    for device, table in one.tables.items():
        np.testing.assert_array_equal(table.time, other.tables[device].time, err_msg=device)
        for name, values in table.columns.items():
            np.testing.assert_array_equal(values, other.tables[device][name], err_msg=f"{device}.{name}")


@pytest.mark.parametrize("preset", ["lab", "ideal"])
@settings(deadline=None, max_examples=15)
@given(cuts=st.lists(st.integers(1, 59), max_size=12))
def test_cut_anywhere_all_devices_read_the_same_bits(preset: str, model: ArmModel, cuts: list[int]) -> None:
    suite = load_sensors(preset, late_packages=True)
    signals = swinging(60, still_from=0.3)
    assert_same_bits(measured(suite, model, signals, cuts=cuts), measured(suite, model, signals))


@pytest.mark.parametrize("rate", [100.0, 125.0, 207.76, 250.0, 500.0])
def test_one_tick_at_a_time_reads_the_same_bits(model: ArmModel, rate: float) -> None:
    """Also at rates whose samples fall on the last row of a piece, without jitter, where rounding could decide."""
    lab = load_sensors("lab", late_packages=True)
    for jitter in (0.0, 6e-5):
        # Offset less delay is whole steps of 2 ms in all but the lab's own.
        for offset, delay in ((0.0, 0.0), (0.006, 0.074), (0.1, 0.3), (0.0046, 0.075)):
            clock = Clock(rate, jitter, offset, 0.0)
            # Without noise and steps, which would hide a last bit.
            plain = replace(lab.ft, delay=delay, slow_noise=None, noise=None, gauges=None)
            suite = replace(lab, ft_clock=clock, ft=plain)
            signals = swinging(150, still_from=0.8)
            whole = measured(suite, model, signals)
            assert_same_bits(measured(suite, model, signals, cuts=list(range(1, 150))), whole)


def test_noise_is_its_seeds(model: ArmModel) -> None:
    lab, signals = load_sensors("lab"), swinging(50)
    one, same, other = (measured(lab, model, signals, seed=seed) for seed in (1, 1, 2))
    assert_same_bits(one, same)
    for device, name in (("robot", "actual_current"), ("ft", "ft_wrench"), ("imu", "imu_acc"), ("imu", "imu_mag")):
        n = min(len(one.tables[device]), len(other.tables[device]))
        assert (one.tables[device][name][:n] != other.tables[device][name][:n]).any()


def test_each_device_has_its_own_noise(model: ArmModel) -> None:
    """What a force sensor is like changes nothing in what robot and IMU report."""
    lab, signals = load_sensors("lab"), swinging(50)
    clock = replace(lab.ft_clock, rate=100.0, jitter=0.0)
    one, other = (measured(suite, model, signals) for suite in (lab, replace(lab, ft_clock=clock)))
    assert len(one.tables["ft"]) != len(other.tables["ft"])
    tables = {name: one.tables[name] for name in ("robot", "imu")}
    assert_same_bits(replace(one, tables=tables), replace(other, tables={n: other.tables[n] for n in tables}))


def test_what_the_arm_does_not_carry_reports_nothing() -> None:
    lab, signals = load_sensors("lab"), swinging(10)
    for tool, devices in (("none", set()), ("ati_gamma", {"ft"}), ("xsens_mti", {"imu"}), ("both", {"ft", "imu"})):
        found = measured(lab, load_model("plant", tool), signals)
        assert set(found.tables) == {"robot"} | devices


@pytest.fixture(scope="module")
def half_a_minute(model: ArmModel) -> Recording:
    return measured(load_sensors("lab"), model, swinging(3750))


def test_the_force_sensors_clock(half_a_minute: Recording) -> None:
    """207.66 rows a second that wander: each interval is off for itself, by the lab's spread."""
    ft = half_a_minute.tables["ft"]
    n = len(ft)
    rate = (n - 1) / (ft.time[-1] - ft.time[0])
    # n = 6200 intervals, each off by 0.092 ms, sum up to 7 ms in 30 s, 2.4e-4; four times that.
    assert rate == pytest.approx(207.66, rel=1e-3)
    off = np.diff(ft.time) - 1.0 / 207.66
    # As many know a standard deviation to 0.9 %; four times that.
    assert off.std() == pytest.approx(9.2e-5, rel=0.036)
    # Intervals that are independent correlate by 1 / sqrt(n) = 1.3 %; about an even grid it would be -0.5.
    assert abs(np.corrcoef(off[1:], off[:-1])[0, 1]) < 0.05


def test_every_reading_of_the_force_sensor_is_whole_counts_of_its_gauges(half_a_minute: Recording) -> None:
    gauges = load_sensors("lab").ft.gauges
    assert gauges is not None
    counts = half_a_minute.tables["ft"]["ft_wrench"] @ np.linalg.inv(gauges).T
    # Some 50,000 counts at most, rounding of a solution with a condition of some 500.
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-7)


def test_a_quiet_force_sensor_repeats_itself_and_a_pushed_one_does_not(model: ArmModel) -> None:
    """The lab's share at rest is 13 to 22 % (docs/sensors.md), and none while somebody pushes."""
    still = np.zeros((1000 * ROWS, 6))
    quiet = Signals(np.arange(len(still)) * STEP, still + Q, still, still, still, still)
    pushed = replace(quiet, wrench=5.0 * np.sin(7.0 * quiet.time[:, None] + np.arange(6)))
    share = []
    for signals in (quiet, pushed):
        ft = measured(load_sensors("lab"), model, signals).tables["ft"]
        # Before the delay is over it reads the first row.
        values = ft["ft_wrench"][ft.time > 0.1]
        share.append((np.diff(values, axis=0) == 0).all(axis=1).mean())
    assert 0.10 < share[0] < 0.25
    assert share[1] == 0.0


def test_jitter_is_bounded_however_large(model: ArmModel) -> None:
    lab = load_sensors("lab")
    wild = replace(lab, ft_clock=replace(lab.ft_clock, jitter=0.01))
    off = np.diff(measured(wild, model, swinging(500)).tables["ft"].time) * 207.66 - 1.0
    # Rounding beside the bound of 0.4 of a period.
    assert np.abs(off).max() <= 0.4 + 1e-9


def test_imu_stamps_are_whole_milliseconds(half_a_minute: Recording) -> None:
    time = half_a_minute.tables["imu"].time
    # Rounding of a product with 0.001.
    np.testing.assert_allclose(time * 1e3, np.round(time * 1e3), atol=1e-9)
    assert (np.diff(time) > 0).all()
    # Stamps are off by half a millisecond at most in 30 s.
    assert (len(time) - 1) / (time[-1] - time[0]) == pytest.approx(266.27, rel=5e-5)


@pytest.mark.parametrize(("offset_ft", "offset_imu"), [(0.0046, 0.006), (-0.02, 0.35)])
def test_host_stamps_put_the_devices_on_the_robots_clock(model: ArmModel, offset_ft: float, offset_imu: float) -> None:
    """Aligned by them ideal devices read the truth of that instant, whatever the zero of their clocks."""
    ideal = load_sensors("ideal")
    suite = replace(
        ideal,
        ft_clock=replace(ideal.ft_clock, offset=offset_ft),
        imu_clock=replace(ideal.imu_clock, offset=offset_imu, stamp_step=0.001),
    )
    signals = swinging(200)
    aligned = measured(suite, model, signals).aligned()
    # Their samples at the robot's very ticks, without a clock of their own.
    ticks = Clock(1.0 / PERIOD, 0.0, 0.0, 0.0)
    truth = measured(replace(ideal, ft_clock=ticks, imu_clock=ticks), model, signals)
    for device, name, slope in (("ft", "ft_wrench", 240.0), ("imu", "imu_gyro", 10.0)):
        known = np.all(np.isfinite(aligned[name]), axis=1)
        # All but the beginning before the clock's zero and the end after its last sample.
        assert known.sum() >= 200 - (max(0.0, offset_imu) + PERIOD) / PERIOD - 2
        expected = truth.tables[device][name]
        error = np.abs(aligned[name][: len(expected)] - expected)[known[: len(expected)]]
        # Chords over 4.8 ms, and stamps rounded by half a millisecond: a millisecond's change (pushes of 20 N and load
        # of 0.3 kg at 7 rad/s; six joints' rates of 0.6 rad/s at 3 rad/s).
        assert error.max() < 1e-3 * slope
        # A sample of misalignment would be seen.
        span = np.abs(np.diff(expected, axis=0)).max()
        assert error.max() < 0.5 * span


def test_the_force_sensor_is_late_by_its_delay(model: ArmModel) -> None:
    """Shifted back by it the lab's delay leaves no more than a chord's error and the low-pass' own lag."""
    ideal = load_sensors("ideal")
    late = replace(ideal, ft=replace(ideal.ft, delay=0.075))
    signals = swinging(300)
    found = measured(late, model, signals).tables["ft"]
    truth = measured(ideal, model, signals).tables["ft"]
    # What it reads of the time after the truth's last sample is unknown.
    inside = (found.time > 0.08) & (found.time - 0.075 < truth.time[-1])
    at = found.time[inside]
    expected = np.stack([np.interp(at - 0.075, truth.time, column) for column in truth["ft_wrench"].T], axis=1)
    # Chords over a sample of 4.8 ms of a sine of 7 rad/s and 20 N: 20 (7 * 0.0048)^2 / 8 = 3 mN, twice, and the load's.
    np.testing.assert_allclose(found["ft_wrench"][inside], expected, atol=0.01)


def test_at_rest_the_imu_reads_gravity_and_the_earths_field(model: ArmModel) -> None:
    ideal = load_sensors("ideal")
    still = np.zeros((80, 6))
    signals = Signals(np.arange(80) * STEP, still + Q, still, still, still, still)
    imu = measured(ideal, model, signals).tables["imu"]
    np.testing.assert_allclose(np.linalg.norm(imu["imu_acc"], axis=1), 9.82, rtol=1e-12)
    np.testing.assert_array_equal(imu["imu_gyro"], 0.0)
    np.testing.assert_allclose(np.linalg.norm(imu["imu_mag"], axis=1), np.linalg.norm(ideal.earth_field), rtol=1e-12)


def test_the_robots_own_signals(model: ArmModel) -> None:
    """At the ticks, in steps, the current with more noise where a joint moves than where it rests."""
    lab = load_sensors("lab")
    signals = swinging(6000, still_from=24.0)
    robot = measured(lab, model, signals).robot
    np.testing.assert_array_equal(robot.time, np.arange(6000) * PERIOD)
    for name, truth, channel in (("actual_q", signals.q, lab.position), ("actual_qd", signals.qd, lab.velocity)):
        assert channel.step is not None
        # Rounding to half a step, and float rounding beside it.
        assert (np.abs(robot[name] - truth[::ROWS]) <= 0.5 * channel.step + 1e-12).all()
    assert lab.current.noise is not None
    noise = robot["actual_current"] - signals.current[::ROWS]
    # 3000 rows know a standard deviation to 1.3 %; of the coloured noise about 2.5 %: four times that. A joint that
    # swings is slower than the noise's threshold for 1 % of the time.
    np.testing.assert_allclose(noise[3000:].std(axis=0), lab.current.noise, rtol=0.055)
    both = np.hypot(lab.current.noise, lab.current_moving)
    np.testing.assert_allclose(noise[:3000].std(axis=0), both, rtol=0.1)


def test_late_packages_come_with_the_next_while_the_arm_moves(model: ArmModel) -> None:
    suite = load_sensors("ideal", late_packages=True)
    signals = swinging(90, still_from=0.4)
    robot = measured(suite, model, signals).robot
    sent = robot["timestamp"][:, 0]
    np.testing.assert_array_equal(sent, np.arange(90) * PERIOD)
    delay = robot.time - sent
    moving = np.arange(90) < 50
    third = np.arange(90) % 3 == 2
    # Rounding of sums of a period and of a millisecond.
    np.testing.assert_allclose(delay[moving & third], PERIOD, atol=1e-12)
    np.testing.assert_allclose(delay[moving & (np.arange(90) % 3 == 0)][1:], 0.001, atol=1e-12)
    np.testing.assert_allclose(delay[moving & (np.arange(90) % 3 == 1)], 0.0, atol=1e-12)
    np.testing.assert_array_equal(delay[51:], 0.0)


@pytest.mark.parametrize("ticks", range(9, 15))
def test_no_two_packages_arrive_at_once(model: ArmModel, ticks: int) -> None:
    """Also where the arm comes to rest between a late package and the next."""
    suite = load_sensors("ideal", late_packages=True)
    for cuts in ([], list(range(1, 30))):
        robot = measured(suite, model, swinging(30, still_from=ticks * PERIOD), cuts=cuts).robot
        assert (np.diff(robot.time) > 0).all()


def test_without_late_packages_there_is_no_second_stamp(model: ArmModel) -> None:
    assert "timestamp" not in measured(load_sensors("lab"), model, swinging(5)).robot
