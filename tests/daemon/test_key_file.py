"""The secret's file, and the times that outlive a run."""

import os
import time

import pytest

from ekf_companion.config.config import describe_config, parse_config
from ekf_companion.daemon import key_file
from ekf_companion.daemon.key_file import borrow_signing, open_signing, read_key
from ekf_companion.errors import ConfigError
from ekf_companion.mavlink.codec import Sender
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.signing import OLD, REPLAYED, Signing, time_of
from tests.daemon.waiting import close, wait_until

KEY = bytes(range(200, 232))


@pytest.fixture
def write(tmp_path):
    def write(data, mode=0o600, name="key"):
        path = tmp_path / name
        path.unlink(missing_ok=True)
        path.write_bytes(data)
        path.chmod(mode)
        return str(path)

    return write


@pytest.mark.parametrize("mode", [0o600, 0o400])
@pytest.mark.parametrize(
    "data", [KEY, KEY.hex().encode(), KEY.hex().upper().encode() + b"\n"], ids=["raw", "hex", "HEX"]
)
def test_a_secret_is_read(write, data, mode):
    assert read_key(write(data, mode)) == KEY


@pytest.mark.parametrize("size", [0, 31, 33, 63, 65, 66, 5000])
@pytest.mark.parametrize("letter", [b"a", b"g", b"\xff"])
def test_what_is_no_secret_is_a_sentence_that_does_not_say_it(write, size, letter):
    path = write(letter * size)
    with pytest.raises(ConfigError) as caught:
        read_key(path)
    assert str(caught.value) == (
        f"signing.key_file: {path}: holds no secret of 32 bytes or 64 hexadecimal digits; "
        "make one with openssl rand -hex 32"
    )
    assert caught.value.__cause__ is None


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o700, 0o644, 0o601])
def test_a_secret_that_others_may_use_is_refused(write, mode):
    path = write(KEY, mode)
    with pytest.raises(ConfigError, match=rf"{path}: has mode {mode:04o}, .*; chmod 600 {path}$"):
        read_key(path)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
def test_a_secret_of_another_user_is_refused(write):
    path = write(KEY)
    os.chown(path, 12345, -1)
    with pytest.raises(ConfigError, match=r"belongs to another user; chown 0 "):
        read_key(path)


def test_what_is_no_plain_file_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe", 0o600)
    for name in ("pipe", "."):
        with pytest.raises(ConfigError, match="is not a regular file"):
            read_key(str(tmp_path / name))
    with pytest.raises(ConfigError, match=r"No such file or directory; name a file of mode 0600"):
        read_key(str(tmp_path / "none"))


@pytest.mark.parametrize("mode", [0o400, 0o440])
def test_a_credential_of_systemd_is_read(write, tmp_path, monkeypatch, mode):
    """Of a service with a user of its own it is root's, with an access list: mode 0440."""
    path = write(KEY, mode, "signing")
    if mode == 0o440:
        with pytest.raises(ConfigError, match="has mode 0440"):
            read_key(path)
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path))
    assert read_key("${CREDENTIALS_DIRECTORY}/signing") == KEY
    assert read_key(path) == KEY


def config_of(key_file, checkpoint=""):
    return parse_config({"signing": {"key_file": key_file}, "checkpoint": {"file": checkpoint}}, "")


def test_no_file_is_no_state():
    assert open_signing(config_of("")) is None


def test_times_outlive_a_run_rule_34(write, tmp_path):
    config = config_of(write(KEY), str(tmp_path / "checkpoint"))
    theirs = Sender(1, 1, open_signing(config_of(write(KEY))).signing)
    now_ns = time.time_ns()
    (frame,) = Splitter().feed(theirs.message("HEARTBEAT", autopilot=3))
    state = open_signing(config)
    assert state.signing.verify(frame, 0) == ""
    last = int.from_bytes(state.signing.sign(b"", now_ns)[-12:-6], "little")
    state.write(now_ns)
    close(state)

    again = open_signing(config)
    assert again.signing.verify(frame, 0) == REPLAYED
    assert int.from_bytes(again.signing.sign(b"", 0)[-12:-6], "little") > last
    close(again)
    assert KEY not in (tmp_path / "checkpoint.signing").read_bytes()


def test_it_is_kept_once_a_second_at_most_and_without_waiting(write, tmp_path):
    os.mkfifo(tmp_path / "checkpoint.signing.new")  # a disk that never answers
    state = open_signing(config_of(write(KEY), str(tmp_path / "checkpoint")))
    for k in range(1000):
        state.write(k * 10**9)
    assert not (tmp_path / "checkpoint.signing").exists()
    with (tmp_path / "checkpoint.signing.new").open("rb") as pipe:
        assert pipe.read().startswith(b"EKFSIGN1")
    close(state)


def test_the_times_of_another_secret_are_put_aside(write, tmp_path, caplog):
    (tmp_path / "checkpoint.signing").write_bytes(b"something else")
    state = open_signing(config_of(write(KEY), str(tmp_path / "checkpoint")))
    close(state)
    assert (tmp_path / "checkpoint.signing.foreign").read_bytes() == b"something else"
    assert "renamed to checkpoint.signing.foreign" in caplog.text
    assert open_signing(config_of(write(KEY), str(tmp_path / "checkpoint"))) is not None


