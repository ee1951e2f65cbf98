"""First catalogue: experiment, measurements, assessments, alarms, events, commands.

The schema of a released revision never changes: what changes later is a revision of its own.
"""

from __future__ import annotations

from pathlib import Path

from alembic import op

revision = "0001"
down_revision = None


def upgrade() -> None:
    """Create the tables of the first catalogue from the SQL file next to this one."""
    for statement in Path(__file__).with_suffix(".sql").read_text(encoding="utf-8").split(";\n")[:-1]:
        op.execute(statement)
