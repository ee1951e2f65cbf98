"""Real instruments: missed and repeated strikes, which attempt counts, supply and climate.

Rows of an older catalogue keep what is known of them: nothing was repeated then, so every record counts.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"

_MEASURED = (
    "voltage_v", "voltage_min_v", "voltage_max_v", "current_a", "current_min_a", "current_max_a",
    "charge_coulomb", "unknown_s",
)  # fmt: skip


def upgrade() -> None:
    """Add missed and repeated strikes, the outcome of shots, and table ``environment``.

    Older rows get 0 missed, 0 repeated and "accepted".
    """
    op.add_column("sets", sa.Column("n_missed", sa.Integer(), nullable=False, server_default="0"))
    op.add_column("sets", sa.Column("n_restrikes", sa.Integer(), nullable=False, server_default="0"))
    op.add_column("shots", sa.Column("outcome", sa.String(), nullable=False, server_default="accepted"))
    op.create_table(
        "environment",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("set_index", sa.Integer(), nullable=False),
        sa.Column("due_h", sa.Float(), nullable=False),
        sa.Column("supply_state", sa.String(), nullable=False),
        sa.Column("supply_quality", sa.String(), nullable=False),
        sa.Column("supply_age_s", sa.Float(), nullable=True),
        sa.Column("supply_tripped", sa.String(), nullable=True),
        *(sa.Column(name, sa.Float(), nullable=True) for name in _MEASURED),
        sa.Column("climate_quality", sa.String(), nullable=False),
        sa.Column("climate_age_s", sa.Float(), nullable=True),
        sa.Column("temperature_c", sa.Float(), nullable=True),
        sa.Column("relative_humidity", sa.Float(), nullable=True),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_environment")),
        sa.UniqueConstraint("set_index", name=op.f("uq_environment_set_index")),
    )
