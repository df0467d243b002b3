"""``python -m ekf_companion``: the commands."""

from ekf_companion.cli import app

app()
