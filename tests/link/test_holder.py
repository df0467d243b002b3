"""Which service holds a port, by the groups that the kernel names, and what ends it."""

import pytest

from ekf_companion.link.holder import Holder, service_of

USER = "0::/user.slice/user-1000.slice/user@1000.service"


@pytest.mark.parametrize(
    ("cgroups", "found"),
    [
        ("0::/system.slice/ekf-companion.service\n", ("ekf-companion.service", False)),
        (
            "0::/system.slice/system-ekf.slice/ekf-companion@front.service\n",
            ("ekf-companion@front.service", False),
        ),
        # A group of its own below the service's
        ("0::/system.slice/ekf-companion.service/payload\n", ("ekf-companion.service", False)),
        # Two hierarchies, as of older kernels
        (
            "4:memory:/\n1:name=systemd:/system.slice/mavlink-router.service\n0::/\n",
            ("mavlink-router.service", False),
        ),
        (f"{USER}/app.slice/ekf-companion.service\n", ("ekf-companion.service", True)),
        # A login, a terminal's window, a container, none
        ("0::/user.slice/user-1000.slice/session-3.scope\n", ("", False)),
        (f"{USER}/app.slice/vte-spawn-1.scope\n", ("", False)),
        (f"{USER}/init.scope\n", ("", False)),
        ("0::/system.slice/docker-1234.scope\n", ("", False)),
        ("0::/\n", ("", False)),
        ("", ("", False)),
    ],
)
def test_a_service_is_found_above_and_below_other_groups(cgroups, found):
    assert service_of(cgroups) == found


def test_what_systemd_runs_is_stopped_by_systemd():
    """It would start again what was only killed."""
    unit = "ekf-companion.service"
    assert Holder(pid=7, name="a").stop == "kill 7"
    assert Holder(pid=7, name="a", unit=unit).stop == f"sudo systemctl stop {unit}"
    stop = Holder(pid=7, name="a", unit=unit, is_users=True).stop
    assert stop == f"systemctl --user stop {unit}"