def test_who_borrows_the_secret_knows_the_times_writes_none_and_signs_a_stream_of_its_own(
    write, tmp_path
):
    """Rule 34."""
    now_ns = time.time_ns()
    config = config_of(write(KEY), str(tmp_path / "checkpoint"))
    heard = next(iter(Splitter().feed(Sender(1, 1, Signing(KEY)).frame("HEARTBEAT", b"", now_ns))))
    state = open_signing(config)
    assert state.signing.verify(heard, now_ns) == ""
    ours = Sender(1, 194, state.signing).frame("HEARTBEAT", b"", now_ns + 3600 * 10**9)
    close(state)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}

    signing = borrow_signing(config)
    assert signing.verify(heard, now_ns) == REPLAYED
    # An autopilot that has heard the daemon an hour ahead hears who borrows all the same
    theirs = Signing(KEY)
    again = Sender(1, 194, signing).frame("HEARTBEAT", b"", now_ns)
    for data in (ours, again, Sender(1, 194, state.signing).frame("HEARTBEAT", b"")):
        assert theirs.verify(next(iter(Splitter().feed(data))), now_ns) == ""
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_without_a_file_of_times_who_borrows_begins_from_the_clock(write, tmp_path):
    assert borrow_signing(config_of("")) is None
    signing = borrow_signing(config_of(write(KEY), str(tmp_path / "nowhere" / "checkpoint")))
    assert signing.verified == 0
    assert [path.name for path in tmp_path.iterdir()] == ["key"]


def test_the_printed_configuration_names_the_file_alone(write):
    path = write(KEY.hex().encode())
    words = repr(describe_config(config_of(path))) + repr(config_of(path))
    assert path in words
    assert KEY.hex() not in words


def state_of(time_ns):
    theirs = Signing(KEY)
    theirs.sign(b"", time_ns)
    return theirs.state()


def test_times_that_a_loss_of_power_took_are_told_and_the_copy_counts_rule_34(
    write, tmp_path, caplog
):
    """Rule 34: a board without a clock, whose file is empty, believes no frame of yesterday."""
    config = config_of(write(KEY), str(tmp_path / "checkpoint"))
    now_ns, day_ns = 1_800_000_000 * 10**9, 86_400 * 10**9
    (old,) = Splitter().feed(Sender(1, 1, Signing(KEY)).frame("HEARTBEAT", b"", now_ns - day_ns))
    (tmp_path / "checkpoint.signing").touch()
    state = open_signing(config)
    assert caplog.text.count("checkpoint.signing: is empty, as after a loss of power") == 1
    assert state.signing.verify(old, 0) == ""  # nothing better is known
    close(state)

    caplog.clear()
    (tmp_path / "checkpoint.signing").write_bytes(b"")
    (tmp_path / "checkpoint.signing.copy").write_bytes(state_of(now_ns))
    state = open_signing(config)
    assert state.signing.verify(old, 0) == OLD
    assert caplog.text == ""
    close(state)


def test_of_the_file_and_its_copy_the_later_times_count(write, tmp_path):
    config = config_of(write(KEY), str(tmp_path / "checkpoint"))
    now_ns = 1_800_000_000 * 10**9
    for later in ("checkpoint.signing", "checkpoint.signing.copy"):
        for name in ("checkpoint.signing", "checkpoint.signing.copy"):
            known_ns = now_ns + (10**9 if name == later else 0)
            (tmp_path / name).write_bytes(state_of(known_ns))
        state = open_signing(config)
        time_now = int.from_bytes(state.signing.sign(b"", 0)[-12:-6], "little")
        assert time_now > time_of(now_ns + 10**9)
        close(state)


@pytest.mark.parametrize("period", [60.0, 0.05])
def test_a_copy_is_synced_at_the_start_and_the_end_and_once_in_a_period(
    write, tmp_path, monkeypatch, period
):
    synced, real = [], os.fdatasync
    monkeypatch.setattr(os, "fdatasync", lambda file: (synced.append(file.name), real(file)))
    assert key_file.COPY_PERIOD == 60.0
    monkeypatch.setattr(key_file, "COPY_PERIOD", period)
    state = open_signing(config_of(write(KEY), str(tmp_path / "checkpoint")))
    path = tmp_path / "checkpoint.signing"
    number = 0

    def keep():
        nonlocal number
        number += 1
        path.unlink(missing_ok=True)
        state.signing.sign(b"", number * 10**9)
        state.write(number * 10**9)
        wait_until(path.exists)

    keep()
    wait_until(lambda: synced)
    if period < 1.0:
        wait_until(lambda: keep() or len(synced) > 3)
    for _ in range(5):
        keep()
    if period > 1.0:
        assert len(synced) == 1
    before = len(synced)
    close(state)
    assert len(synced) > before
    copy = (tmp_path / "checkpoint.signing.copy").read_bytes()
    assert Signing(KEY).restore(copy)
    assert copy == path.read_bytes()
    assert set(synced) == {str(tmp_path / "checkpoint.signing.copy.new")}
