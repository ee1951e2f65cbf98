-- Schema of the first catalogue: experiment, measurements, assessments, alarms, events, commands.
CREATE TABLE alarms (
    id INTEGER NOT NULL,
    position VARCHAR,
    kind VARCHAR NOT NULL,
    family VARCHAR NOT NULL,
    severity VARCHAR NOT NULL,
    state VARCHAR NOT NULL,
    raised_utc_ns BIGINT NOT NULL,
    raised_h FLOAT NOT NULL,
    raised_set_index INTEGER,
    changed_utc_ns BIGINT NOT NULL,
    cleared_utc_ns BIGINT,
    acknowledged_utc_ns BIGINT,
    acknowledged_by VARCHAR,
    note VARCHAR,
    message VARCHAR NOT NULL,
    proof JSON NOT NULL,
    CONSTRAINT pk_alarms PRIMARY KEY (id)
);

CREATE INDEX ix_alarms_position_kind ON alarms (position, kind);

CREATE TABLE baselines (
    id INTEGER NOT NULL,
    name VARCHAR NOT NULL,
    position VARCHAR NOT NULL,
    created_utc_ns BIGINT NOT NULL,
    first_set_index INTEGER NOT NULL,
    last_set_index INTEGER NOT NULL,
    n_sets INTEGER NOT NULL,
    feature_names JSON NOT NULL,
    mean JSON NOT NULL,
    covariance JSON NOT NULL,
    limit_f FLOAT,
    limit_paper FLOAT,
    limit_reason VARCHAR,
    approval VARCHAR NOT NULL,
    provenance JSON NOT NULL,
    CONSTRAINT pk_baselines PRIMARY KEY (id),
    CONSTRAINT uq_baselines_name UNIQUE (name)
);

CREATE TABLE commands (
    id INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT,
    wall_utc_ns BIGINT NOT NULL,
    author VARCHAR NOT NULL,
    kind VARCHAR NOT NULL,
    arguments JSON NOT NULL,
    state VARCHAR NOT NULL,
    result VARCHAR,
    finished_wall_utc_ns BIGINT
);

CREATE TABLE events (
    id INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT,
    utc_ns BIGINT NOT NULL,
    wall_utc_ns BIGINT NOT NULL,
    topic VARCHAR NOT NULL,
    kind VARCHAR NOT NULL,
    position VARCHAR,
    set_index INTEGER,
    payload JSON NOT NULL
);

CREATE TABLE experiment (
    id INTEGER NOT NULL,
    name VARCHAR NOT NULL,
    configuration_hash VARCHAR(64) NOT NULL,
    configuration JSON NOT NULL,
    created_utc_ns BIGINT NOT NULL,
    epoch_utc_ns BIGINT NOT NULL,
    clock VARCHAR NOT NULL,
    solimon_version VARCHAR NOT NULL,
    CONSTRAINT pk_experiment PRIMARY KEY (id)
);

CREATE TABLE sets (
    id INTEGER NOT NULL,
    set_index INTEGER NOT NULL,
    position VARCHAR NOT NULL,
    method VARCHAR NOT NULL,
    due_utc_ns BIGINT NOT NULL,
    due_h FLOAT NOT NULL,
    started_utc_ns BIGINT,
    ended_utc_ns BIGINT,
    state VARCHAR NOT NULL,
    cause VARCHAR,
    n_planned INTEGER NOT NULL,
    n_taken INTEGER NOT NULL,
    n_valid INTEGER NOT NULL,
    file VARCHAR,
    CONSTRAINT pk_sets PRIMARY KEY (id),
    CONSTRAINT uq_sets_position_set_index UNIQUE (position, set_index)
);

CREATE TABLE shots (
    sequence INTEGER NOT NULL,
    set_index INTEGER NOT NULL,
    position VARCHAR NOT NULL,
    shot_index INTEGER NOT NULL,
    attempt INTEGER NOT NULL,
    utc_ns BIGINT NOT NULL,
    mono_ns BIGINT NOT NULL,
    boot_id VARCHAR NOT NULL,
    crc32 BIGINT NOT NULL,
    valid BOOLEAN NOT NULL,
    flags JSON NOT NULL,
    CONSTRAINT pk_shots PRIMARY KEY (sequence),
    CONSTRAINT uq_shots_position_set_index_shot_index UNIQUE (position, set_index, shot_index, attempt)
);

CREATE TABLE features (
    id INTEGER NOT NULL,
    set_index INTEGER NOT NULL,
    position VARCHAR NOT NULL,
    shot_index INTEGER,
    sequence INTEGER,
    due_h FLOAT NOT NULL,
    extractor_version VARCHAR NOT NULL,
    quality VARCHAR NOT NULL,
    n_valid INTEGER NOT NULL,
    tof_pp_s FLOAT,
    tof_ac_s FLOAT,
    amplitude_ratio FLOAT,
    autocorrelation_coefficient FLOAT,
    psw_area_v_s FLOAT,
    tof_mf_s FLOAT,
    isw_amplitude_v FLOAT,
    psw_amplitude_v FLOAT,
    ssw_amplitude_v FLOAT,
    isw_time_s FLOAT,
    psw_time_s FLOAT,
    ssw_time_s FLOAT,
    isw_fwhm_s FLOAT,
    psw_isw_area_ratio FLOAT,
    noise_rms_v FLOAT,
    CONSTRAINT pk_features PRIMARY KEY (id),
    CONSTRAINT fk_features_sequence_shots FOREIGN KEY(sequence) REFERENCES shots (sequence)
);

CREATE INDEX ix_features_position_set_index_shot_index ON features (position, set_index, shot_index);

CREATE UNIQUE INDEX uq_features_set ON features (position, set_index) WHERE shot_index IS NULL;

CREATE TABLE thickness (
    id INTEGER NOT NULL,
    set_index INTEGER NOT NULL,
    position VARCHAR NOT NULL,
    sequence INTEGER,
    due_h FLOAT NOT NULL,
    extractor_version VARCHAR NOT NULL,
    quality VARCHAR NOT NULL,
    travel_time_s FLOAT,
    thickness_m FLOAT,
    thickness_loss_m FLOAT,
    correlation_coefficient FLOAT,
    CONSTRAINT pk_thickness PRIMARY KEY (id),
    CONSTRAINT fk_thickness_sequence_shots FOREIGN KEY(sequence) REFERENCES shots (sequence),
    CONSTRAINT uq_thickness_position_set_index UNIQUE (position, set_index)
);

CREATE TABLE verdicts (
    id INTEGER NOT NULL,
    set_index INTEGER NOT NULL,
    position VARCHAR NOT NULL,
    due_h FLOAT NOT NULL,
    baseline_id INTEGER,
    in_baseline BOOLEAN NOT NULL,
    distance_squared FLOAT,
    limit_name VARCHAR NOT NULL,
    limit_f FLOAT,
    limit_paper FLOAT,
    outlier BOOLEAN,
    outlier_paper BOOLEAN,
    reason VARCHAR,
    contributions JSON,
    CONSTRAINT pk_verdicts PRIMARY KEY (id),
    CONSTRAINT fk_verdicts_baseline_id_baselines FOREIGN KEY(baseline_id) REFERENCES baselines (id),
    CONSTRAINT uq_verdicts_position_set_index UNIQUE (position, set_index)
);
