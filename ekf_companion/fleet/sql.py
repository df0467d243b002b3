"""Questions in SQL, by DuckDB: ``logs``, ``events`` and ``histograms`` are its tables."""

from __future__ import annotations

import re
from collections.abc import Callable
from decimal import Decimal
from typing import Any

from ekf_companion.errors import ConfigError, part_of
from ekf_companion.fleet.dataset import TABLES
from ekf_companion.fleet.questions import Answer


def run(query: str, load: Callable[[str], Any]) -> Answer:
    """Return the answer; ``load`` is called for each table that is named.

    The query sees these tables and nothing else: no file, no network, no extension.

    Raises:
        ConfigError: The query is wrong.
        MissingPackageError: DuckDB is not installed.
    """
    with part_of("fleet", "sql"):
        import duckdb
    settings = {"autoinstall_known_extensions": False, "autoload_known_extensions": False}
    with duckdb.connect(":memory:", config=settings) as database:
        for name in TABLES:
            if re.search(rf"\b{name}\b", query, re.IGNORECASE):
                database.register(f"_{name}", load(name))
                database.execute(f"CREATE TABLE {name} AS SELECT * FROM _{name}")
                database.unregister(f"_{name}")
        database.execute("SET enable_external_access = false")
        database.execute("SET lock_configuration = true")
        try:
            answer = database.execute(query)
            if answer.description is None:
                raise ConfigError("sql: the query has no answer; begin with SELECT")
            columns = [str(one[0]) for one in answer.description]
            return Answer(columns, [[*map(_plain, row)] for row in answer.fetchall()])
        except duckdb.Error as error:
            raise ConfigError(f"sql: {error}") from None


def _plain(value: Any) -> Any:
    """Return a value as JSON has it; what it does not know as text."""
    if value is None or isinstance(value, (str, int, float, list)):
        return value
    return float(value) if isinstance(value, Decimal) else str(value)
