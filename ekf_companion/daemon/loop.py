"""The loop of a service, and what becomes of a bug in it."""

from __future__ import annotations

import asyncio
import logging
import sys
from collections.abc import Coroutine
from typing import Any

from ekf_companion.errors import CompanionError

if sys.version_info < (3, 11):
    from exceptiongroup import BaseExceptionGroup

_log = logging.getLogger(__name__)


def run_loop(main: Coroutine[Any, Any, None]) -> None:
    """Run a service to its end.

    Raises:
        CompanionError: What it raises on purpose, or a bug; its traceback is in the log then.
    """
    try:
        asyncio.run(main)
    except Exception as error:  # noqa: BLE001  # the one place; systemd restarts us
        cause: BaseException = error
        # A task group wraps what its tasks raise
        while isinstance(cause, BaseExceptionGroup):
            cause = cause.exceptions[0]
        if isinstance(cause, CompanionError):
            raise cause from None
        _log.exception("Ended by a bug")
        raise CompanionError(
            f"ended by a bug ({type(cause).__name__}); the traceback is above: please report it"
        ) from None
