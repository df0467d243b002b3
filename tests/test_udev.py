"""Files for the neighbours of the daemon: the udev rule and the router's configuration."""

import configparser
import re

from tests.paths import ROOT

FOLDER = ROOT / "systemd"

# The udev rule: spelling and order, as udev(7) has them

MATCHES = {"ACTION", "SUBSYSTEM", "DRIVER", "TEST", "KERNEL"}
ASSIGNS = {"GOTO", "LABEL", "SYMLINK"}
ATTRIBUTES = {"idVendor", "idProduct", "power/control", "latency_timer"}
PROPERTIES = {
    "EKF_COMPANION",
    *("DEVTYPE", "ID_VENDOR_ID", "ID_MODEL_ID", "ID_SERIAL_SHORT", "ID_USB_INTERFACE_NUM"),
    *("ID_MM_DEVICE_IGNORE", "ID_MM_PORT_IGNORE"),
}
TERM = re.compile(r'([A-Z]+)(?:\{([^}]+)\})?(==|!=|\+=|=)"([^"]*)"')


def rule_lines():
    text = (FOLDER / "70-ekf-companion.rules").read_text()
    return [line for line in text.splitlines() if line and not line.startswith("#")]


def test_every_key_of_the_udev_rule_is_one():
    for line in rule_lines():
        terms = [TERM.fullmatch(term) for term in line.split(", ")]
        assert all(terms), line
        for key, attribute, operator, _ in (term.groups() for term in terms):
            if key == "ENV":
                assert attribute in PROPERTIES
            elif key == "ATTR":
                assert attribute in ATTRIBUTES
            elif key in MATCHES:
                assert operator in ("==", "!=")
            else:
                assert key in ASSIGNS
                assert operator == ("+=" if key == "SYMLINK" else "=")


def test_every_goto_of_the_udev_rule_leads_on():
    lines = rule_lines()
    labels = {line[7:-1]: number for number, line in enumerate(lines) if line.startswith("LABEL=")}
    for number, line in enumerate(lines):
        for label in re.findall(r'GOTO="(\w+)"', line):
            assert labels[label] > number
    assert len(labels) == 2


def test_the_devices_and_their_ports_are_those_of_the_same_makers():
    lines = rule_lines()
    devices = [
        line.replace("ATTR{idVendor}", "ENV{ID_VENDOR_ID}").replace(
            "ATTR{idProduct}", "ENV{ID_MODEL_ID}"
        )
        for line in lines
        if line.startswith("ATTR{idVendor}") and "autopilot" in line
    ]
    assert devices == [line for line in lines if line.startswith("ENV{ID_VENDOR_ID}")]


# The router beside us


def test_the_router_sends_us_everything_and_the_ground_no_odometry():
    parser = configparser.ConfigParser()
    parser.read(FOLDER / "mavlink-router.conf")
    assert parser["UartEndpoint autopilot"]["Baud"] == "921600"
    ours = parser["UdpEndpoint ekf-companion"]
    assert (ours["Mode"], ours["Address"], ours["Port"]) == ("Normal", "127.0.0.1", "14540")
    assert "BlockMsgIdOut" not in ours
    assert parser["UdpEndpoint ground"]["BlockMsgIdOut"] == "331"
