"""Columns of limits and statistics by name for baselines and assessments, and of the control chart."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"

NESTED = (
    *(("baselines", name) for name in ("limits", "readiness")),
    *(("verdicts", name) for name in ("statistics", "limits", "averages")),
)


def upgrade() -> None:
    """Add limits and statistics by name as JSON, and the control chart's value and alarm.

    All are NULL in older rows.
    """
    for table, name in NESTED:
        op.add_column(table, sa.Column(name, sa.JSON(none_as_null=True), nullable=True))
    op.add_column("verdicts", sa.Column("chart", sa.Float(), nullable=True))
    op.add_column("verdicts", sa.Column("chart_alarm", sa.Boolean(), nullable=True))
