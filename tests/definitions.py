"""Write ``ekf_companion/mavlink/definitions.txt`` from pymavlink's dialect: ``make reference``.

The daemon needs a table of 50 kB of it, and not the 90 MB of all dialects.
"""

from __future__ import annotations

import re
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect
from pymavlink.dialects.v20 import development

from tests.paths import ROOT

PAGE = ROOT / "ekf_companion" / "mavlink" / "definitions.txt"
_HEAD = """\
# MAVLink messages of the dialect ardupilotmega, and a newer one; `make reference` writes this file.
# Id, name, CRC_EXTRA, then the fields in wire order: struct code (with an array's length), name."""
_EXTENSIONS = {"TIMESYNC": ["B target_system", "B target_component"]}
"""Extension fields that the definitions have gained since pymavlink was packaged."""
MISSING = {
    300: "PROTOCOL_VERSION 217 H version, H min_version, H max_version, 8B spec_version_hash, "
    "8B library_version_hash",
    396: "COMPONENT_INFORMATION_BASIC 50 Q capabilities, I time_boot_ms, I time_manufacture_s, "
    "32s vendor_name, 32s model_name, 24s software_version, 24s hardware_version, "
    "32s serial_number",
}
"""Messages of the common definitions that no packaged dialect has."""
NEWER = {number: development.mavlink_map[number] for number in (441, 513)}
"""Which others know beside that dialect, and only ``development`` has: GNSS_INTEGRITY, and
RANGING_BEACON, a range to an anchor."""


def definitions() -> str:
    """Return a line on each message, by id."""
    packaged = {**dialect.mavlink_map, **NEWER}
    known = {number: _line(one) for number, one in packaged.items()} | MISSING
    lines = (f"{number} {line}" for number, line in sorted(known.items()))
    return "\n".join((_HEAD, *lines)) + "\n"


def _line(definition: Any) -> str:
    kinds = re.findall(r"\d*[a-zA-Z]", definition.unpacker.format)
    names = definition.ordered_fieldnames
    fields = [f"{kind} {name}" for kind, name in zip(kinds, names, strict=True)]
    extensions = _EXTENSIONS.get(definition.msgname, [])
    fields += [one for one in extensions if one.split(" ")[1] not in names]
    return f"{definition.msgname} {definition.crc_extra} {', '.join(fields)}"


if __name__ == "__main__":
    PAGE.write_text(definitions(), encoding="utf-8")
