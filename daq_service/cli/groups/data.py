"""Commands about stored data."""

from __future__ import annotations

from daq_service.cli.groups import options
from daq_service.cli.groups.options import argument, command, option

verify = command("verify", "maintenance.command:run_verify", *options.DATA_JSON)
repair = command(
    "repair",
    "maintenance.command:run_repair",
    *options.DATA_JSON,
    option("--apply", is_flag=True, help="Make the repairs; needs a stopped recorder."),
    option("--from", "backup", type=options.FOLDER, help="A backup of this test, for lost files."),
)
rebuild = command("rebuild", "maintenance.rebuild:print_rebuilt", *options.DATA_JSON)
backup = command(
    "backup",
    "maintenance.command:run_backup",
    argument("destination", type=options.FOLDER),
    *options.DATA_JSON,
)
export = command(
    "export",
    "maintenance.command:run_export",
    options.DATA_DIR_ALONE,
    option(
        "--hdf5",
        type=options.FILE,
        help="One HDF5 file of the complete test; waveforms stay in the sets' files.",
    ),
    option("--table", metavar="NAME", help="Instead: a table, such as features or alarms."),
    option("--waveforms", metavar="POSITION", help="Instead: waveforms of a position, in volts."),
    option(
        "--out",
        "targets",
        multiple=True,
        type=options.FILE,
        help="Its file: .csv, .parquet, .arrow, .npz, .mat or .h5; may be given several times.",
    ),
    option("--position", help="With --table: this position only."),
    option("--from-h", type=float, help="With --table or --waveforms: from this hour on."),
    option("--to-h", type=float, help="With --table or --waveforms: before this hour."),
    option("--first-set", type=options.IntRange(min=0), help="With --waveforms: from this set on."),
    option("--last-set", type=options.IntRange(min=0), help="With --waveforms: up to this set."),
    option(
        "--purpose",
        type=options.Choice(["planned", "confirmation", "any"]),
        help="With --table: scheduled sets (default), confirmation sets, or both.",
    ),
    option("--fields", metavar="NAMES", help="With --table: these columns only, for example tof_pp_s."),
    *options.FILES_JSON,
)
