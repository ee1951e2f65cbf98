"""Tables of the catalogue (SQLAlchemy Core), the one description of its columns.

Times are integer nanoseconds of UTC, values SI with the unit in the name. A NULL number means "not
available", never zero. `events` is append-only and its ids are ordered: it is the bus between
recorder and web service.
"""

from __future__ import annotations

from sqlalchemy import (
    JSON,
    BigInteger,
    Boolean,
    Column,
    Float,
    ForeignKey,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    UniqueConstraint,
)

metadata = MetaData(
    naming_convention={
        "ix": "ix_%(column_0_label)s",
        "uq": "uq_%(table_name)s_%(column_0_name)s",
        "fk": "fk_%(table_name)s_%(column_0_name)s_%(referred_table_name)s",
        "pk": "pk_%(table_name)s",
    }
)

# None is SQL's NULL, not the JSON text "null": NOT NULL then means what it says.
_JSON = JSON(none_as_null=True)

# One row: which experiment this folder belongs to.
experiment = Table(
    "experiment",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("name", String, nullable=False),
    Column("configuration_hash", String(64), nullable=False),
    Column("configuration", _JSON, nullable=False),
    Column("created_utc_ns", BigInteger, nullable=False),
    Column("epoch_utc_ns", BigInteger, nullable=False),  # hour 0 of the experiment
    Column("clock", String, nullable=False),  # "simulated" or "wall"
    Column("solimon_version", String, nullable=False),
)

# One row a planned set and position: done, partial (every taken shot stored), missed, or retired.
sets = Table(
    "sets",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("set_index", Integer, nullable=False),
    Column("position", String, nullable=False),
    Column("method", String, nullable=False),  # "solitary_wave" or "pulse_echo"
    Column("due_utc_ns", BigInteger, nullable=False),
    Column("due_h", Float, nullable=False),  # hours since the epoch
    Column("started_utc_ns", BigInteger),
    Column("ended_utc_ns", BigInteger),
    Column("state", String, nullable=False),
    Column("cause", String),  # why it is partial or missed
    Column("n_planned", Integer, nullable=False),
    Column("n_taken", Integer, nullable=False),
    Column("n_valid", Integer, nullable=False),
    Column("n_missed", Integer, nullable=False, server_default="0"),  # strikes that left no record
    Column("n_restrikes", Integer, nullable=False, server_default="0"),  # repeated by the quality gate
    Column("file", String),  # relative to the data folder
    UniqueConstraint("position", "set_index", name="uq_sets_position_set_index"),
)

# One row a stored shot (a pulse-echo record is a shot too).
shots = Table(
    "shots",
    metadata,
    Column("sequence", Integer, primary_key=True),
    Column("set_index", Integer, nullable=False),
    Column("position", String, nullable=False),
    Column("shot_index", Integer, nullable=False),
    Column("attempt", Integer, nullable=False),
    Column("utc_ns", BigInteger, nullable=False),
    Column("mono_ns", BigInteger, nullable=False),
    Column("boot_id", String, nullable=False),
    Column("crc32", BigInteger, nullable=False),
    Column("valid", Boolean, nullable=False),
    Column("flags", _JSON, nullable=False),  # list of str: clipped, missed, no_psw, noisy, ...
    # "accepted", or "superseded" by a repetition of the same shot
    Column("outcome", String, nullable=False, server_default="accepted"),
    UniqueConstraint(
        "position", "set_index", "shot_index", "attempt", name="uq_shots_position_set_index_shot_index"
    ),
)

# Solitary-wave features. shot_index NULL: the set's feature, the mean of its valid shots.
features = Table(
    "features",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("set_index", Integer, nullable=False),
    Column("position", String, nullable=False),
    Column("shot_index", Integer),
    Column("sequence", Integer, ForeignKey("shots.sequence")),
    Column("due_h", Float, nullable=False),
    Column("extractor_version", String, nullable=False),
    Column("quality", String, nullable=False),  # "good", "suspect" or "bad"
    Column("n_valid", Integer, nullable=False),
    # The paper's five, in the order of the Mahalanobis vector.
    Column("tof_pp_s", Float),
    Column("tof_ac_s", Float),
    Column("amplitude_ratio", Float),
    Column("autocorrelation_coefficient", Float),
    Column("psw_area_v_s", Float),
    # What else is read off the record.
    Column("tof_mf_s", Float),
    Column("isw_amplitude_v", Float),
    Column("psw_amplitude_v", Float),
    Column("ssw_amplitude_v", Float),
    Column("isw_time_s", Float),
    Column("psw_time_s", Float),
    Column("ssw_time_s", Float),
    Column("isw_fwhm_s", Float),
    Column("psw_isw_area_ratio", Float),
    Column("noise_rms_v", Float),
)
Index(
    "ix_features_position_set_index_shot_index",
    features.c.position,
    features.c.set_index,
    features.c.shot_index,
)
# One feature a set, and the trend of a position without reading past its shots.
Index(
    "uq_features_set",
    features.c.position,
    features.c.set_index,
    unique=True,
    sqlite_where=features.c.shot_index.is_(None),
    postgresql_where=features.c.shot_index.is_(None),
)

