"""First catalogue: experiment, measurements, assessments, alarms, events, commands.

A released revision is never edited: what changes later is a revision of its own.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None

_FEATURES = (
    "tof_pp_s", "tof_ac_s", "amplitude_ratio", "autocorrelation_coefficient", "psw_area_v_s",
    "tof_mf_s", "isw_amplitude_v", "psw_amplitude_v", "ssw_amplitude_v", "isw_time_s", "psw_time_s",
    "ssw_time_s", "isw_fwhm_s", "psw_isw_area_ratio", "noise_rms_v",
)  # fmt: skip


def upgrade() -> None:
    op.create_table(
        "alarms",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("position", sa.String(), nullable=True),
        sa.Column("kind", sa.String(), nullable=False),
        sa.Column("family", sa.String(), nullable=False),
        sa.Column("severity", sa.String(), nullable=False),
        sa.Column("state", sa.String(), nullable=False),
        sa.Column("raised_utc_ns", sa.BigInteger(), nullable=False),
        sa.Column("raised_h", sa.Float(), nullable=False),
        sa.Column("raised_set_index", sa.Integer(), nullable=True),
        sa.Column("changed_utc_ns", sa.BigInteger(), nullable=False),
        sa.Column("cleared_utc_ns", sa.BigInteger(), nullable=True),
        sa.Column("acknowledged_utc_ns", sa.BigInteger(), nullable=True),
        sa.Column("acknowledged_by", sa.String(), nullable=True),
        sa.Column("note", sa.String(), nullable=True),
        sa.Column("message", sa.String(), nullable=False),
        sa.Column("proof", sa.JSON(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_alarms")),
    )
    op.create_index("ix_alarms_position_kind", "alarms", ["position", "kind"], unique=False)
    op.create_table(
        "baselines",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("position", sa.String(), nullable=False),
        sa.Column("created_utc_ns", sa.BigInteger(), nullable=False),
        sa.Column("first_set_index", sa.Integer(), nullable=False),
        sa.Column("last_set_index", sa.Integer(), nullable=False),
        sa.Column("n_sets", sa.Integer(), nullable=False),
        sa.Column("feature_names", sa.JSON(), nullable=False),
        sa.Column("mean", sa.JSON(), nullable=False),
        sa.Column("covariance", sa.JSON(), nullable=False),
        sa.Column("limit_f", sa.Float(), nullable=True),
        sa.Column("limit_paper", sa.Float(), nullable=True),
        sa.Column("limit_reason", sa.String(), nullable=True),
        sa.Column("approval", sa.String(), nullable=False),
        sa.Column("provenance", sa.JSON(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_baselines")),
        sa.UniqueConstraint("name", name=op.f("uq_baselines_name")),
    )
    op.create_table(
        "commands",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("wall_utc_ns", sa.BigInteger(), nullable=False),
        sa.Column("author", sa.String(), nullable=False),
        sa.Column("kind", sa.String(), nullable=False),
        sa.Column("arguments", sa.JSON(), nullable=False),
        sa.Column("state", sa.String(), nullable=False),
        sa.Column("result", sa.String(), nullable=True),
        sa.Column("finished_wall_utc_ns", sa.BigInteger(), nullable=True),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_commands")),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "events",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("utc_ns", sa.BigInteger(), nullable=False),
        sa.Column("wall_utc_ns", sa.BigInteger(), nullable=False),
        sa.Column("topic", sa.String(), nullable=False),
        sa.Column("kind", sa.String(), nullable=False),
        sa.Column("position", sa.String(), nullable=True),
        sa.Column("set_index", sa.Integer(), nullable=True),
        sa.Column("payload", sa.JSON(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_events")),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "experiment",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("configuration_hash", sa.String(length=64), nullable=False),
        sa.Column("configuration", sa.JSON(), nullable=False),
        sa.Column("created_utc_ns", sa.BigInteger(), nullable=False),
        sa.Column("epoch_utc_ns", sa.BigInteger(), nullable=False),
        sa.Column("clock", sa.String(), nullable=False),
        sa.Column("solimon_version", sa.String(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_experiment")),
    )
    op.create_table(
        "sets",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("set_index", sa.Integer(), nullable=False),
        sa.Column("position", sa.String(), nullable=False),
        sa.Column("method", sa.String(), nullable=False),
        sa.Column("due_utc_ns", sa.BigInteger(), nullable=False),
        sa.Column("due_h", sa.Float(), nullable=False),
        sa.Column("started_utc_ns", sa.BigInteger(), nullable=True),
        sa.Column("ended_utc_ns", sa.BigInteger(), nullable=True),
        sa.Column("state", sa.String(), nullable=False),
        sa.Column("cause", sa.String(), nullable=True),
        sa.Column("n_planned", sa.Integer(), nullable=False),
        sa.Column("n_taken", sa.Integer(), nullable=False),
        sa.Column("n_valid", sa.Integer(), nullable=False),
        sa.Column("file", sa.String(), nullable=True),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_sets")),
        sa.UniqueConstraint("position", "set_index", name="uq_sets_position_set_index"),
    )
    op.create_table(
        "shots",
        sa.Column("sequence", sa.Integer(), nullable=False),
        sa.Column("set_index", sa.Integer(), nullable=False),
        sa.Column("position", sa.String(), nullable=False),
        sa.Column("shot_index", sa.Integer(), nullable=False),
        sa.Column("attempt", sa.Integer(), nullable=False),
        sa.Column("utc_ns", sa.BigInteger(), nullable=False),
        sa.Column("mono_ns", sa.BigInteger(), nullable=False),
        sa.Column("boot_id", sa.String(), nullable=False),
        sa.Column("crc32", sa.BigInteger(), nullable=False),
        sa.Column("valid", sa.Boolean(), nullable=False),
        sa.Column("flags", sa.JSON(), nullable=False),
        sa.PrimaryKeyConstraint("sequence", name=op.f("pk_shots")),
        sa.UniqueConstraint(
            "position", "set_index", "shot_index", "attempt", name="uq_shots_position_set_index_shot_index"
        ),
    )
    op.create_table(
        "features",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("set_index", sa.Integer(), nullable=False),
        sa.Column("position", sa.String(), nullable=False),
        sa.Column("shot_index", sa.Integer(), nullable=True),
        sa.Column("sequence", sa.Integer(), nullable=True),
        sa.Column("due_h", sa.Float(), nullable=False),
        sa.Column("extractor_version", sa.String(), nullable=False),
        sa.Column("quality", sa.String(), nullable=False),
        sa.Column("n_valid", sa.Integer(), nullable=False),
        *(sa.Column(name, sa.Float(), nullable=True) for name in _FEATURES),
        sa.ForeignKeyConstraint(["sequence"], ["shots.sequence"], name=op.f("fk_features_sequence_shots")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_features")),
    )
    op.create_index(
        "ix_features_position_set_index_shot_index",
        "features",
        ["position", "set_index", "shot_index"],
        unique=False,
    )
    op.create_index(
        "uq_features_set",
        "features",
        ["position", "set_index"],
        unique=True,
        sqlite_where=sa.text("shot_index IS NULL"),
        postgresql_where=sa.text("shot_index IS NULL"),
    )
    op.create_table(
        "thickness",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("set_index", sa.Integer(), nullable=False),
        sa.Column("position", sa.String(), nullable=False),
        sa.Column("sequence", sa.Integer(), nullable=True),
        sa.Column("due_h", sa.Float(), nullable=False),
        sa.Column("extractor_version", sa.String(), nullable=False),
        sa.Column("quality", sa.String(), nullable=False),
        sa.Column("travel_time_s", sa.Float(), nullable=True),
        sa.Column("thickness_m", sa.Float(), nullable=True),
        sa.Column("thickness_loss_m", sa.Float(), nullable=True),
        sa.Column("correlation_coefficient", sa.Float(), nullable=True),
        sa.ForeignKeyConstraint(["sequence"], ["shots.sequence"], name=op.f("fk_thickness_sequence_shots")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_thickness")),
        sa.UniqueConstraint("position", "set_index", name="uq_thickness_position_set_index"),
    )
    op.create_table(
        "verdicts",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("set_index", sa.Integer(), nullable=False),
        sa.Column("position", sa.String(), nullable=False),
        sa.Column("due_h", sa.Float(), nullable=False),
        sa.Column("baseline_id", sa.Integer(), nullable=True),
        sa.Column("in_baseline", sa.Boolean(), nullable=False),
        sa.Column("distance_squared", sa.Float(), nullable=True),
        sa.Column("limit_name", sa.String(), nullable=False),
        sa.Column("limit_f", sa.Float(), nullable=True),
        sa.Column("limit_paper", sa.Float(), nullable=True),
        sa.Column("outlier", sa.Boolean(), nullable=True),
        sa.Column("outlier_paper", sa.Boolean(), nullable=True),
        sa.Column("reason", sa.String(), nullable=True),
        sa.Column("contributions", sa.JSON(none_as_null=True), nullable=True),
        sa.ForeignKeyConstraint(
            ["baseline_id"], ["baselines.id"], name=op.f("fk_verdicts_baseline_id_baselines")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_verdicts")),
        sa.UniqueConstraint("position", "set_index", name="uq_verdicts_position_set_index"),
    )
