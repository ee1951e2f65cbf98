"""Commands that use the physics twin and the models."""

from __future__ import annotations

from daq_service.cli.groups import options
from daq_service.cli.groups.options import command, executor, option, repeated

simulate = command(
    "simulate",
    "simulate:print_simulation",
    options.CONFIG,
    option(
        "--model",
        type=options.Choice(["coupled", "zener"]),
        default="coupled",
        help="coupled: chain and plate together (default); zener: the last sphere strikes a large plate.",
    ),
    option("--position", help="Use chain, plate and footprint of this position."),
    option("--depth", "depth_fraction", type=float, help="Lost fraction of the thickness, 0 to 0.95."),
    option("--drop-height-m", type=float, help="Drop height of the striker in m."),
    option("--tilt-rad", type=float, help="Tilt of the sensor disk in rad."),
    option("--depths", help="Short for --sweep corrosion.depth_fraction=..., for example 0:0.8:9."),
    repeated(
        "--sweep",
        "sweeps",
        "KEY=VALUES",
        "Values of a key: a,b,c or first:last:count or log:first:last:count; several make a grid.",
    ),
    option("--sweep-file", type=options.FILE, help="CSV file: a header of keys, then one row per shot."),
    option("--zip", "element_wise", is_flag=True, help="Combine first values, then second ones: no grid."),
    option("--skip-invalid", is_flag=True, help="Keep invalid combinations as rows with their reason."),
    option(
        "--out",
        "outputs",
        multiple=True,
        type=options.PATH,
        help="File of the sweep's table: .csv, .h5 or .parquet; may be given several times.",
    ),
    option("--waveforms", is_flag=True, help="Also store the forces at the sensor (.h5 only)."),
    options.WORKERS,
    executor("Default: threads for a short sweep, processes for a long one; a cluster needs the extra."),
    *options.FILES_JSON,
)
reproduce = command(
    "reproduce",
    "reproduce.run:reproduce",
    option(
        "--out", type=options.FOLDER, help="Folder for figures, tables and report; default: a new one here."
    ),
    option(
        "--from",
        "data_dir",
        type=options.FOLDER,
        help="Data folder of a test; default: the paper's test is run on the twin.",
    ),
    option("--only", metavar="NAMES", help="Only these, for example fig12,table2."),
    options.SEED,
    options.JSON,
)
