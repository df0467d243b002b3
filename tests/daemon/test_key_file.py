"""The secret's file, and the times that outlive a run."""

import os
import time

import pytest

from ekf_companion.config.config import describe_config, parse_config
from ekf_companion.daemon.key_file import borrow_signing, open_keyring, read_key
from ekf_companion.errors import ConfigError
from ekf_companion.mavlink.codec import Sender
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.signing import OLD, REPLAYED, Signing, time_of

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
        with pytest.raises(ConfigError, match="is no plain file"):
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


def test_no_file_is_no_keyring():
    assert open_keyring(config_of("")) is None


def test_times_outlive_a_run_rule_34(write, tmp_path):
    config = config_of(write(KEY), str(tmp_path / "checkpoint"))
    theirs = Sender(1, 1, open_keyring(config_of(write(KEY))).signing)
    now_ns = time.time_ns()
    (frame,) = Splitter().feed(theirs.message("HEARTBEAT", autopilot=3))
    keyring = open_keyring(config)
    assert keyring.signing.verify(frame, 0) == ""
    last = int.from_bytes(keyring.signing.sign(b"", now_ns)[-12:-6], "little")
    keyring.keep(now_ns)
    keyring.close()

    again = open_keyring(config)
    assert again.signing.verify(frame, 0) == REPLAYED
    assert int.from_bytes(again.signing.sign(b"", 0)[-12:-6], "little") > last
    again.close()
    assert KEY not in (tmp_path / "checkpoint.signing").read_bytes()


def test_it_is_kept_once_a_second_at_most_and_without_waiting(write, tmp_path):
    os.mkfifo(tmp_path / "checkpoint.signing.new")  # a disk that never answers
    keyring = open_keyring(config_of(write(KEY), str(tmp_path / "checkpoint")))
    begin = time.monotonic()
    for k in range(1000):
        keyring.keep(k * 10**9)
    assert time.monotonic() - begin < 0.2
    with (tmp_path / "checkpoint.signing.new").open("rb") as pipe:
        assert pipe.read().startswith(b"EKFSIGN1")
    keyring.close()


def test_the_times_of_another_secret_are_put_aside(write, tmp_path, caplog):
    (tmp_path / "checkpoint.signing").write_bytes(b"something else")
    keyring = open_keyring(config_of(write(KEY), str(tmp_path / "checkpoint")))
    keyring.close()
    assert (tmp_path / "checkpoint.signing.foreign").read_bytes() == b"something else"
    assert "it is now checkpoint.signing.foreign" in caplog.text
    assert open_keyring(config_of(write(KEY), str(tmp_path / "checkpoint"))) is not None


def test_who_borrows_the_secret_knows_the_times_writes_none_and_signs_a_stream_of_its_own(
    write, tmp_path
):
    """Rule 34."""
    now_ns = time.time_ns()
    config = config_of(write(KEY), str(tmp_path / "checkpoint"))
    heard = next(iter(Splitter().feed(Sender(1, 1, Signing(KEY)).frame("HEARTBEAT", b"", now_ns))))
    keyring = open_keyring(config)
    assert keyring.signing.verify(heard, now_ns) == ""
    ours = Sender(1, 194, keyring.signing).frame("HEARTBEAT", b"", now_ns + 3600 * 10**9)
    keyring.close()
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}

    signing = borrow_signing(config)
    assert signing.verify(heard, now_ns) == REPLAYED
    # An autopilot that has heard the daemon an hour ahead hears who borrows all the same
    theirs = Signing(KEY)
    again = Sender(1, 194, signing).frame("HEARTBEAT", b"", now_ns)
    for data in (ours, again, Sender(1, 194, keyring.signing).frame("HEARTBEAT", b"")):
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
    keyring = open_keyring(config)
    assert caplog.text.count("checkpoint.signing: is empty, as a loss of power leaves it") == 1
    assert keyring.signing.verify(old, 0) == ""  # nothing better is known
    keyring.close()

    caplog.clear()
    (tmp_path / "checkpoint.signing").write_bytes(b"")
    (tmp_path / "checkpoint.signing.copy").write_bytes(state_of(now_ns))
    keyring = open_keyring(config)
    assert keyring.signing.verify(old, 0) == OLD
    assert caplog.text == ""
    keyring.close()


def test_of_the_file_and_its_copy_the_later_times_count(write, tmp_path):
    config = config_of(write(KEY), str(tmp_path / "checkpoint"))
    now_ns = 1_800_000_000 * 10**9
    for later in ("checkpoint.signing", "checkpoint.signing.copy"):
        for name in ("checkpoint.signing", "checkpoint.signing.copy"):
            known_ns = now_ns + (10**9 if name == later else 0)
            (tmp_path / name).write_bytes(state_of(known_ns))
        keyring = open_keyring(config)
        time_now = int.from_bytes(keyring.signing.sign(b"", 0)[-12:-6], "little")
        assert time_now > time_of(now_ns + 10**9)
        keyring.close()


def test_a_copy_is_forced_to_the_disk_at_the_start_and_the_end_and_once_a_minute(
    write, tmp_path, monkeypatch
):
    forced, real = [], os.fdatasync
    monkeypatch.setattr(os, "fdatasync", lambda file: (forced.append(file.name), real(file)))
    keyring = open_keyring(config_of(write(KEY), str(tmp_path / "checkpoint")))
    path = tmp_path / "checkpoint.signing"

    def keep(k):
        path.unlink(missing_ok=True)
        keyring.signing.sign(b"", k * 10**9)
        keyring.keep(k * 10**9)
        end = time.monotonic() + 10.0
        while not path.exists():
            assert time.monotonic() < end
            time.sleep(0.001)

    for k in range(1, 6):
        keep(k)
    assert len(forced) == 1
    keyring._slot._forced_s -= 60.0
    for k in range(6, 11):
        keep(k)
    keyring.close()
    assert len(forced) == 3
    assert Signing(KEY).restore((tmp_path / "checkpoint.signing.copy").read_bytes())
    assert (tmp_path / "checkpoint.signing.copy").read_bytes() == path.read_bytes()
