"""Firmware, parameters and messages of a DataFlash log (.bin).

Source: ArduPilot libraries/AP_Logger/LogStructure.h (PARM, MSG).
"""

from __future__ import annotations

from ekf_companion.logs.dataflash_columns import boot_ns, names_of, parameters
from ekf_companion.logs.dataflash_tables import Columns
from ekf_companion.logs.onboard import MOST, Message, Onboard, clean, onboard
from ekf_companion.nav.arrays import Stamps


def text_of(tables: Columns, message_ns: Stamps) -> Onboard:
    """Return firmware, parameters and messages of the autopilot.

    Args:
        tables: By the name of the message.
        message_ns: Stamps of MSG rows that have none of their own.
    """
    rows = tables.get("MSG")
    if rows is None or "Message" not in names_of(rows) or rows["Message"].dtype.kind != "S":
        return onboard((), parameters(tables))
    own_ns = boot_ns(rows)
    stamps = (message_ns if own_ns is None else own_ns).tolist()
    stamps += [None] * (len(rows) - len(stamps))
    # ArduPilot's rows have no severity
    lines = [
        Message(t_ns, "", clean(text))
        for t_ns, text in zip(stamps, rows["Message"][:MOST].tolist(), strict=False)
    ]
    return onboard(lines, parameters(tables), left_out=max(len(rows) - MOST, 0))