# Pulse-echo results, one row a set.
thickness = Table(
    "thickness",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("set_index", Integer, nullable=False),
    Column("position", String, nullable=False),
    Column("sequence", Integer, ForeignKey("shots.sequence")),
    Column("due_h", Float, nullable=False),
    Column("extractor_version", String, nullable=False),
    Column("quality", String, nullable=False),
    Column("travel_time_s", Float),
    Column("thickness_m", Float),
    Column("thickness_loss_m", Float),
    Column("correlation_coefficient", Float),
    UniqueConstraint("position", "set_index", name="uq_thickness_position_set_index"),
)

# What supply and climate probe said around a set: one row a set, NULL where nothing was heard.
environment = Table(
    "environment",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("set_index", Integer, nullable=False, unique=True),
    Column("due_h", Float, nullable=False),
    Column("supply_state", String, nullable=False),  # "on", "off", "unknown", or "absent"
    Column("supply_quality", String, nullable=False),  # "good", "stale" or "lost"; "absent"
    Column("supply_age_s", Float),  # since the newest reading, when the row was written
    Column("supply_tripped", String),  # why the interlock is open; NULL: it is closed
    Column("voltage_v", Float),  # means over the readings since the last set
    Column("voltage_min_v", Float),
    Column("voltage_max_v", Float),
    Column("current_a", Float),
    Column("current_min_a", Float),
    Column("current_max_a", Float),
    Column("charge_coulomb", Float),  # since hour 0, measured current only
    Column("unknown_s", Float),  # since hour 0: time whose current nobody measured
    Column("climate_quality", String, nullable=False),
    Column("climate_age_s", Float),
    Column("temperature_c", Float),
    Column("relative_humidity", Float),  # 0 to 1
)

# A frozen baseline; it is never updated, a new one gets a new id.
baselines = Table(
    "baselines",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("name", String, nullable=False, unique=True),
    Column("position", String, nullable=False),
    Column("created_utc_ns", BigInteger, nullable=False),
    Column("first_set_index", Integer, nullable=False),
    Column("last_set_index", Integer, nullable=False),
    Column("n_sets", Integer, nullable=False),
    Column("feature_names", _JSON, nullable=False),
    Column("mean", _JSON, nullable=False),  # (p,)
    Column("covariance", _JSON, nullable=False),  # (p, p)
    Column("limit_f", Float),
    Column("limit_paper", Float),
    Column("limit_reason", String),  # why a limit is NULL
    Column("approval", String, nullable=False),  # "automatic" or the name of who signed
    Column("provenance", _JSON, nullable=False),  # set ids, suspects, extractor, versions
)

# One row a judged set.
verdicts = Table(
    "verdicts",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("set_index", Integer, nullable=False),
    Column("position", String, nullable=False),
    Column("due_h", Float, nullable=False),
    Column("baseline_id", Integer, ForeignKey("baselines.id")),
    Column("in_baseline", Boolean, nullable=False),
    Column("distance_squared", Float),
    Column("limit_name", String, nullable=False),  # the one that decides: "f_predictive" or "paper_mean_3sd"
    Column("limit_f", Float),
    Column("limit_paper", Float),
    Column("outlier", Boolean),  # NULL: not judged, see reason
    Column("outlier_paper", Boolean),
    Column("reason", String),
    Column("contributions", _JSON),  # {feature: part of distance_squared}
    UniqueConstraint("position", "set_index", name="uq_verdicts_position_set_index"),
)

# Alarms (ISA-18.2 states); every change is an event too.
alarms = Table(
    "alarms",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("position", String),  # NULL: the service itself
    Column("kind", String, nullable=False),  # "wall_change", "hole", "thickness", "no_data", ...
    Column("family", String, nullable=False),  # "damage" or "device"
    Column("severity", String, nullable=False),  # "low", "medium", "high", "critical"
    Column("state", String, nullable=False),  # see alarms.py
    Column("raised_utc_ns", BigInteger, nullable=False),
    Column("raised_h", Float, nullable=False),
    Column("raised_set_index", Integer),
    Column("changed_utc_ns", BigInteger, nullable=False),
    Column("cleared_utc_ns", BigInteger),
    Column("acknowledged_utc_ns", BigInteger),
    Column("acknowledged_by", String),
    Column("note", String),
    Column("message", String, nullable=False),
    Column(
        "proof", JSON, nullable=False
    ),  # sets, features, baseline, limit, formula, contributions, versions
)
Index("ix_alarms_position_kind", alarms.c.position, alarms.c.kind)

events = Table(
    "events",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("utc_ns", BigInteger, nullable=False),  # experiment time
    Column("wall_utc_ns", BigInteger, nullable=False),  # when it was written
    Column(
        "topic", String, nullable=False
    ),  # "sets", "features", "thickness", "verdicts", "alarms", "environment", "service"
    Column("kind", String, nullable=False),  # "set_done", "alarm_raised", "recorder_started", "gap", ...
    Column("position", String),
    Column("set_index", Integer),
    Column("payload", _JSON, nullable=False),
    sqlite_autoincrement=True,  # ids are never used again, whatever is deleted
)

# Operator's orders: written by the web service, carried out and answered by the recorder.
commands = Table(
    "commands",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("wall_utc_ns", BigInteger, nullable=False),
    Column("author", String, nullable=False),
    Column("kind", String, nullable=False),  # "finish_now", "stop", "hold", "retire", ...
    Column("arguments", _JSON, nullable=False),
    Column("state", String, nullable=False),  # "pending", "done", "refused"
    Column("result", String),
    Column("finished_wall_utc_ns", BigInteger),
    sqlite_autoincrement=True,
)
