"""The presets of the devices and the files of the user's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ur5_twin.errors import ModelError
from ur5_twin.resources import data_dir
from ur5_twin.sensing import load_sensors
from ur5_twin.sensing.specs import sensor_names


def shipped() -> str:
    return (data_dir("models") / "sensors.toml").read_text(encoding="utf-8")


def test_the_presets_by_name() -> None:
    assert sensor_names() == ("lab", "ideal")
    assert [load_sensors(name).name for name in sensor_names()] == ["lab", "ideal"]


def test_the_labs_numbers_come_in_si_units() -> None:
    suite = load_sensors("lab")
    assert suite.position.step is not None
    assert suite.current.step is not None
    assert suite.ft.noise is not None
    assert suite.acceleration.step is not None
    # 9.4 urad, 2.24 mA, 75 ms, -3.8 ms, 1 ms as docs/sensors.md has them; rounding of a product.
    assert suite.position.step[0] == pytest.approx(9.412e-6)
    assert suite.current.step[0] == pytest.approx(2.24182e-3)
    assert suite.ft.delay == pytest.approx(0.075)
    assert suite.ft_clock.offset == pytest.approx(-0.0038)
    assert suite.imu_clock.stamp_step == pytest.approx(0.001)
    assert suite.ft.noise.shape == (6,)
    # 16 bits over -50 to 50 m/s^2.
    np.testing.assert_allclose(suite.acceleration.step, 100.0 / 2**16)
    # The device's unit is about the earth's field, which the arm's steel changes by some tenths; it points down.
    assert np.linalg.norm(suite.earth_field) == pytest.approx(1.0, abs=0.3)
    assert suite.earth_field[2] < -0.5


def test_ideal_devices_have_the_labs_rates_and_no_fault() -> None:
    ideal, lab = load_sensors("ideal"), load_sensors("lab")
    assert ideal.ft_clock.rate == lab.ft_clock.rate
    assert ideal.imu_clock.rate == lab.imu_clock.rate
    for channel in (ideal.position, ideal.velocity, ideal.current, ideal.ft, ideal.acceleration, ideal.rate):
        assert channel.delay == 0.0
        assert [channel.bandwidth, channel.bias, channel.drift, channel.noise, channel.step] == [None] * 5
    assert not ideal.current_moving.any()
    np.testing.assert_array_equal(ideal.earth_field, lab.earth_field)


def test_every_device_says_where_its_numbers_are_from() -> None:
    for name in sensor_names():
        suite = load_sensors(name)
        assert set(suite.source) == {"encoders", "currents", "ft", "imu"}
        assert all(suite.source.values())


def test_late_packages_are_asked_for() -> None:
    assert not load_sensors("lab").late_packages
    assert load_sensors("lab", late_packages=True).late_packages
    assert load_sensors("ideal", late_packages=True).late_packages


def test_a_file_of_the_users(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(shipped().replace("[lab.", "[mine.").replace("delay_ms = 75.0", "delay_ms = 5.0"))
    suite = load_sensors(path)
    assert suite.name == "mine"
    assert suite.ft.delay == pytest.approx(0.005)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("rate_hz = 207.66", "rate_hz = 0.0", "force_torque.rate_hz"),
        ("slow_noise_hz = 20.0", "slow_noise_hz = 0.0", "force_torque.slow_noise_hz"),
        ("delay_ms = 75.0", "delay_ms = -1.0", "force_torque.delay_ms"),
        ("delay_ms = 75.0", "delay_ms = inf", "force_torque.delay_ms"),
        ("bits = 16", "bits = 1", "imu.bits"),
        ("bits = 16", "bites = 16", "bites"),
        ("full_scale = [130.0, 130.0, 400.0, 10.0, 10.0, 10.0]", "full_scale = [1.0]", "force_torque.full_scale"),
    ],
)
def test_a_wrong_value_is_named(tmp_path: Path, old: str, new: str, says: str) -> None:
    text = shipped().replace("[lab.", "[mine.")
    assert old in text
    path = tmp_path / "mine.toml"
    path.write_text(text.replace(old, new))
    with pytest.raises(ModelError) as error:
        load_sensors(path)
    assert says in str(error.value)
    assert "mine.toml" in str(error.value)


def test_an_unknown_preset_names_those_there_are() -> None:
    with pytest.raises(ModelError, match=r"lap.*lab.*ideal.*\.toml"):
        load_sensors("lap")
