"""Forecast of the wall thickness from solitary waves, and its most likely curve."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0019"
down_revision = "0018"


def upgrade() -> None:
    """Add the columns to the table ``wall``; earlier rows have none."""
    for name in ("forecast_h", "forecast_m", "forecast_low_m", "forecast_high_m"):
        op.add_column("wall", sa.Column(name, sa.Float()))
    op.add_column("wall", sa.Column("curve", sa.String()))
