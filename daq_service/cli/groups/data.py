"""Commands about stored data."""

from __future__ import annotations

from daq_service.cli.groups.options import (
    DATA_DIR_ALONE,
    FILE,
    FOLDER,
    JSON,
    OVERWRITE,
    Choice,
    IntRange,
    argument,
    command,
    option,
)

verify = command("verify", "maintenance.command:run_verify", DATA_DIR_ALONE, JSON)
repair = command(
    "repair",
    "maintenance.command:run_repair",
    DATA_DIR_ALONE,
    option("--apply", is_flag=True, help="Make the repairs; needs a stopped recorder."),
    option("--from", "backup", type=FOLDER, help="A backup of this test, for lost files."),
    JSON,
)
rebuild = command("rebuild", "maintenance.rebuild:print_rebuilt", DATA_DIR_ALONE, JSON)
backup = command(
    "backup",
    "maintenance.command:run_backup",
    argument("destination", type=FOLDER),
    DATA_DIR_ALONE,
    JSON,
)
export = command(
    "export",
    "maintenance.command:run_export",
    DATA_DIR_ALONE,
    option(
        "--hdf5", type=FILE, help="One HDF5 file of the complete test; waveforms stay in the sets' files."
    ),
    option("--table", metavar="NAME", help="Instead: a table, such as features or alarms."),
    option("--waveforms", metavar="POSITION", help="Instead: waveforms of a position, in volts."),
    option(
        "--out",
        "targets",
        multiple=True,
        type=FILE,
        help="Its file: .csv, .parquet, .arrow, .npz, .mat or .h5; may be given several times.",
    ),
    option("--position", help="With --table: this position only."),
    option("--from-h", type=float, help="With --table or --waveforms: from this hour on."),
    option("--to-h", type=float, help="With --table or --waveforms: before this hour."),
    option("--first-set", type=IntRange(min=0), help="With --waveforms: from this set on."),
    option("--last-set", type=IntRange(min=0), help="With --waveforms: up to this set."),
    option(
        "--purpose",
        type=Choice(["planned", "confirmation", "any"]),
        help="With --table: scheduled sets (default), confirmation sets, or both.",
    ),
    option("--fields", metavar="NAMES", help="With --table: these columns only, for example tof_pp_s."),
    OVERWRITE,
    JSON,
)
